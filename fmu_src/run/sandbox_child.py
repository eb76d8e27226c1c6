"""Process of a sandbox, which serves an FMU or runs functions by name.

python -m fmu_src.run.sandbox_child SOCKET READABLE

Messages are JSON, except for packed ones of steps (`Exchange`), after their length. The first byte
of the file `POSITION` is the position of the running call within its request. The process ends with
its parent. It may write in its folder and read below READABLE; see `sandbox_rights`.
"""

import importlib
import json
import mmap
import os
import signal
import socket
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.run.sandbox_rights import give_up

if TYPE_CHECKING:
    from fmu_src.run.instance import LocalBuffer

MOST_MEMORY = 4 << 30
MOST_IN_A_FILE = 1 << 30
MOST_FILES = 256  # limits of the process [bytes, bytes, open at a time]
MOST_MESSAGES = 100
LONGEST_MESSAGE = 2000
"""Number and size [characters] of the last messages of an FMU that are forwarded."""

LONGEST_TEXT = 4 * MOST_MESSAGES * LONGEST_MESSAGE  # largest text of an answer of an FMU [bytes]
POSITION = "position"

EXCHANGE, WORDS = b"X", b"W"  # first byte of a request, packed or in JSON
LENGTH = struct.Struct("!I")
_ERROR = 3  # status
_REQUEST, _ANSWER = struct.Struct("<ddIII"), struct.Struct("<ii")


@dataclass(frozen=True, kw_only=True)
class Exchange:
    """Buffers to write, a step [s] unless its size is 0, and buffers to read."""

    begin: float = 0.0
    size: float = 0.0
    written: Sequence[tuple[int, bytes]] = ()  # numbers of buffers and their values
    needed: Sequence[int] = ()  # buffers whose failure is an error
    prefetch: Sequence[int] = ()  # buffers to read speculatively

    def packed(self) -> bytes:
        """Return the request."""
        counts = len(self.written), len(self.needed), len(self.prefetch)
        numbers = [*(number for number, _ in self.written), *self.needed, *self.prefetch]
        return b"".join(
            (
                EXCHANGE,
                _REQUEST.pack(self.begin, self.size, *counts),
                struct.pack(f"<{len(numbers)}I", *numbers),
                *(values for _, values in self.written),
            )
        )


def unpacked_answer(data: bytes) -> tuple[int, int, bytes]:
    """Return status and position of the failed call, and the rest of an answer."""
    if len(data) < _ANSWER.size:
        raise ValueError(f"{len(data)} bytes are not an answer")
    status, position = _ANSWER.unpack_from(data)
    return status, position, data[_ANSWER.size :]


class _Host:
    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._process = connection, os.getpid()
        self._messages: list[tuple[int, str]] = []
        self._buffers: list[LocalBuffer] = []
        with Path(POSITION).open("r+b") as file:
            self._position = mmap.mmap(file.fileno(), 1)

    def serve(self) -> None:
        requests = self._connection.makefile("rb")
        while header := requests.read(LENGTH.size):
            request = requests.read(*LENGTH.unpack(header))
            if request[:1] == EXCHANGE:
                answer = self._exchanged(request[1:])
            else:
                answer = json.dumps(self._answered(*json.loads(request[1:]))).encode()
            if os.getpid() != self._process:  # the FMU has forked: one process answers
                os._exit(0)
            self._connection.sendall(LENGTH.pack(len(answer)) + answer)

    def _tell(self, status: int, text: str) -> None:
        self._messages.append((status, text[:LONGEST_MESSAGE]))
        del self._messages[:-MOST_MESSAGES]

    def _taken_messages(self) -> list[tuple[int, str]]:
        messages, self._messages = self._messages, []
        return messages

    def _answered(self, method: str, arguments: Sequence[Any]) -> dict[str, Any]:
        if method == "run":
            return _run(*arguments)
        from fmu_src.run.instance import CallError, LoadError

        answer: dict[str, Any] = {}
        try:
            if method in ("load", "buffer", "close"):
                getattr(self, f"_{method}")(*arguments)
            else:
                answer["result"] = getattr(self._instance, method)(*arguments)
        except LoadError as error:
            answer["unloadable"] = str(error)[:LONGEST_MESSAGE]
        except CallError as error:
            answer["failed"] = str(error)[:LONGEST_MESSAGE]
        return answer | {"messages": self._taken_messages()}

    def _load(self, fmu: dict[str, Any]) -> None:
        from fmu_src.run.instance import CallError, Instance, UnpackedFmu

        self._instance, self._call_error = Instance(UnpackedFmu(**fmu), self._tell), CallError

    def _buffer(self, references: Sequence[int]) -> None:
        self._buffers.append(self._instance.buffer(references))

    def _close(self, stepping: bool) -> None:
        self._instance.close(stepping=stepping)

    def _exchanged(self, request: bytes) -> bytes:
        begin, size, writes, needs, prefetches = _REQUEST.unpack_from(request)
        count = writes + needs + prefetches
        numbers = struct.unpack_from(f"<{count}I", request, _REQUEST.size)
        chosen = [self._buffers[number] for number in numbers]
        needed, prefetch = chosen[writes : writes + needs], chosen[writes + needs :]
        offset = _REQUEST.size + 4 * count
        calls: list[Callable[[], object]] = []
        for buffer in chosen[:writes]:
            end = offset + buffer.values.nbytes
            calls.append(partial(_write, buffer, request[offset:end]))
            offset = end
        if size:
            calls.append(partial(self._instance.step, begin, size))
        calls += [buffer.read for buffer in needed]
        for position, call in enumerate(calls):
            self._position[0] = min(position, 255)
            try:
                call()
            except self._call_error as error:
                if error.status is None:
                    self._tell(_ERROR, str(error))
                return self._packed(error.status or _ERROR, position, [])
        found = list(needed)
        before = self._taken_messages()
        for position, buffer in enumerate(prefetch, start=len(calls)):
            self._position[0] = min(position, 255)
            try:
                buffer.read()
            except self._call_error:
                self._messages = []  # it will be read again if needed
                break
            found.append(buffer)
        self._messages = before + self._messages
        return self._packed(0, len(found), found)

    def _packed(self, status: int, position: int, read: Sequence["LocalBuffer"]) -> bytes:
        messages = self._taken_messages()
        text = json.dumps(messages).encode() if messages else b""
        values = [buffer.values.tobytes() for buffer in read]
        return b"".join((_ANSWER.pack(status, position), *values, text))


def _write(buffer: "LocalBuffer", values: bytes) -> None:
    buffer.values.data.cast("B")[:] = values
    buffer.write()


def _run(function: str, *arguments: Any) -> dict[str, Any]:
    module, _, name = function.partition(":")
    try:
        return {"result": getattr(importlib.import_module(module), name)(*arguments)}
    except Exception as error:
        return {"raised": f"{type(error).__name__}: {error}"[:LONGEST_MESSAGE]}


def _limit() -> None:
    with suppress(ImportError):  # Windows has no such limits
        import resource

        for kind, most in (
            (resource.RLIMIT_AS, MOST_MEMORY),
            (resource.RLIMIT_FSIZE, MOST_IN_A_FILE),
            (resource.RLIMIT_NOFILE, MOST_FILES),
            (resource.RLIMIT_CORE, 0),
        ):
            # A lower limit may be set already.
            hard = resource.getrlimit(kind)[1]
            least = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(kind, (least, least))


def _end_with_parent() -> None:
    with suppress(OSError):
        while os.read(0, 1):
            pass
    if hasattr(os, "killpg"):
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(1)


def main() -> None:
    """Serve the socket whose number is the first argument."""
    connection = socket.socket(fileno=int(sys.argv[1]))
    _limit()
    give_up(Path.cwd(), Path(sys.argv[2]))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _Host(connection).serve()


if __name__ == "__main__":
    main()
