"""The one way to handle foreign code and files: a child process with few rights and limits.

Its answers are JSON, bounded and checked by the caller, and no objects to load.
"""

import atexit
import json
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hesr_model.support import child_main, rights
from hesr_model.support.process import (
    ChildProcess,
    DiedError,
    FailedError,
    describe_end,
    python_command,
)
from hesr_model.support.text import sanitise

RUN_TIMEOUT = 3600.0  # [s] of a run
MAX_MEMORY_BYTES = 4 << 30  # of the process
INVALID_ANSWER = "gave an invalid answer and was ended"
ENVIRONMENT = "HESR_FMU_ENVIRONMENT"
"""Variable that names further variables which children see, separated by commas."""

_SERVER = "hesr_model.support.child_main:serve"
_START = (
    "import json, sys; sys.path += [path for path in json.loads(sys.argv.pop()) if path not in "
    "sys.path]; from hesr_model.support.child_main import main; main()"
)
# What libraries and their threads look for; all other variables may hold secrets.
_VARIABLES = {"PATH", "HOME", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "JAVA_HOME",
              "JAVA_TOOL_OPTIONS", "SYSTEMROOT", "SYSTEMDRIVE", "WINDIR", "COMSPEC", "PATHEXT",
              "NUMBER_OF_PROCESSORS", "PROCESSOR_ARCHITECTURE", "USERPROFILE"}  # fmt: skip
_PREFIXES = ("LC_", "DYLD_", "OMP_", "GOMP_", "KMP_", "MKL_", "OPENBLAS_", "BLIS_", "VECLIB_")
_POLL_PERIOD = 0.1  # [s] between checks of the process
_END_TIMEOUT = 5.0  # [s] to end by itself
_RECEIVE_SIZE = 1 << 20  # bytes received at once
_MAX_REPORT_BYTES = 1000
_MAX_RESULT_BYTES = 64 << 20
_MAX_ANSWER_BYTES = 1 << 20

_log = logging.getLogger(__name__)
_told_risks: set[str] = set()


class Child:
    """A child process in an empty folder that answers requests within `seconds` [s] each.

    All requests of a run, or of a process without runs, must be answered within `total` [s]. The
    process may read the files and folders `readable`, use some `memory` [B], and imports `modules`
    at once.

    Otherwise it raises DiedError with the end of a sentence.
    """

    def __init__(
        self,
        folder: Path,
        seconds: float,
        readable: Sequence[Path],
        *modules: str,
        total: float = RUN_TIMEOUT,
        memory: int = MAX_MEMORY_BYTES,
        server: str = _SERVER,
    ) -> None:
        self.seconds = seconds
        self._total = total
        self._ended = False
        self._has_reported = False  # which mechanisms hold
        self._is_alone = False  # it cannot start processes that remain
        self.begin()
        self._socket, theirs = socket.socketpair()
        self._socket.settimeout(_POLL_PERIOD)
        theirs.set_inheritable(True)
        arguments = child_main.ChildArguments(
            connection=theirs.fileno(),
            readable=[str(path.resolve()) for path in readable],
            memory=memory,
            server=server,
            modules=list(modules),
        )
        try:
            self._child = _start(arguments, folder)
        except (FailedError, OSError) as error:
            self._socket.close()
            raise DiedError(f"has no process: {error}") from error
        finally:
            theirs.close()

    def begin(self) -> None:
        """Begin a run, which has `total` seconds."""
        self._run_deadline = time.monotonic() + self._total

    def ask(self, request: Any, limit: int = _MAX_ANSWER_BYTES) -> Any:
        """Return the answer to a request, at most `limit` bytes."""
        answer = self._exchange(request, limit)
        self._require_silence()
        return answer

    def _exchange(self, request: Any, limit: int) -> Any:
        """Return an answer, which buffers may follow."""
        data = json.dumps(request).encode()
        self._answer_deadline = time.monotonic() + self.seconds
        try:
            if not self._has_reported:
                self._warn_of_risks()
            self._send(child_main.LENGTH.pack(len(data)) + data)
            length = child_main.LENGTH.unpack(self._receive(child_main.LENGTH.size))[0]
            if length > limit:
                raise self.end_process(INVALID_ANSWER)
            return json.loads(self._receive(length))
        except OSError as error:  # a closed connection included
            raise self.end_process(self._describe_end()) from error
        except (ValueError, RecursionError) as error:
            raise self.end_process(INVALID_ANSWER) from error

    def run(self, function: str, *arguments: Any) -> Any:
        """Return the result of "module:function", called in the process with JSON data."""
        answer = self.ask({"run": [function, *arguments]}, _MAX_RESULT_BYTES)
        self._require_result(answer)
        try:
            return answer["result"]
        except (TypeError, KeyError) as error:
            raise self.end_process(INVALID_ANSWER) from error

    def iterate(
        self, function: str, *arguments: Any, limit: int
    ) -> Iterator[tuple[Any, list[bytearray]]]:
        """Yield the items of "module:function", an iterator: JSON data and at most `limit` bytes.

        Each item must come within `seconds`.
        """
        request: dict[str, Any] = {"iterate": [function, *arguments]}
        while True:
            answer = self._exchange(request, _MAX_RESULT_BYTES)
            self._require_result(answer)
            if not answer:
                return
            try:
                sizes = [_require_size(size) for size in answer["sizes"]]
                item = answer["item"]
            except (TypeError, KeyError, ValueError) as error:
                raise self.end_process(INVALID_ANSWER) from error
            if sum(sizes) > limit:
                raise self.end_process(INVALID_ANSWER)
            try:
                buffers = [self._receive(size) for size in sizes]
            except OSError as error:
                raise self.end_process(self._describe_end()) from error
            self._require_silence()
            yield item, buffers
            request = {"next": True}

    def _require_result(self, answer: Any) -> None:
        """End the process if its function has failed, or if its answer is none."""
        if not isinstance(answer, dict):
            raise self.end_process(INVALID_ANSWER)
        if "raised" in answer:
            reason = sanitise(str(answer["raised"]), 400).rstrip(".")
            raise self.end_process(f"failed with '{reason}'")

    def end_process(self, reason: str) -> DiedError:
        """End the process and return the error."""
        self.kill()
        return DiedError(reason)

    def kill(self) -> None:
        """End the process and its descendants."""
        if self._ended:
            return
        self._ended = True
        self._socket.close()
        process = self._child.process
        for stream in (process.stdin, process.stdout):
            if stream:
                stream.close()
        if self._is_alone:
            # Without its input it kills the child and then ends, which leaves no zombies.
            with suppress(subprocess.TimeoutExpired):
                process.wait(_END_TIMEOUT)
                return
        self._child.end()

    def _warn_of_risks(self) -> None:
        """Warn once of what foreign code can do here; wait for the process to say what holds."""
        stream = self._child.process.stdout
        assert stream is not None
        report = b""
        while not report.endswith(b"\n"):
            if sys.platform != "win32":  # there only sockets can be waited for
                while not select.select([stream], [], [], _POLL_PERIOD)[0]:
                    self._require_time()
            piece = os.read(stream.fileno(), _MAX_REPORT_BYTES)
            if not piece:
                raise ConnectionError
            report += piece
        self._has_reported = True
        held = json.loads(report)
        self._is_alone = rights.NAMESPACES.name in held or rights.SECCOMP.name in held
        warn_of_risks(held)

    def _send(self, data: bytes) -> None:
        unsent = memoryview(data)
        while unsent:
            with suppress(TimeoutError):
                unsent = unsent[self._socket.send(unsent) :]
            self._require_time()

    def _receive(self, size: int) -> bytearray:
        """Return the next `size` bytes of an answer."""
        data = bytearray(size)
        missing = memoryview(data)
        while missing:
            try:
                count = self._socket.recv_into(missing, min(len(missing), _RECEIVE_SIZE))
            except TimeoutError:
                # Descendants may keep the connection open.
                if self._child.process.poll() is not None:
                    raise ConnectionError from None
                self._extend_deadline()
                self._require_time()
                continue
            if not count:
                raise ConnectionError
            missing = missing[count:]
            if missing:
                self._require_time()
        return data

    def _require_silence(self) -> None:
        """End the process if bytes follow its answer."""
        self._socket.settimeout(0.0)
        try:
            surplus = self._socket.recv(1)
        except OSError:  # nothing yet, or the end, which the next request meets
            surplus = b""
        finally:
            self._socket.settimeout(_POLL_PERIOD)
        if surplus:
            raise self.end_process(INVALID_ANSWER)

    def _extend_deadline(self) -> None:
        """Give an answer that makes progress more time; by default none does."""

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


def run_in_child(
    function: str,
    *arguments: Any,
    folder: Path,
    seconds: float,
    memory: int = MAX_MEMORY_BYTES,
    readable: Sequence[Path] | None = None,
    modules: Sequence[str] = (),
) -> Any:
    """Do `Child.run` in a new child.

    It may read `readable`, by default the path in the first argument. Raises DiedError.
    """
    with TemporaryDirectory(dir=folder) as process_folder:
        paths = readable
        if paths is None:
            paths = [Path(arguments[0])]
        module = function.partition(":")[0]
        child = Child(Path(process_folder), seconds, paths, module, *modules, memory=memory)
        try:
            return child.run(function, *arguments)
        finally:
            child.kill()


def _require_size(size: object) -> int:
    if type(size) is not int or size < 0:
        raise ValueError("a size is no natural number")
    return size


def warn_of_risks(held: Collection[str]) -> None:
    """Warn of what foreign code can do without mechanisms that this machine lacks, each once."""
    lacking = [mechanism for mechanism in rights.MECHANISMS if mechanism.name not in held]
    risks = [f"{mechanism.risk} (no {mechanism.name})" for mechanism in lacking]
    if set(risks) <= _told_risks:
        return
    _told_risks.update(risks)
    _log.warning("foreign code can here %s; see SECURITY.md.", "; ".join(risks))


def _start(arguments: child_main.ChildArguments, folder: Path) -> "ChildProcess | ForkedProcess":
    """Start the process of a child in a folder; raises FailedError or OSError."""
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder.resolve()))
    environment = _select_environment() | temporary
    if hasattr(os, "pidfd_open"):
        with suppress(FailedError, OSError):
            return _nursery.fork(arguments, folder, environment)
    # On Windows the connection is a handle, which cannot be selected.
    is_windows = sys.platform == "win32"
    inherited_files = () if is_windows else (arguments.connection,)
    return ChildProcess(
        _build_command(arguments),
        folder,
        inherited=environment,
        stdin=subprocess.PIPE,  # closed when this process ends
        stdout=subprocess.PIPE,  # the mechanisms that hold
        stderr=subprocess.DEVNULL,
        close_fds=not is_windows,
        pass_fds=inherited_files,
    )


def _build_command(arguments: Sequence[Any]) -> list[str]:
    # -I: no variable and no file of the user or the current folder changes Python.
    return python_command(
        "-I", "-c", _START, json.dumps(arguments), json.dumps(_list_module_folders())
    )


class ForkedProcess:
    """The process of a child of the nursery, used as `ChildProcess` and its `process`."""

    def __init__(self, lifeline: int, report: int, link: socket.socket) -> None:
        self.stdin = os.fdopen(lifeline, "wb")
        self.stdout = os.fdopen(report, "rb", buffering=0)
        self._link = link
        self.returncode: int | None = None

    @property
    def process(self) -> "ForkedProcess":
        """The process itself."""
        return self

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal, or None while it runs."""
        with suppress(subprocess.TimeoutExpired):
            return self.wait(0.0)
        return None

    def wait(self, timeout: float) -> int:
        """Return the exit code; raises subprocess.TimeoutExpired after `timeout` [s]."""
        if self.returncode is None:
            self._link.settimeout(timeout)
            try:
                status = self._link.recv(child_main.STATUS.size)
            except (TimeoutError, BlockingIOError) as error:
                raise subprocess.TimeoutExpired("a child", timeout) from error
            except OSError:
                status = b""
            if len(status) == child_main.STATUS.size:
                code = child_main.STATUS.unpack(status)[0]
            else:  # the nursery was killed, and its children with it
                code = signal.SIGKILL
            self.returncode = os.waitstatus_to_exitcode(code)
            self._link.close()
        return self.returncode

    def end(self) -> None:
        """Kill the process; its supervisors end with it."""
        if self.returncode is None:
            with suppress(OSError):
                self._link.shutdown(socket.SHUT_WR)
            with suppress(subprocess.TimeoutExpired):
                self.wait(_END_TIMEOUT)
        self._link.close()


class _Nursery:
    """A process that forks children, started with the first one; it ends with this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._owner = 0  # process that has started it
        self._control: socket.socket | None = None

    def fork(
        self, arguments: child_main.ChildArguments, folder: Path, environment: dict[str, str]
    ) -> ForkedProcess:
        """Fork a child in a folder with an environment; raises FailedError or OSError."""
        request = child_main.Fork(
            list(arguments[1:]), str(folder.resolve()), environment, _list_module_folders()
        )
        data = json.dumps(request).encode()
        if len(data) > child_main.MAX_REQUEST_BYTES:
            raise FailedError("its environment is too large")
        link, their_link = socket.socketpair()
        their_lifeline, lifeline = os.pipe()
        report, their_report = os.pipe()
        files = (arguments.connection, their_lifeline, their_report, their_link.fileno())
        try:
            with self._lock:
                self._send(data, files)
        except BaseException:
            link.close()
            os.close(lifeline)
            os.close(report)
            raise
        finally:
            os.close(their_lifeline)
            os.close(their_report)
            their_link.close()
        return ForkedProcess(lifeline, report, link)

    def _send(self, data: bytes, files: Sequence[int]) -> None:
        if self._control is None or self._owner != os.getpid():
            self._control = self._start()
        try:
            socket.send_fds(self._control, [data], files)
        except OSError:  # the nursery was killed
            self._control = self._start()
            socket.send_fds(self._control, [data], files)

    def _start(self) -> socket.socket:
        control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            nursery = ChildProcess(
                _build_command([theirs.fileno()]),
                Path("/"),
                inherited=_select_environment(),
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        except FailedError:
            control.close()
            raise
        finally:
            theirs.close()
        self._owner = os.getpid()
        atexit.register(self._close, control, nursery)
        return control

    def _close(self, control: socket.socket, nursery: ChildProcess) -> None:
        control.close()
        if self._owner == os.getpid():  # not in a fork
            nursery.process.kill()  # its children end with their inputs
            nursery.process.wait()


_nursery = _Nursery()


def _list_module_folders() -> list[str]:
    """Return the folders of modules that are not Python's own, and no relative ones."""
    own_folder = str(Path(__file__).parents[2])
    folders = [path for path in sys.path if Path(path).is_absolute() and path != str(Path.cwd())]
    return [*folders, own_folder]


def _select_environment() -> dict[str, str]:
    names = {*_VARIABLES, *os.environ.get(ENVIRONMENT, "").replace(",", " ").split()}
    return {
        name: value
        for name, value in os.environ.items()
        if name in names or name.startswith(_PREFIXES)
    }
