"""Process of a child, which limits itself, then runs functions by name or a server.

Its arguments are numbers and texts as JSON, see `ChildArguments`. On Linux it is three processes:
this one, the first one in new namespaces, which waits for the end of the parent or the child, and
the child, which alone handles foreign code and files. A nursery forks children.

Messages are JSON after their length.
"""

import importlib
import json
import os
import select
import signal
import socket
import struct
import sys
import sysconfig
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, NoReturn

from hesr_model.support import rights

MAX_FILE_BYTES = 1 << 30
MAX_OPEN_FILES = 256  # at a time
MAX_THREADS = 512
MAX_MESSAGE_LENGTH = 2000  # characters
LENGTH = struct.Struct("!I")
STATUS = struct.Struct("=i")  # of an ended process
_POLL_PERIOD = 50  # [ms]
_IS_ENDED = getattr(os, "WEXITED", 0) | getattr(os, "WNOHANG", 0) | getattr(os, "WNOWAIT", 0)


class ChildArguments(NamedTuple):
    """Connection (file number), what can be read, limit [B], server and modules."""

    connection: int
    readable: list[str]
    memory: int
    server: str
    modules: list[str]


class Connection:
    """Requests and answers, by reading and writing only: calls of sockets are refused."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._requests: BinaryIO
        self._socket = None
        if sys.platform == "win32":  # a handle, which is no file
            self._socket = socket.socket(fileno=number)
            self._requests = self._socket.makefile("rb")
        else:
            self._requests = os.fdopen(number, "rb", closefd=False)

    def receive(self) -> Any:
        """Return the next request, None at the end."""
        header = self._requests.read(LENGTH.size)
        if len(header) < LENGTH.size:
            return None
        return json.loads(self._requests.read(*LENGTH.unpack(header)))

    def send(self, reply: object, buffers: Sequence[Any] = ()) -> None:
        """Send an answer, and buffers after it."""
        answer = json.dumps(reply).encode()
        self._write(memoryview(LENGTH.pack(len(answer)) + answer))
        for buffer in buffers:
            self._write(_view_bytes(buffer))

    def _write(self, unsent: memoryview) -> None:
        if self._socket is not None:
            self._socket.sendall(unsent)
            return
        while unsent:
            unsent = unsent[os.write(self._number, unsent) :]


Answerer = Callable[[Any], Any]


def serve(connection: Connection, answer: Answerer | None = None) -> None:
    """Answer requests to run functions or to iterate over their results, and others by `answer`."""
    process_id = os.getpid()
    caller = _Caller()
    while (request := connection.receive()) is not None:
        buffers: Sequence[Any] = ()
        if request.keys() & {"run", "iterate", "next"}:
            reply, buffers = caller.answer(request)
        else:
            assert answer is not None, request
            reply = answer(request)
        if os.getpid() != process_id:  # foreign code has forked: one process answers
            os._exit(0)
        connection.send(reply, buffers)


Item = tuple[Any, Sequence[Any]]
"""JSON data, and contiguous buffers."""


class _Caller:
    """Calls functions by name, and iterates over the items of the last one that yields any."""

    def __init__(self) -> None:
        self._items: Iterator[Item] = iter(())

    def answer(self, request: dict[str, Any]) -> tuple[dict[str, Any], Sequence[Any]]:
        """Return an answer and the buffers after it."""
        try:
            if "run" in request:
                return {"result": _call(*request["run"])}, ()
            if "iterate" in request:
                self._items = iter(_call(*request["iterate"]))
            item = next(self._items, None)
        except Exception as error:
            return {"raised": f"{type(error).__name__}: {error}"[:MAX_MESSAGE_LENGTH]}, ()
        if item is None:
            return {}, ()
        value, buffers = item
        return {"item": value, "sizes": [_view_bytes(data).nbytes for data in buffers]}, buffers


def _call(function: str, *arguments: Any) -> Any:
    module, _, name = function.partition(":")
    return getattr(importlib.import_module(module), name)(*arguments)


def _view_bytes(data: Any) -> memoryview:
    view = memoryview(data)
    if not view.nbytes:
        return memoryview(b"")  # an empty view may have a shape that cannot be cast
    return view.cast("B")


def _limit_core_dumps() -> None:
    """Write no core files, also not of the processes that end as the child has ended."""
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _limit(memory: int) -> None:
    """Set limits of this process."""
    if sys.platform == "win32":  # it has no such limits
        return
    import resource

    limits = [
        (resource.RLIMIT_AS, memory + _measure_address_space()),
        (resource.RLIMIT_FSIZE, MAX_FILE_BYTES),
        (resource.RLIMIT_NOFILE, MAX_OPEN_FILES),
    ]
    if sys.platform == "linux":
        limits += [(resource.RLIMIT_MSGQUEUE, 0), (resource.RLIMIT_MEMLOCK, 1 << 16)]
    for kind, limit in limits:
        # A lower limit may be set already.
        hard = resource.getrlimit(kind)[1]
        effective_limit = limit
        if hard != resource.RLIM_INFINITY:
            effective_limit = min(limit, hard)
        resource.setrlimit(kind, (effective_limit, effective_limit))


def _measure_address_space() -> int:
    """Return the address space [B] of Python and the libraries that are loaded already."""
    with suppress(OSError, ValueError):
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    return 0


def _limit_threads() -> bool:
    """Limit the threads of the new namespaces; return whether that holds."""
    # An administrator is exempt from the first limit. The second one is of a namespace from Linux
    # 6.14 on; before, it cannot be written here.
    if os.getuid() != 0:
        import resource

        resource.setrlimit(resource.RLIMIT_NPROC, (MAX_THREADS, MAX_THREADS))
        return True
    try:
        Path("/proc/sys/kernel/pid_max").write_text(str(MAX_THREADS), encoding="ascii")
    except OSError:
        return False
    return True


def _enter_supervision(child_files: Sequence[int], *, has_namespaces: bool) -> list[str]:
    """Fork; return in the child the names of the mechanisms that hold. Linux only.

    This process ends as the child does. The other processes close the files of the child.
    """
    rights.adopt_orphans()
    if not has_namespaces:
        _fork_watched_child(child_files)
        return []
    if not rights.enter_namespaces():
        os._exit(1)
    _fork_into_namespaces(child_files)
    held = [rights.NAMESPACES.name]
    if _limit_threads():
        held.append(rights.THREADS.name)
    return held


def _fork_watched_child(child_files: Sequence[int]) -> None:
    """Fork a child, and return in it; this process kills what the child leaves behind."""
    child = os.fork()
    if child != 0:
        _close(child_files)
        status = _watch(child)
        _kill_descendants()
        _end_as(status)
    rights.end_with_parent()


def _fork_into_namespaces(child_files: Sequence[int]) -> None:
    """Fork the first process of the new namespaces, and there the child; return in the child."""
    status_reader, status_writer = os.pipe()
    if os.fork() != 0:
        _close([status_writer, *child_files])
        packed = os.read(status_reader, STATUS.size).ljust(STATUS.size, b"\xff")
        _end_as(*STATUS.unpack(packed))
    # The first process in the namespace: with it the kernel ends all others there.
    rights.end_with_parent()
    os.close(status_reader)
    child = os.fork()
    if child != 0:
        _close(child_files)
        os.write(status_writer, STATUS.pack(_watch(child)))
        os._exit(0)
    os.close(status_writer)


def _can_enter_namespaces() -> bool:
    """Try it in a process of its own, which an attempt that fails half-way makes useless."""
    if sys.platform != "linux":
        return False
    trial = os.fork()
    if trial == 0:
        os._exit(0 if rights.enter_namespaces() else 1)
    return os.waitstatus_to_exitcode(os.waitpid(trial, 0)[1]) == 0


def _close(files: Sequence[int]) -> None:
    for file in files:
        os.close(file)


def _watch(child: int) -> int:
    """Return the status of a child that has ended by itself, or is killed with the parent."""
    period = None
    poll = select.poll()
    poll.register(0, select.POLLHUP)
    try:
        poll.register(os.pidfd_open(child), select.POLLIN)
    except OSError:  # before Linux 5.3
        period = _POLL_PERIOD
    while not poll.poll(period) and not os.waitid(os.P_PID, child, _IS_ENDED):
        pass
    os.kill(child, signal.SIGKILL)  # not reaped: the number is still its own
    return os.waitpid(child, 0)[1]


def _kill_descendants() -> None:
    """Kill all processes that are left below this one."""
    task = Path(f"/proc/self/task/{threading.get_native_id()}/children")
    with suppress(OSError):  # it ends when there are none, or where the kernel does not list them
        while True:
            for number in task.read_text(encoding="ascii").split():
                os.kill(int(number), signal.SIGKILL)
            os.waitpid(-1, 0)


def _end_as(status: int) -> NoReturn:
    """End this process as another one has ended, -1 if its status is unknown."""
    if status == -1:
        os.kill(os.getpid(), signal.SIGKILL)
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        with suppress(OSError):
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(os.waitstatus_to_exitcode(status) & 0xFF)


def _end_with_input() -> None:
    """End this process and its group when the parent closes the standard input."""
    with suppress(OSError):
        while os.read(0, 1):
            pass
    if hasattr(os, "killpg"):
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(1)


def _become_child(arguments: ChildArguments, report: int, *, has_namespaces: bool) -> NoReturn:
    """Limit this process, report the mechanisms that hold, and serve."""
    _limit_core_dumps()
    held = []
    if sys.platform == "linux":
        files = (arguments.connection, report)
        held += _enter_supervision(files, has_namespaces=has_namespaces)
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), 0)
        rights.drop_capabilities()
    _limit(arguments.memory)
    held += rights.give_up(Path.cwd(), [Path(path) for path in arguments.readable])
    os.write(report, json.dumps(held).encode() + b"\n")
    os.close(report)
    if sys.platform != "linux":
        threading.Thread(target=_end_with_input, daemon=True).start()
    for name in arguments.modules:  # while the parent works
        importlib.import_module(name)
    module, _, function = arguments.server.partition(":")
    getattr(importlib.import_module(module), function)(Connection(arguments.connection))
    sys.exit(0)


def main() -> None:
    """Be a child, or a nursery of children."""
    first, *others = json.loads(sys.argv[1])
    if not others:
        _serve_forks(first)
    # The other end of the standard output is read before anything foreign is handled.
    report = os.dup(1)
    with Path(os.devnull).open("r+b") as nothing:
        os.dup2(nothing.fileno(), 1)
    arguments = ChildArguments(first, *others)
    _become_child(arguments, report, has_namespaces=_can_enter_namespaces())


class Fork(NamedTuple):
    """A request to a nursery; connection, input, report and link come with it as open files."""

    arguments: list[Any]
    folder: str
    environment: dict[str, str]
    module_folders: list[str]


MAX_REQUEST_BYTES = 1 << 17
FORK_FILES = 4


def _serve_forks(control: int) -> NoReturn:
    """Fork a child for each request; Python and modules are loaded once for all.

    Nothing foreign is handled here. A link gets the status of its child; at its end, and at that of
    `control`, the child is killed.
    """
    has_namespaces = _can_enter_namespaces()
    sysconfig.get_paths()  # slow for the first time, and part of the rights of each child
    requests = socket.socket(fileno=control)
    poll = select.poll()
    poll.register(requests, select.POLLIN)
    children: dict[int, _ForkedChild] = {}  # by both of its files
    while True:
        ready = poll.poll()[0][0]  # one at a time: files that are closed get their numbers anew
        if ready != control:
            child = children[ready]
            if ready == child.link:
                _kill_group(child.number)
            status = os.waitpid(child.number, 0)[1]
            with suppress(OSError):
                os.write(child.link, STATUS.pack(status))
            for file in child.files:
                poll.unregister(file)
                del children[file]
            _close(child.files)
            continue
        data, files, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, FORK_FILES)
        if not data:
            for child in children.values():
                _kill_group(child.number)
            os._exit(0)
        open_files = [control, *children]
        child = _fork_child(data, files, open_files, has_namespaces=has_namespaces)
        for file in child.files:
            poll.register(file, select.POLLIN)
            children[file] = child


class _ForkedChild(NamedTuple):
    """A child of the nursery: its process ID, the file of its process, and its link."""

    number: int
    process: int
    link: int

    @property
    def files(self) -> tuple[int, int]:
        """The files that are ready when the child, or the need for it, has ended."""
        return self.process, self.link


def _fork_child(
    data: bytes, files: Sequence[int], open_files: Sequence[int], *, has_namespaces: bool
) -> _ForkedChild:
    """Fork the child of a request, which closes the `open_files` of the nursery."""
    connection, lifeline, report, link = files
    request = Fork(*json.loads(data))
    _load(request)
    number = os.fork()
    if number == 0:
        os.setsid()
        _close([link, *open_files])
        _start_child(request, connection, lifeline, report, has_namespaces=has_namespaces)
    _close([connection, lifeline, report])
    return _ForkedChild(number, os.pidfd_open(number), link)


def _load(request: Fork) -> None:
    """Import the modules of a child here, so that later ones have them at once."""
    sys.path += [path for path in request.module_folders if path not in sys.path]
    arguments = ChildArguments(0, *request.arguments)
    for name in (arguments.server.partition(":")[0], *arguments.modules):
        with suppress(Exception):  # the child reports it
            importlib.import_module(name)


def _start_child(
    request: Fork, connection: int, lifeline: int, report: int, *, has_namespaces: bool
) -> NoReturn:
    try:
        os.dup2(lifeline, 0)
        os.close(lifeline)
        os.chdir(request.folder)
        os.environ.clear()
        os.environ.update(request.environment)
        arguments = ChildArguments(connection, *request.arguments)
        _become_child(arguments, report, has_namespaces=has_namespaces)
    finally:
        os._exit(1)


def _kill_group(child: int) -> None:
    with suppress(OSError):
        os.killpg(child, signal.SIGKILL)
    with suppress(OSError):  # before it has its own group
        os.kill(child, signal.SIGKILL)
