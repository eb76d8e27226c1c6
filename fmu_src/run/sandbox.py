"""A process with limits on time, memory and files, for untrusted FMUs and files."""

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partialmethod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fmu_src.run import sandbox_child
from fmu_src.run.fmi import VERSIONS, Tell
from fmu_src.run.instance import CallError, DiedError, Failure, LoadError, UnpackedFmu
from fmu_src.run.sandbox_rights import warn
from hesr_model.support.arrays import Array
from hesr_model.support.process import ChildProcess, FailedError, how_it_ended
from hesr_model.support.text import plain

_FAREWELL = 5.0  # [s] to free an instance
_POLL = 0.1  # [s] between checks of the process
_PIECE = 1 << 16  # bytes received at once
_MOST_PREFETCHED = 8  # buffers
_MOST_RESULT = 64 << 20  # bytes
NONSENSE = "gave an invalid answer and was ended"


class Sandbox:
    """A child process in an empty folder that answers requests within `seconds` [s] each.

    It may read a file or folder, `readable`.

    Otherwise it raises DiedError with the end of a sentence; `reached` is then the position of the
    last call within its request.
    """

    def __init__(self, folder: Path, seconds: float, readable: Path) -> None:
        warn()
        self.seconds, self.reached = seconds, 0
        # Kept open, because the FMU may replace the file.
        self._position = (folder / sandbox_child.POSITION).open("w+b", buffering=0)
        self._position.write(b"\0")
        self._socket, theirs = socket.socketpair()
        self._socket.settimeout(_POLL)
        theirs.set_inheritable(True)
        # -P: modules in the current folder are not imported.
        child = ("-P", "-m", "fmu_src.run.sandbox_child", str(theirs.fileno()), readable.resolve())
        windows = sys.platform == "win32"
        try:
            self._started = ChildProcess(
                (sys.executable, *map(str, child)),
                folder,
                environment=dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder.resolve())),
                stdin=subprocess.PIPE,  # closed when this process ends
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                **({"close_fds": False} if windows else {"pass_fds": (theirs.fileno(),)}),
            )
        except FailedError as error:
            self._position.close()
            self._socket.close()
            raise DiedError(f"has no process: {error}") from error
        finally:
            theirs.close()

    def ask(self, request: bytes, most: int) -> bytes:
        """Return the answer to a request, at most `most` bytes."""
        end = time.monotonic() + self.seconds
        try:
            self._send(sandbox_child.LENGTH.pack(len(request)) + request, end)
            return self._receive(most, end)
        except OSError as error:  # a closed connection included
            raise self.died(self._how_it_ended()) from error

    def run(self, function: str, *arguments: Any) -> Any:
        """Return the result of "module:function", called in the process with JSON data."""
        request = sandbox_child.WORDS + json.dumps(["run", [function, *arguments]]).encode()
        data = self.ask(request, _MOST_RESULT)
        try:
            answer = json.loads(data)
            if "raised" in answer:
                raise self.died(f"failed with '{plain(str(answer['raised']), 400).rstrip('.')}'")
            return answer["result"]
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise self.died(NONSENSE) from error

    def died(self, how: str) -> DiedError:
        """End the process and return the error."""
        self.kill()
        return DiedError(how)

    def kill(self) -> None:
        """End the process and its descendants."""
        if not self._position.closed:
            self._position.seek(0)
            self.reached = next(iter(self._position.read(1)), 0)
            self._position.close()
        self._socket.close()
        if self._started.process.stdin:
            self._started.process.stdin.close()
        self._started.end()

    def _send(self, data: bytes, end: float) -> None:
        left = memoryview(data)
        while left:
            with suppress(TimeoutError):
                left = left[self._socket.send(left) :]
            self._require_time(end)

    def _receive(self, most: int, end: float) -> bytes:
        data, size = bytearray(), sandbox_child.LENGTH.size + most
        while len(data) < size:
            try:
                piece = self._socket.recv(_PIECE)
            except TimeoutError:
                # Descendants may keep the connection open.
                if self._started.process.poll() is not None:
                    raise ConnectionError from None
                self._require_time(end)
                continue
            if not piece:
                raise ConnectionError
            data += piece
            if len(data) < sandbox_child.LENGTH.size:
                self._require_time(end)
                continue
            size = sandbox_child.LENGTH.size + sandbox_child.LENGTH.unpack_from(data)[0]
            if size > sandbox_child.LENGTH.size + most or len(data) > size:
                raise self.died(NONSENSE)
            if len(data) < size:
                self._require_time(end)
        return bytes(data[sandbox_child.LENGTH.size :])

    def _require_time(self, end: float) -> None:
        if time.monotonic() > end:
            raise self.died(f"gave no answer within {self.seconds:g} s and was ended")

    def _how_it_ended(self) -> str:
        try:
            return how_it_ended(self._started.process.wait(1.0))
        except subprocess.TimeoutExpired:
            return "closed its connection and was ended"


def run_in_sandbox(function: str, *arguments: Any, folder: Path, seconds: float) -> Any:
    """Return the result of a function in a new sandbox; see `Sandbox.run`.

    Its first argument is the path that it may read.
    """
    with TemporaryDirectory(dir=folder) as own:
        sandbox = Sandbox(Path(own), seconds, Path(arguments[0]))
        try:
            return sandbox.run(function, *arguments)
        finally:
            sandbox.kill()


class SandboxedInstance:
    """An FMU in a sandbox, with the methods of `Instance`.

    A failed write surfaces at the next call.
    """

    def __init__(
        self, fmu: UnpackedFmu, tell: Tell, failure: Failure, folder: Path, seconds: float
    ) -> None:
        self._tell, self._failure = tell, failure
        self._fmi = VERSIONS[fmu.fmi]
        self._functions = self._fmi.functions
        self._numbers: dict[tuple[int, ...], int] = {}
        self._sizes: list[int] = []
        self._written: list[tuple[int, bytes]] = []
        self._known: dict[int, bytes] = {}
        self._asked: dict[int, None] = {}
        try:
            self._sandbox = Sandbox(folder, seconds, Path(fmu.folder))
        except DiedError as error:
            raise failure(error) from error
        try:
            self._call("loading it", "load", fmu.to_json())
        except BaseException:
            self.kill()
            raise

    def step(self, time: float, size: float) -> None:
        """Step from a time [s] by a size [s]."""
        prefetch = list(self._asked)[:_MOST_PREFETCHED]
        self._asked.clear()
        self._exchange(begin=time, size=size, prefetch=prefetch)

    def buffer(self, references: Sequence[int], values: Array | None = None) -> "_SandboxedBuffer":
        """Return a buffer of Real variables; see `Instance`."""
        key = tuple(references)
        if key not in self._numbers:
            self._call(self._functions["read"], "buffer", list(key))
            self._numbers[key] = len(self._sizes)
            self._sizes.append(8 * len(key))
        own = np.zeros(len(key)) if values is None else values
        return _SandboxedBuffer(self, self._numbers[key], own)

    def write(self, buffer: "_SandboxedBuffer") -> None:
        """Set the variables of a buffer with the next message."""
        self._written.append((buffer.number, buffer.values.tobytes()))
        self._known.clear()

    def read(self, buffer: "_SandboxedBuffer") -> None:
        """Read the variables of a buffer."""
        self._asked[buffer.number] = None
        if buffer.number not in self._known:
            self._exchange(needed=[buffer.number])
        buffer.values[:] = np.frombuffer(self._known[buffer.number])

    def close(self, *, stepping: bool) -> None:
        """Terminate and free the instance, and end the process."""
        self._sandbox.seconds = min(self._sandbox.seconds, _FAREWELL)
        self._failure = lambda error: error
        try:
            with suppress(DiedError, CallError):
                self._call(self._functions["free"], "close", stepping)
        finally:
            self.kill()

    def kill(self) -> None:
        """End the process."""
        self._sandbox.kill()

    def get(self, kind: str, references: Sequence[int]) -> list[Any]:
        """Return variables of type Boolean, Integer or String."""
        found: list[Any] = list(self._do("get", kind, references) or ())
        wanted = {"String": {str}}.get(kind, {int, bool})
        if {type(value) for value in found} - wanted or len(found) != len(references):
            raise self._died([self._functions["get"] + kind], self._sandbox.died(NONSENSE))
        return found

    def _do(self, method: str, *arguments: Any) -> Any:
        if self._written:
            self._exchange()
        kind = self._fmi.kind(arguments[0], None)[0] if method in ("set", "get") else ""
        return self._call(f"{self._functions[method]}{kind}", method, *arguments)

    setup = partialmethod(_do, "setup")
    enter_initialisation = partialmethod(_do, "enter_initialisation")
    exit_initialisation = partialmethod(_do, "exit_initialisation")
    reset = partialmethod(_do, "reset")
    set = partialmethod(_do, "set")
    set_slopes = partialmethod(_do, "set_slopes")

    def _call(self, function: str, method: str, *arguments: Any) -> Any:
        self._known.clear()
        request = sandbox_child.WORDS + json.dumps([method, arguments]).encode()
        try:
            data = self._sandbox.ask(request, sandbox_child.LONGEST_TEXT)
            try:
                answer = json.loads(data)
                unloadable, failed = (answer.get(key) for key in ("unloadable", "failed"))
                self._hear(answer["messages"])
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
                raise self._sandbox.died(NONSENSE) from error
        except DiedError as error:
            raise self._died([function], error) from error
        if unloadable is not None:
            raise LoadError(plain(str(unloadable)))
        if failed is not None:
            raise self._failure(CallError(plain(str(failed))))
        return answer.get("result")

    def _exchange(
        self,
        begin: float = 0.0,
        size: float = 0.0,
        needed: Sequence[int] = (),
        prefetch: Sequence[int] = (),
    ) -> None:
        """Do pending writes, a step [s] unless its size is 0, and read buffers."""
        written, self._written = self._written, []
        self._known.clear()
        exchange = sandbox_child.Exchange(
            begin=begin, size=size, written=written, needed=needed, prefetch=prefetch
        )
        names = [self._functions["write"]] * len(written)
        names += [self._functions["step"]] * (size != 0.0)
        names += [self._functions["read"]] * (len(needed) + len(prefetch))
        read = [*needed, *prefetch]
        most = 8 + sum(self._sizes[number] for number in read) + sandbox_child.LONGEST_TEXT
        try:
            data = self._sandbox.ask(exchange.packed(), most)
            try:
                status, position, rest = sandbox_child.unpacked_answer(data)
                failed = names[position] if status else ""
                found = [] if status else read[: max(position, len(needed))]
                for number in found:
                    values, rest = rest[: self._sizes[number]], rest[self._sizes[number] :]
                    if len(values) != self._sizes[number]:
                        raise ValueError("too few values")
                    self._known[number] = values
                self._hear(json.loads(rest) if rest else [])
            except (ValueError, IndexError, TypeError, struct.error, RecursionError) as error:
                raise self._sandbox.died(NONSENSE) from error
        except DiedError as error:
            raise self._died(names, error) from error
        if status:
            raise self._failure(CallError(failed, status))

    def _hear(self, messages: Sequence[tuple[int, str]]) -> None:
        for status, text in messages:
            self._tell(int(status), str(text))

    def _died(self, functions: Sequence[str], error: DiedError) -> Exception:
        function = functions[min(self._sandbox.reached, len(functions) - 1)]
        return self._failure(DiedError(f"{function} {error}"))


class _SandboxedBuffer:
    def __init__(self, instance: SandboxedInstance, number: int, values: Array) -> None:
        self.values, self.number = values, number
        self._instance = instance

    def write(self) -> None:
        self._instance.write(self)

    def read(self) -> Array:
        self._instance.read(self)
        return self.values
