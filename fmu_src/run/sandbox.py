"""A child process for untrusted FMUs, alone or as a system."""

import base64
import struct
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property, partialmethod
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.run import sandbox_child
from fmu_src.run.instance import (
    VERSIONS,
    CallError,
    Failure,
    LoadError,
    Tell,
    UnpackedFmu,
)
from fmu_src.run.master import Layout
from fmu_src.run.native import FUNCTIONS, End, set_times, write_library
from hesr_model.support.arrays import Array
from hesr_model.support.child import INVALID_ANSWER, RUN_TIMEOUT, Child
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import DiedError
from hesr_model.support.text import sanitise

_FREE_TIMEOUT = 5.0  # [s] to free an instance
_MAX_PREFETCHED = 8  # buffers
_SERVER = "fmu_src.run.sandbox_child:serve"


class Sandbox(Child):
    """A child that serves FMUs, with a file of values and recorded rows that both share.

    `progress` is that of its end, whose call is the position of the last call within its request.
    """

    def __init__(
        self,
        folder: Path,
        seconds: float,
        readable: Path,
        *modules: str,
        total: float = RUN_TIMEOUT,
    ) -> None:
        self.readable = readable
        self.tells: list[Tell] = []  # by number of the instance
        self.buffers = 0  # number
        self._last_shared = b""
        # Kept open, because the FMU may replace the file.
        self._shared = (folder / sandbox_child.SHARED).open("w+b", buffering=0)
        self.share(b"", 0)
        try:
            super().__init__(folder, seconds, [readable], *modules, total=total, server=_SERVER)
        except DiedError:
            self._shared.close()
            raise

    def share(self, values: bytes, size: int) -> None:
        """Clear the progress in the shared file; values and `size` bytes follow it."""
        self._shared.seek(0)
        self._shared.write(bytes(sandbox_child.HEAD) + values)
        self._size = self._shared.tell() + size
        if self._shared.seek(0, 2) < self._size:
            self._shared.truncate(self._size)

    def read_shared(self, begin: int, size: int) -> bytes:
        """Return bytes of the shared file, fewer if the FMU has shortened it."""
        if self._ended:
            return self._last_shared[begin : begin + size]
        self._shared.seek(begin)
        return self._shared.read(size)

    def ask(
        self, request: Any, limit: int = sandbox_child.MAX_ANSWER_BYTES, *, stepping: bool = False
    ) -> Any:
        """Return the answer to a request, at most `limit` bytes; `stepping` has `seconds` a row."""
        self._known_rows = None
        if stepping:
            self._known_rows = self.progress()[0]
        return super().ask(request, limit)

    def end_process(self, reason: str) -> DiedError:
        """End the process and return the error; keep the rows that it has shared."""
        self._last_shared = self.read_shared(0, self._size)
        return super().end_process(reason)

    def kill(self) -> None:
        """End the process and its descendants."""
        self._shared.close()
        super().kill()

    def progress(self) -> tuple[int, int, int]:
        """Return rows, station and call; the FMU may have written anything there."""
        head = self.read_shared(0, sandbox_child.HEAD)
        return struct.unpack("=3q", head.ljust(sandbox_child.HEAD, b"\0"))

    def _extend_deadline(self) -> None:
        """Give `seconds` after each new row."""
        if self._known_rows is None:
            return
        rows = self.progress()[0]
        if rows != self._known_rows:
            self._known_rows = rows
            self._answer_deadline = time.monotonic() + self.seconds


class SystemSandbox(ExitStack):
    """Folder and process of the untrusted FMUs of a system, made when the first one is loaded."""

    def __init__(self, seconds: float, total: float = RUN_TIMEOUT) -> None:
        super().__init__()
        self._seconds = seconds
        self._total = total

    @cached_property
    def folder(self) -> Path:
        """Folder that the process may read."""
        return self.enter_context(scratch_folder())

    @cached_property
    def sandbox(self) -> Sandbox:
        """The process, which writes in a folder within."""
        process_folder = self.folder / "process"
        process_folder.mkdir()
        sandbox = Sandbox(
            process_folder, self._seconds, self.folder, "fmu_src.run.native", total=self._total
        )
        self.callback(sandbox.kill)
        return sandbox


class SandboxedInstance:
    """An FMU in a sandbox, like `Instance`; a failed write surfaces at the next call."""

    def __init__(self, fmu: UnpackedFmu, tell: Tell, failure: Failure, sandbox: Sandbox) -> None:
        self._failure = failure
        self.sandbox = sandbox
        self._fmi = VERSIONS[fmu.fmi]
        self._functions = self._fmi.functions
        self._numbers: dict[tuple[int, ...], int] = {}
        self._sizes: dict[int, int] = {}
        self._written: list[tuple[str, tuple[Any, ...]]] = []  # functions and calls
        self._known: dict[int, bytes] = {}
        self._asked: dict[int, None] = {}
        self.number = len(sandbox.tells)
        sandbox.tells.append(tell)
        self._call("loading it", "load", fmu.to_json())

    def step(self, time: float, size: float) -> None:
        """Step from a time [s] by a size [s]."""
        ahead = list(self._asked)[:_MAX_PREFETCHED]
        self._asked.clear()
        self._call(self._functions["step"], "step", time, size, ahead=ahead)

    def buffer(self, references: Sequence[int], values: Array | None = None) -> "_SandboxedBuffer":
        """Return a buffer of Real variables; see `Instance`."""
        key = tuple(references)
        if key not in self._numbers:
            self._call(self._functions["read"], "buffer", list(key))
            self._numbers[key] = self.sandbox.buffers
            self._sizes[self.sandbox.buffers] = 8 * len(key)
            self.sandbox.buffers += 1
        if values is None:
            values = np.zeros(len(key))
        return _SandboxedBuffer(self, self._numbers[key], key, values)

    def write(self, buffer: "_SandboxedBuffer") -> None:
        """Set the variables of a buffer with the next message."""
        text = base64.b64encode(buffer.values.tobytes()).decode()
        self._written.append((self._functions["write"], ("write", buffer.number, text)))
        self._known.clear()

    def read(self, buffer: "_SandboxedBuffer") -> None:
        """Read the variables of a buffer."""
        self._asked[buffer.number] = None
        if buffer.number not in self._known:
            self._call(self._functions["read"], "read", buffer.number)
        buffer.values[:] = np.frombuffer(self._known[buffer.number])

    def close(self, *, stepping: bool) -> None:
        """Terminate and free the instance."""
        self.sandbox.seconds = min(self.sandbox.seconds, _FREE_TIMEOUT)
        self._failure = lambda error: error
        with suppress(DiedError, CallError):
            self._call(self._functions["free"], "close", stepping)

    def kill(self) -> None:
        """End the process."""
        self.sandbox.kill()

    def get(self, kind: str, references: Sequence[int]) -> list[Any]:
        """Return variables of any type but Real."""
        read_values: list[Any] = list(self._do("get", kind, references) or ())
        kinds: dict[str, set[type]] = {"String": {str}, "Float32": {float}}
        wrong_types = {type(value) for value in read_values} - kinds.get(kind, {int, bool})
        if wrong_types or len(read_values) != len(references):
            raise self.failure(
                self.sandbox.end_process(INVALID_ANSWER), self._functions["get"] + kind
            )
        return read_values

    def _do(self, method: str, *arguments: Any) -> Any:
        if method == "setup":
            self.sandbox.begin()
        function = self._functions[method]
        if method in ("set", "get"):
            suffix, _ = self._fmi.kind(arguments[0], None)
            function += suffix
        return self._call(function, method, *arguments)

    setup = partialmethod(_do, "setup")
    enter_initialisation = partialmethod(_do, "enter_initialisation")
    exit_initialisation = partialmethod(_do, "exit_initialisation")
    reset = partialmethod(_do, "reset")
    set = partialmethod(_do, "set")
    set_slopes = partialmethod(_do, "set_slopes")

    def _call(self, function: str, method: str, *arguments: Any, ahead: Sequence[int] = ()) -> Any:
        """Do pending writes and a call, and read buffers `ahead`; return the call's result."""
        names = [*(name for name, _ in self._written), function]
        names += [self._functions["read"]] * len(ahead)
        try:
            return self.request(method, *arguments, ahead=ahead)
        except (CallError, DiedError) as error:
            position = min(max(self.sandbox.progress()[2], 0), len(names) - 1)
            raise self.failure(error, names[position]) from error

    def request(
        self, method: str, *arguments: Any, ahead: Sequence[int] = (), stepping: bool = False
    ) -> Any:
        """Do what `_call` does; raise CallError or DiedError as they are."""
        calls = [*(call for _, call in self._written), (method, *arguments)]
        self._written = []
        self._known.clear()
        request = {"instance_number": self.number, "calls": calls, "ahead": ahead}
        limit = sandbox_child.MAX_ANSWER_BYTES + 2 * sum(self._sizes.values())
        answer = self.sandbox.ask(request, limit, stepping=stepping)
        try:
            unloadable = answer.get("unloadable")
            failed = answer.get("failed")
            for instance_number, status, text in answer["messages"]:
                self.sandbox.tells[instance_number](int(status), str(text))
            self._know(ahead, answer["ahead"])
            result = None
            if not (unloadable or failed):
                result = answer["results"][len(calls) - 1]
            if method == "read" and not failed:
                self._know(arguments, [result])
        except (ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
            raise self.sandbox.end_process(INVALID_ANSWER) from error
        if unloadable is not None:
            raise LoadError(sanitise(str(unloadable)))
        if failed is not None:
            raise CallError(sanitise(str(failed)))
        return result

    def _know(self, numbers: Sequence[int], texts: Sequence[Any]) -> None:
        for number, text in zip(numbers, texts, strict=False):
            self._known[number] = base64.b64decode(text)
            if len(self._known[number]) != self._sizes[number]:
                raise ValueError("the size is wrong")

    def failure(self, error: Exception, function: str = "") -> Exception:
        """Return the error of a function that failed or ended the process."""
        if isinstance(error, DiedError) and function:
            error = DiedError(f"{function} {error}")
        return self._failure(error)


@dataclass
class _SandboxedBuffer:
    instance: SandboxedInstance
    number: int
    references: tuple[int, ...]
    values: Array

    def write(self) -> None:
        self.instance.write(self)

    def read(self) -> Array:
        self.instance.read(self)
        return self.values


def sandbox_stepper(layout: Layout) -> "SandboxStepper | None":
    """Return the steps of a system whose FMUs share a process; None for others."""
    if layout.scheme.refreshed != "none" or layout.times is not None:
        return None
    inputs = []
    outputs = []
    for station in layout.stations:
        if station.conversions:
            return None
        if not isinstance(station.inputs, _SandboxedBuffer):
            return None
        if not isinstance(station.outputs, _SandboxedBuffer):
            return None
        inputs.append(station.inputs)
        outputs.append(station.outputs)
    processes = {id(buffer.instance.sandbox) for buffer in (*inputs, *outputs)}
    if len(processes) != 1:
        return None
    return SandboxStepper(layout, inputs, outputs)


class SandboxStepper:
    """Steps of a system within the process of its FMUs, which shares a file of recorded rows."""

    def __init__(
        self,
        layout: Layout,
        inputs: Sequence[_SandboxedBuffer],
        outputs: Sequence[_SandboxedBuffer],
    ) -> None:
        self._layout = layout
        self._inputs = inputs
        self._outputs = outputs
        self._sandbox = inputs[0].instance.sandbox
        self._library = write_library(self._sandbox.readable)
        self.begin(np.empty((0, len(layout.rows))))

    def begin(self, recorded_rows: Array) -> None:
        """See `PythonStepper`."""
        self._recorded_rows = recorded_rows
        self.done = 0
        self._is_prepared = False

    def advance(self, stop: int) -> None:
        """See `PythonStepper`."""
        layout = self._layout
        error = self._request_rows(stop)
        done, station, call = self._sandbox.progress()
        # The FMU may have written anything into the shared file.
        self._take(min(max(done, self.done), stop))
        is_finite = bool(np.isfinite(layout.values).all())
        failing = -1
        end = End.DONE
        if error is not None:
            failing = min(max(station, 0), len(layout.stations) - 1)
            end = End.STEP_FAILED
            if call in map(int, FUNCTIONS):
                end = End(call)
        elif self.done < stop and not is_finite:
            end = End.NOT_FINITE
        set_times(layout, max(self.done, 1), end, failing)
        if is_finite and error is None:
            if self.done:
                layout.require_limits(layout.values, layout.begin + (self.done - 1) * layout.step)
            if self.done < stop:
                error = self._sandbox.end_process(INVALID_ANSWER)
        if error is not None:
            instance = self._inputs[failing].instance
            raise instance.failure(error, FUNCTIONS.get(end, "steps")) from error

    def _request_rows(self, stop: int) -> CallError | DiedError | None:
        """Let the process step until `stop` rows are recorded; return its error, if any."""
        try:
            if not self._is_prepared:
                self._prepare()
            self._inputs[0].instance.request("advance", stop, stepping=True)
        except (CallError, DiedError) as error:
            return error
        return None

    def _prepare(self) -> None:
        layout = self._layout
        self._sandbox.share(layout.values.tobytes(), self._recorded_rows.nbytes)
        stations = [
            (
                input_buffer.instance.number,
                station.every,
                input_buffer.references,
                station.sources.tolist(),
                output_buffer.references,
            )
            for station, input_buffer, output_buffer in zip(
                layout.stations, self._inputs, self._outputs, strict=True
            )
        ]
        layout_fields = {
            name: np.asarray(getattr(layout, name)).tolist() for name in sandbox_child.LAYOUT_FIELDS
        }
        layout_fields["order"] = layout.scheme.order
        size = (len(layout.values), *self._recorded_rows.shape)
        self._inputs[0].instance.request(
            "system", stations, size, layout_fields, str(self._library or "")
        )
        self._is_prepared = True

    def _take(self, done: int) -> None:
        """Copy values and new rows."""
        values = self._layout.values
        width = self._recorded_rows.shape[1]
        first = sandbox_child.HEAD + values.nbytes + 8 * width * self.done
        for array, begin in (
            (values, sandbox_child.HEAD),
            (self._recorded_rows[self.done : done], first),
        ):
            data = self._sandbox.read_shared(begin, array.nbytes)
            if len(data) < array.nbytes:
                return
            array[:] = np.frombuffer(data).reshape(array.shape)
        if np.isfinite(self._recorded_rows[self.done : done]).all():
            self.done = done
