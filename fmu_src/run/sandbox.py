"""One instance of a foreign FMU in a process of its own, behind the methods of `Instance`.

Each step is one message: what was written before goes with it, and what was read after the step
before comes back with its answer, before it is asked for. Nothing that comes back is trusted.
"""

import json
import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.run.instance import Binary, CallError, DiedError, LoadError, renamed
from fmu_src.run.sandbox_child import LONGEST_TEXT, PLACE, WORDS, Exchange, unpacked_answer
from hesr_model.support.arrays import Array
from hesr_model.support.process import ChildProcess, FailedError, how_it_ended
from hesr_model.support.text import plain

_FAREWELL = 5.0  # [s] to free an instance
_WHILE = 0.1  # [s] after which it is asked whether the process still lives
_MOST_HOPED = 8  # batches


class RemoteBatch:
    """Values of several Real variables in one buffer, as `Batch`."""

    def __init__(self, remote: "Remote", number: int, values: Array) -> None:
        self.values, self.number = values, number
        self._remote = remote

    def write(self) -> None:
        """Set the variables to `values`, with the next message."""
        self._remote.write(self)

    def read(self) -> Array:
        """Read the variables into `values`, (n,) in their units, and return these."""
        self._remote.read(self)
        return self.values


class Remote:
    """An FMU in a process of its own.

    Parameters
    ----------
    binary, tell, failure : as for `Instance`.
    folder : an empty one, in which the process runs.
    seconds : longest call [s].

    Raises
    ------
    LoadError
        If its binary cannot be loaded.
    CallError
        By it and every method: if a function of the FMU fails; by `write` only at the next call.
    DiedError
        By it and every method: if the process has ended or had to be ended.
    """

    def __init__(
        self,
        binary: Binary,
        tell: Callable[[int, str], None],
        failure: Callable[[Exception], Exception],
        folder: Path,
        seconds: float,
    ) -> None:
        self._tell, self._failure, self._seconds = tell, failure, seconds
        self._fmi = binary.fmi
        self._numbers: dict[tuple[int, ...], int] = {}
        self._sizes: list[int] = []
        self._written: list[tuple[int, bytes]] = []
        self._known: dict[int, bytes] = {}
        self._asked: dict[int, None] = {}
        # Kept open: what stands under its name in the end may be anything.
        self._place = (folder / PLACE).open("w+b", buffering=0)
        self._place.write(b"\0")
        self._reached = 0
        self._connection, theirs = Pipe()
        # -P: what lies in the current folder is not imported.
        command = (sys.executable, "-P", "-m", "fmu_src.run.sandbox_child", str(theirs.fileno()))
        more: dict[str, Any]
        if sys.platform == "win32":
            os.set_handle_inheritable(theirs.fileno(), True)
            more = {"close_fds": False}
        else:
            _bound(self._connection.fileno(), seconds)
            more = {"pass_fds": (theirs.fileno(),)}
        self._wait = _waiting(self._connection)
        try:
            self._started = ChildProcess(
                command,
                folder,
                stdin=subprocess.PIPE,  # which is closed when this process ends
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                **more,
            )
        except FailedError as error:
            self._place.close()
            self._connection.close()
            raise failure(DiedError(f"for its process: {error}")) from error
        finally:
            theirs.close()
        try:
            self._words("loading it", "load", binary.to_json())
        except BaseException:
            self.kill()
            raise

    def call(self, function: str, *arguments: float) -> None:
        """Call a function of the FMU that takes the instance and numbers."""
        self._flush()
        self._words(function, "call", function, *arguments)

    def put(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Set variables of a type other than Real."""
        self._flush()
        self._words(f"fmi2Set{kind}", "put", kind, list(references), list(values))

    def slope(self, references: Sequence[int], slopes: Sequence[float]) -> None:
        """Set the slopes of Real inputs [unit/s] for the next step."""
        self._flush()
        function = "fmi2SetRealInputDerivatives"
        self._words(function, "slope", list(references), list(map(float, slopes)))

    def batch(self, references: Sequence[int], values: Array | None = None) -> RemoteBatch:
        """Return a buffer of Real variables.

        Parameters
        ----------
        references : of the variables.
        values : (n,) memory to be that buffer, in the variables' units; its own where not given.
        """
        key = tuple(references)
        if key not in self._numbers:
            self._words("fmi2GetReal", "batch", list(key))
            self._numbers[key] = len(self._sizes)
            self._sizes.append(8 * len(key))
        buffer = np.zeros(len(key)) if values is None else values
        return RemoteBatch(self, self._numbers[key], buffer)

    def step(self, begin: float, size: float) -> None:
        """Go from a time on by the size of a step [s]."""
        hoped = list(self._asked)[:_MOST_HOPED]
        self._asked.clear()
        self._exchange(begin=begin, size=size, hoped=hoped)

    def write(self, batch: RemoteBatch) -> None:
        """Set the variables of a batch, with the next message."""
        self._written.append((batch.number, batch.values.tobytes()))
        self._known.clear()

    def read(self, batch: RemoteBatch) -> None:
        """Read the variables of a batch."""
        number = batch.number
        self._asked[number] = None
        if number not in self._known:
            self._exchange(needed=[number])
        batch.values[:] = np.frombuffer(self._known[number], "<f8")

    def close(self, *, stepping: bool) -> None:
        """End the simulation, if it is stepping, free the instance and end the process."""
        self._seconds = min(self._seconds, _FAREWELL)
        self._failure = lambda error: error
        try:
            # What the FMU does to its own process in the end is of no interest any more.
            with suppress(DiedError, CallError, OSError):
                if sys.platform != "win32":
                    _bound(self._connection.fileno(), self._seconds)
                self._words("fmi2FreeInstance", "close", stepping)
        finally:
            self.kill()

    def kill(self) -> None:
        """End the process, and all that it has started."""
        if not self._place.closed:
            self._place.seek(0)
            self._reached = next(iter(self._place.read(1)), 0)
            self._place.close()
        self._connection.close()
        if self._started.process.stdin:
            self._started.process.stdin.close()
        self._started.end()

    def _flush(self) -> None:
        if self._written:
            self._exchange()

    def _exchange(
        self,
        begin: float = 0.0,
        size: float = 0.0,
        needed: Sequence[int] = (),
        hoped: Sequence[int] = (),
    ) -> None:
        """Do what was put off, a step if it has a size, and read batches."""
        written, self._written = self._written, []
        self._known.clear()
        exchange = Exchange(begin=begin, size=size, written=written, needed=needed, hoped=hoped)
        names = ["fmi2SetReal"] * len(written) + ["fmi2DoStep"] * (size != 0.0)
        names += ["fmi2GetReal"] * (len(needed) + len(hoped))
        read = [*needed, *hoped]
        most = 8 + sum(self._sizes[number] for number in read) + LONGEST_TEXT
        data = self._asked_for(names, exchange.packed(), most)
        try:
            status, place, rest = unpacked_answer(data)
            if status:
                name, found = renamed(names[place], self._fmi), []
            else:
                name, found = "", read[: max(place, len(needed))]
            for number in found:
                values, rest = rest[: self._sizes[number]], rest[self._sizes[number] :]
                if len(values) != self._sizes[number]:
                    raise ValueError("too few values")
                self._known[number] = values
            self._hear(json.loads(rest) if rest else [])
        except (ValueError, IndexError, TypeError, struct.error, RecursionError) as error:
            raise self._nonsense(names) from error
        if status:
            raise self._failure(CallError(name, status))

    def _words(self, function: str, method: str, *arguments: Any) -> None:
        """Have a method of the host called; what the FMU is asked for is named in errors."""
        self._known.clear()
        request = WORDS + json.dumps([method, arguments]).encode()
        data = self._asked_for([function], request, LONGEST_TEXT)
        try:
            answer = json.loads(data)
            unloadable, failed = (answer.get(key) for key in ("unloadable", "failed"))
            self._hear(answer["messages"])
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise self._nonsense([function]) from error
        if unloadable is not None:
            raise LoadError(plain(str(unloadable)))
        if failed is not None:
            raise self._failure(CallError(plain(str(failed))))

    def _hear(self, messages: Sequence[tuple[int, str]]) -> None:
        for status, text in messages:
            self._tell(int(status), str(text))

    def _asked_for(self, functions: Sequence[str], request: bytes, most: int) -> bytes:
        """Send a request that makes the FMU go through functions, and return its answer."""
        overdue = f"gave no answer within {self._seconds:g} s and was ended"
        try:
            self._connection.send_bytes(request)
            if self._answers():
                return self._connection.recv_bytes(most)
        except BlockingIOError as error:
            raise self._died(functions, overdue) from error
        except (EOFError, OSError) as error:
            raise self._died(functions, self._ended()) from error
        raise self._died(functions, overdue)

    def _answers(self) -> bool:
        """Wait for an answer; whether there is one in time.

        Raises
        ------
        EOFError
            If the process has ended without one.
        """
        end = time.monotonic() + self._seconds
        while not self._wait():
            # What it has started may still hold the connection.
            if self._started.process.poll() is not None and not self._wait(0.0):
                raise EOFError
            if time.monotonic() > end:
                return False
        return True

    def _ended(self) -> str:
        """Return how the process ended, which has closed its end of the connection."""
        try:
            return how_it_ended(self._started.process.wait(1.0))
        except subprocess.TimeoutExpired:
            return "closed its connection and was ended"

    def _nonsense(self, functions: Sequence[str]) -> Exception:
        return self._died(functions, "answered what no FMU answers and was ended")

    def _died(self, functions: Sequence[str], how: str) -> Exception:
        self.kill()
        place = min(self._reached, len(functions) - 1)
        return self._failure(DiedError(f"{renamed(functions[place], self._fmi)} {how}"))


def _waiting(connection: Connection) -> Callable[..., object]:
    """Return a function that waits for what comes, for a while or so many seconds."""
    if sys.platform == "win32":
        return lambda seconds=_WHILE: connection.poll(seconds)
    # A tenth of the time of `Connection.poll`, which each step has to wait for.
    poll = select.poll()
    poll.register(connection.fileno(), select.POLLIN)
    return lambda seconds=_WHILE: poll.poll(1000.0 * seconds)


def _bound(connection: int, seconds: float) -> None:
    """Let reading from and writing to a connection fail that take longer."""
    whole = int(seconds)
    limit = struct.pack("@ll", whole, max(int(1e6 * (seconds - whole)), 0))
    with socket.socket(fileno=os.dup(connection)) as own:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
