"""A process with limits on time, memory and files, for untrusted FMUs and files."""

import base64
import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property, partialmethod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fmu_src.run import sandbox_child
from fmu_src.run.instance import (
    VERSIONS,
    CallError,
    DiedError,
    Failure,
    LoadError,
    Tell,
    UnpackedFmu,
)
from fmu_src.run.master import Layout
from fmu_src.run.native import FUNCTIONS, End, set_times, write_library
from fmu_src.run.sandbox_rights import warn
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import ChildProcess, FailedError, describe_end, python_command
from hesr_model.support.text import sanitise

RUN_TIMEOUT = 3600.0  # [s] of a run
_FREE_TIMEOUT = 5.0  # [s] to free an instance
_POLL_PERIOD = 0.1  # [s] between checks of the process
_RECEIVE_SIZE = 1 << 16  # bytes received at once
_MAX_PREFETCHED = 8  # buffers
_MAX_RESULT_BYTES = 64 << 20  # bytes
INVALID_ANSWER = "gave an invalid answer and was ended"


class Sandbox:
    """A child process in an empty folder that answers requests within `seconds` [s] each.

    All requests of a run, or of a process without runs, must be answered within `total` [s]. The
    process may read a file or folder, `readable`, and imports `modules` at once.

    Otherwise it raises DiedError with the end of a sentence; `progress` is then that of its end,
    whose call is the position of the last call within its request.
    """

    def __init__(
        self,
        folder: Path,
        seconds: float,
        readable: Path,
        *modules: str,
        total: float = RUN_TIMEOUT,
    ) -> None:
        warn()
        self.seconds = seconds
        self.readable = readable
        self.tells: list[Tell] = []  # by number of the instance
        self.buffers = 0  # number
        self._total = total
        self._ended = False
        self._last_shared = b""
        self.begin()
        # Kept open, because the FMU may replace the file.
        self._shared = (folder / sandbox_child.SHARED).open("w+b", buffering=0)
        self.share(b"", 0)
        self._socket, theirs = socket.socketpair()
        self._socket.settimeout(_POLL_PERIOD)
        theirs.set_inheritable(True)
        arguments = (str(theirs.fileno()), str(readable.resolve()), *modules)
        windows = sys.platform == "win32"
        try:
            self._child = ChildProcess(
                python_command("-m", "fmu_src.run.sandbox_child", *arguments),
                folder,
                environment=dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder.resolve())),
                stdin=subprocess.PIPE,  # closed when this process ends
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                **({"close_fds": False} if windows else {"pass_fds": (theirs.fileno(),)}),
            )
        except FailedError as error:
            self._shared.close()
            self._socket.close()
            raise DiedError(f"has no process: {error}") from error
        finally:
            theirs.close()

    def begin(self) -> None:
        """Begin a run, which has `total` seconds."""
        self._run_deadline = time.monotonic() + self._total

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
        data = json.dumps(request).encode()
        self._answer_deadline = time.monotonic() + self.seconds
        self._stepping = stepping
        try:
            self._send(sandbox_child.LENGTH.pack(len(data)) + data)
            return json.loads(self._receive(limit))
        except OSError as error:  # a closed connection included
            raise self.end_process(self._describe_end()) from error
        except (ValueError, RecursionError) as error:
            raise self.end_process(INVALID_ANSWER) from error

    def run(self, function: str, *arguments: Any) -> Any:
        """Return the result of "module:function", called in the process with JSON data."""
        answer = self.ask({"run": [function, *arguments]}, _MAX_RESULT_BYTES)
        try:
            if "raised" in answer:
                raise self.end_process(
                    f"failed with '{sanitise(str(answer['raised']), 400).rstrip('.')}'"
                )
            return answer["result"]
        except (TypeError, KeyError) as error:
            raise self.end_process(INVALID_ANSWER) from error

    def end_process(self, reason: str) -> DiedError:
        """End the process and return the error; keep the rows that it has shared."""
        self._last_shared = self.read_shared(0, self._size)
        self.kill()
        return DiedError(reason)

    def kill(self) -> None:
        """End the process and its descendants."""
        if self._ended:
            return
        self._ended = True
        self._shared.close()
        self._socket.close()
        if self._child.process.stdin:
            self._child.process.stdin.close()
        self._child.end()

    def progress(self) -> tuple[int, int, int]:
        """Return rows, station and call; the FMU may have written anything there."""
        head = self.read_shared(0, sandbox_child.HEAD)
        return struct.unpack("=3q", head.ljust(sandbox_child.HEAD, b"\0"))

    def _send(self, data: bytes) -> None:
        unsent = memoryview(data)
        while unsent:
            with suppress(TimeoutError):
                unsent = unsent[self._socket.send(unsent) :]
            self._require_time()

    def _receive(self, limit: int) -> bytes:
        data = bytearray()
        size = sandbox_child.LENGTH.size + limit
        before = self.progress() if self._stepping else None
        while len(data) < size:
            try:
                piece = self._socket.recv(_RECEIVE_SIZE)
            except TimeoutError:
                # Descendants may keep the connection open.
                if self._child.process.poll() is not None:
                    raise ConnectionError from None
                if before and before[0] != (now := self.progress())[0]:
                    before, self._answer_deadline = now, time.monotonic() + self.seconds
                self._require_time()
                continue
            if not piece:
                raise ConnectionError
            data += piece
            if len(data) < sandbox_child.LENGTH.size:
                self._require_time()
                continue
            size = sandbox_child.LENGTH.size + sandbox_child.LENGTH.unpack_from(data)[0]
            if size > sandbox_child.LENGTH.size + limit or len(data) > size:
                raise self.end_process(INVALID_ANSWER)
            if len(data) < size:
                self._require_time()
        return bytes(data[sandbox_child.LENGTH.size :])

    def _require_time(self) -> None:
        now = time.monotonic()
        if now > self._answer_deadline:
            raise self.end_process(f"gave no answer within {self.seconds:g} s and was ended")
        if now > self._run_deadline:
            raise self.end_process(f"ran for more than {self._total:g} s and was ended")

    def _describe_end(self) -> str:
        try:
            return describe_end(self._child.process.wait(1.0))
        except subprocess.TimeoutExpired:
            return "closed its connection and was ended"


def run_in_sandbox(function: str, *arguments: Any, folder: Path, seconds: float) -> Any:
    """Do `Sandbox.run` in a new sandbox, which may read the path in the first argument."""
    with TemporaryDirectory(dir=folder) as process_folder:
        sandbox = Sandbox(Path(process_folder), seconds, Path(arguments[0]))
        try:
            return sandbox.run(function, *arguments)
        finally:
            sandbox.kill()


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
        buffer_values = np.zeros(len(key)) if values is None else values
        return _SandboxedBuffer(self, self._numbers[key], key, buffer_values)

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
        if {type(value) for value in read_values} - kinds.get(kind, {int, bool}) or len(
            read_values
        ) != len(references):
            raise self.failure(
                self.sandbox.end_process(INVALID_ANSWER), self._functions["get"] + kind
            )
        return read_values

    def _do(self, method: str, *arguments: Any) -> Any:
        if method == "setup":
            self.sandbox.begin()
        kind = self._fmi.kind(arguments[0], None)[0] if method in ("set", "get") else ""
        return self._call(f"{self._functions[method]}{kind}", method, *arguments)

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
        calls, self._written = [*(call for _, call in self._written), (method, *arguments)], []
        self._known.clear()
        request = {"instance_number": self.number, "calls": calls, "ahead": ahead}
        limit = sandbox_child.MAX_ANSWER_BYTES + 2 * sum(self._sizes.values())
        answer = self.sandbox.ask(request, limit, stepping=stepping)
        try:
            unloadable, failed = (answer.get(key) for key in ("unloadable", "failed"))
            for instance_number, status, text in answer["messages"]:
                self.sandbox.tells[instance_number](int(status), str(text))
            self._know(ahead, answer["ahead"])
            result = None if unloadable or failed else answer["results"][len(calls) - 1]
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
        died = isinstance(error, DiedError) and function
        return self._failure(DiedError(f"{function} {error}") if died else error)


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
    sandboxed_buffers = [
        buffer
        for station in layout.stations
        for buffer in (station.inputs, station.outputs)
        if isinstance(buffer, _SandboxedBuffer) and not station.conversions
    ]
    uneven = layout.times is not None
    if (
        layout.scheme.refreshed != "none"
        or uneven
        or len(sandboxed_buffers) != 2 * len(layout.stations)
    ):
        return None
    is_one_process = len({id(buffer.instance.sandbox) for buffer in sandboxed_buffers}) == 1
    return (
        SandboxStepper(layout, sandboxed_buffers[::2], sandboxed_buffers[1::2])
        if is_one_process
        else None
    )


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
        failing = -1
        end = End.DONE
        error: CallError | DiedError | None = None
        try:
            if not self._is_prepared:
                self._prepare()
            self._inputs[0].instance.request("advance", stop, stepping=True)
        except (CallError, DiedError) as caught:
            error = caught
        done, station, call = self._sandbox.progress()
        self._take(min(max(done, self.done), stop))
        finite = bool(np.isfinite(layout.values).all())
        if error:
            failing = min(max(station, 0), len(layout.stations) - 1)
            end = End(call) if call in map(int, FUNCTIONS) else End.STEP_FAILED
        elif self.done < stop and not finite:
            end = End.NOT_FINITE
        set_times(layout, max(self.done, 1), end, failing)
        if finite and not error:
            if self.done:
                layout.require_limits(layout.values, layout.begin + (self.done - 1) * layout.step)
            if self.done < stop:
                error = self._sandbox.end_process(INVALID_ANSWER)
        if error:
            instance = self._inputs[failing].instance
            raise instance.failure(error, FUNCTIONS[end] if end else "steps") from error

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
