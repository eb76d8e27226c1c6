"""Other programs, run with a time limit, without surviving descendants."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from secrets import token_hex
from subprocess import CompletedProcess
from typing import Any

_MAX_OUTPUT = 4 << 20
# 1 is PR_SET_PDEATHSIG, 9 is SIGKILL.
_TIED_SCRIPT = """import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9)
os.getppid() == int(sys.argv[1]) or sys.exit(1); os.execvp(sys.argv[2], sys.argv[2:])"""
_ROUNDS = 10  # a process may start others before it is killed


_SAFE_PATH = {"PYTHONSAFEPATH": "1"}  # as -P, for all Python that is started

_STANDARD_ERROR = 2  # descriptor


class FailedError(Exception):
    """A program gave no answer; the text is a reason without full stop."""


class DiedError(Exception):
    """A process has ended without an answer; the text names the call and the end."""


class ChildProcess:
    """A program in its own session, whose variable `mark` identifies descendants; FailedError.

    It sees the variables `environment` and those `inherited`, by default all of this process.
    """

    def __init__(
        self,
        command: Sequence[str],
        folder: Path | None,
        *,
        mark: str = "",
        environment: Mapping[str, str] | None = None,
        inherited: Mapping[str, str] | None = None,
        start_new_session: bool = True,
        **popen_options: Any,
    ) -> None:
        self._mark = mark or new_mark()
        variables = dict(os.environ if inherited is None else inherited)
        variables |= _SAFE_PATH
        variables |= {self._mark: "1"}
        variables |= environment or {}
        try:
            self.process = subprocess.Popen(
                list(command),
                cwd=folder,
                env=variables,
                start_new_session=start_new_session,
                **popen_options,
            )
        except OSError as error:
            raise FailedError(f"it cannot be started ({error.strerror})") from error

    def end(self) -> None:
        """Kill the program, its session and descendants."""
        # After a wait, another program may have the process ID.
        if self.process.poll() is None:
            if hasattr(os, "killpg"):
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(self.process.pid, signal.SIGKILL)
            self.process.kill()
            self.process.wait()
        kill_by_mark(self._mark)


def new_mark() -> str:
    """Return a new mark of processes, an environment variable."""
    return f"HESR_PROCESS_{token_hex(8)}"


def kill_by_mark(mark: str) -> None:
    """Kill all other processes with a mark."""
    import psutil

    for _ in range(_ROUNDS):
        marked_processes = [
            process
            for process in psutil.process_iter(["environ"])
            if mark in (process.info["environ"] or ()) and process.pid != os.getpid()
        ]
        if not marked_processes:
            return
        for process in marked_processes:
            with contextlib.suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(marked_processes, timeout=1.0)


def python_command(*arguments: str) -> list[str]:
    """Return a command that runs Python and imports nothing from the current folder.

    Without -P, `python -c` and `python -m` would execute a json.py that lies there.
    """
    return [sys.executable, "-P", *arguments]


def keep_current_folder_out() -> None:
    """Let no Python that libraries start import from the current folder; glfw runs `python -c`."""
    os.environ.update(_SAFE_PATH)


def tie_command(command: Sequence[str]) -> Sequence[str]:
    """Return a command whose program ends with this process, also if it is killed (Linux)."""
    if sys.platform != "linux":
        return command
    return (sys.executable, "-ISc", _TIED_SCRIPT, str(os.getpid()), *command)


def run(
    command: Sequence[str],
    folder: Path,
    seconds: float,
    environment: Mapping[str, str] | None = None,
    *,
    start_new_session: bool = True,
) -> CompletedProcess[str]:
    """Run a program in a folder; raises FailedError, also after `seconds`.

    It sees the variables of this process, or those of an `environment` only. Without a session of
    its own, signals to the group of this process reach it.
    """
    with tempfile.TemporaryFile(dir=folder) as output:
        child = ChildProcess(
            command,
            folder,
            inherited=environment,
            start_new_session=start_new_session,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            code = child.process.wait(seconds)
        except subprocess.TimeoutExpired as error:
            raise FailedError(f"it gave no answer within {seconds:g} s") from error
        finally:
            child.end()
        output.seek(0)
        text = output.read(_MAX_OUTPUT).decode("utf-8", "replace")
        return CompletedProcess(command, code, text)


@contextlib.contextmanager
def collect_errors() -> Iterator[list[str]]:
    """Yield a list that afterwards holds the lines that libraries wrote to standard error.

    They write to the descriptor, which belongs to the whole process.
    """
    lines: list[str] = []
    try:
        saved = os.dup(_STANDARD_ERROR)
    except OSError:  # it is closed
        yield lines
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), _STANDARD_ERROR)
        try:
            yield lines
        finally:
            os.dup2(saved, _STANDARD_ERROR)
            os.close(saved)
            file.seek(0)
            lines += file.read().decode(errors="replace").splitlines()


def describe_end(code: int) -> str:
    """Return how a program ended, for messages."""
    if code >= 0:
        return f"ended its process with exit code {code}"
    with contextlib.suppress(ValueError):
        return f"crashed with signal {-code} ({signal.Signals(-code).name})"
    return f"crashed with signal {-code}"
