"""What runs in the process of a foreign FMU: `fmu_src.run.sandbox` starts it and talks to it.

    python -m fmu_src.run.sandbox_child CONNECTION

Which of the calls of a request is being made stands in the file `PLACE` of the current folder, for
the one that does not come back. Requests and answers are JSON, but for those of each step, which
are packed (`Exchange`). The process ends with the program that started it, however that ends.
"""

import json
import mmap
import os
import signal
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.run.batch import Batch
from fmu_src.run.instance import Binary, CallError, LoadError
from fmu_src.run.instance3 import instance_of

MOST_MEMORY = 4 << 30
MOST_IN_A_FILE = 1 << 30
MOST_FILES = 256
"""Limits of the process [bytes, bytes, open at a time]."""

MOST_MESSAGES = 100
LONGEST_MESSAGE = 2000
"""What is passed on of an FMU's messages: the last ones, in characters each."""

LONGEST_TEXT = 4 * MOST_MESSAGES * LONGEST_MESSAGE
"""Bytes of an answer's text."""

PLACE = "place"
"""File whose first byte is the place of a call in its request."""

EXCHANGE, WORDS = b"X", b"W"
"""First byte of a request, packed or in JSON."""

_REQUEST, _ANSWER = struct.Struct("<ddIII"), struct.Struct("<ii")


@dataclass(frozen=True, kw_only=True)
class Exchange:
    """Batches that are written, a step if it has a size, and batches that are read.

    Attributes
    ----------
    begin, size : of the step [s]; no step where the size is 0.
    written : batches with their values as bytes, in order.
    needed : batches that are read; an error if that fails.
    hoped : batches that are read besides, for nobody has asked for them yet.
    """

    begin: float = 0.0
    size: float = 0.0
    written: Sequence[tuple[int, bytes]] = ()
    needed: Sequence[int] = ()
    hoped: Sequence[int] = ()

    def packed(self) -> bytes:
        """Return the request."""
        counts = len(self.written), len(self.needed), len(self.hoped)
        numbers = [*(batch for batch, _ in self.written), *self.needed, *self.hoped]
        return b"".join(
            (
                EXCHANGE,
                _REQUEST.pack(self.begin, self.size, *counts),
                struct.pack(f"<{len(numbers)}I", *numbers),
                *(values for _, values in self.written),
            )
        )


def unpacked_answer(data: bytes) -> tuple[int, int, bytes]:
    """Return status and place of the call that failed, and the rest, of an answer to an exchange.

    Raises
    ------
    ValueError
        If it is none.
    """
    if len(data) < _ANSWER.size:
        raise ValueError(f"{len(data)} bytes are no answer")
    status, place = _ANSWER.unpack_from(data)
    return status, place, data[_ANSWER.size :]


class _Host:
    """An instance, its batches, and what it has said since the last answer."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._process = connection, os.getpid()
        self._messages: list[tuple[int, str]] = []
        self._batches: list[Batch] = []
        with Path(PLACE).open("r+b") as file:
            self._place = mmap.mmap(file.fileno(), 1)

    def serve(self) -> None:
        """Answer requests until there are no more."""
        with suppress(EOFError):
            while True:
                request = self._connection.recv_bytes()
                if request[:1] == EXCHANGE:
                    answer = self._exchanged(request[1:])
                else:
                    answer = json.dumps(self._answered(*json.loads(request[1:]))).encode()
                if os.getpid() != self._process:  # the FMU has forked: one answer is enough
                    os._exit(0)
                self._connection.send_bytes(answer)

    def _tell(self, status: int, text: str) -> None:
        self._messages.append((status, text[:LONGEST_MESSAGE]))
        del self._messages[:-MOST_MESSAGES]

    def _said(self) -> list[tuple[int, str]]:
        said, self._messages = self._messages, []
        return said

    def _answered(self, method: str, arguments: Sequence[Any]) -> dict[str, Any]:
        answer: dict[str, Any] = {}
        try:
            getattr(self, f"_{method}")(*arguments)
        except LoadError as error:
            answer["unloadable"] = str(error)[:LONGEST_MESSAGE]
        except CallError as error:
            answer["failed"] = str(error)[:LONGEST_MESSAGE]
        return answer | {"messages": self._said()}

    def _load(self, binary: dict[str, Any]) -> None:
        self._instance = instance_of(Binary(**binary), self._tell)

    def _call(self, function: str, *arguments: float) -> None:
        self._instance.call(function, *arguments)

    def _put(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> None:
        self._instance.put(kind, references, values)

    def _slope(self, references: Sequence[int], slopes: Sequence[float]) -> None:
        self._instance.slope(references, slopes)

    def _batch(self, references: Sequence[int]) -> None:
        self._batches.append(self._instance.batch(references))

    def _close(self, stepping: bool) -> None:
        self._instance.close(stepping=stepping)

    def _exchanged(self, request: bytes) -> bytes:
        """Do an exchange; in the answer stands what was read, then what the FMU said."""
        begin, size, writes, needs, hopes = _REQUEST.unpack_from(request)
        numbers = np.frombuffer(request, "<u4", writes + needs + hopes, _REQUEST.size)
        chosen = [self._batches[number] for number in numbers.tolist()]
        written, needed, hoped = (
            chosen[:writes], chosen[writes : writes + needs], chosen[writes + needs :],
        )  # fmt: skip
        offset = _REQUEST.size + numbers.nbytes
        calls: list[Callable[[], object]] = []
        for batch in written:
            values = np.frombuffer(request, "<f8", batch.values.size, offset)
            offset += values.nbytes
            calls.append(partial(self._write, batch, values))
        if size:
            calls.append(partial(self._instance.step, begin, size))
        calls += [batch.read for batch in needed]
        for place, call in enumerate(calls):
            self._place[0] = min(place, 255)
            try:
                call()
            except CallError as error:
                return self._packed(error.status or 0, place, [])
        found = list(needed)
        before = self._said()
        for place, batch in enumerate(hoped, start=len(calls)):
            self._place[0] = min(place, 255)
            try:
                batch.read()
            except CallError:
                break
            found.append(batch)
        if len(found) < len(chosen) - writes:
            self._messages = []  # nobody has asked
        self._messages = before + self._messages
        return self._packed(0, len(found), found)

    @staticmethod
    def _write(batch: Batch, values: Any) -> None:
        batch.values[:] = values
        batch.write()

    def _packed(self, status: int, place: int, read: Sequence[Batch]) -> bytes:
        said = self._said()
        values = [batch.values.astype("<f8", copy=False).tobytes() for batch in read]
        text = json.dumps(said).encode() if said else b""
        return b"".join((_ANSWER.pack(status, place), *values, text))


def _limit() -> None:
    with suppress(ImportError):  # Windows has no such limits
        import resource

        for kind, most in (
            (resource.RLIMIT_AS, MOST_MEMORY),
            (resource.RLIMIT_FSIZE, MOST_IN_A_FILE),
            (resource.RLIMIT_NOFILE, MOST_FILES),
            (resource.RLIMIT_CORE, 0),
        ):
            # A system or a user may have set a lower one.
            hard = resource.getrlimit(kind)[1]
            least = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(kind, (least, least))


def _end_with_parent() -> None:
    """Wait for the other end of standard input to be closed, then end all at once."""
    with suppress(OSError):
        while os.read(0, 1):
            pass
    if hasattr(os, "killpg"):
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(1)


def main() -> None:
    """Serve the connection whose number is the only argument."""
    number = int(sys.argv[1])
    if sys.platform == "win32":
        from multiprocessing.connection import PipeConnection

        connection = PipeConnection(number)
    else:
        connection = Connection(number)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _limit()
    _Host(connection).serve()


if __name__ == "__main__":
    main()
