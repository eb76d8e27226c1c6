"""Other programs, run with a time limit; none of the processes that they start outlives them."""

import contextlib
import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any

_MOST_OUTPUT = 4 << 20
_ROUNDS = 10  # a process that is found may have started others since


class FailedError(Exception):
    """A program gave no answer; the text says why and has no full stop."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a program ended and what it wrote."""

    code: int
    text: str


class Started:
    """A program that runs in a session of its own.

    Parameters
    ----------
    command : program and arguments.
    folder : in which it runs.
    more : further arguments of `subprocess.Popen`.

    Attributes
    ----------
    process : the program.

    Raises
    ------
    FailedError
        If it cannot be started.
    """

    def __init__(self, command: Sequence[str], folder: Path, **more: Any) -> None:
        # All that descends from the program has this in its environment, also what has left its
        # session and lost its parent.
        self._mark = f"HESR_PROCESS_{token_hex(8)}"
        try:
            self.process = subprocess.Popen(
                list(command),
                cwd=folder,
                env=os.environ | {self._mark: "1"},
                start_new_session=True,
                **more,
            )
        except OSError as error:
            raise FailedError(f"it cannot be started ({error.strerror})") from error

    def end(self) -> None:
        """End it, and all processes that it has started."""
        # Once it has been waited for, its number may be that of another program.
        if self.process.poll() is None:
            if hasattr(os, "killpg"):
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(self.process.pid, signal.SIGKILL)
            self.process.kill()
            self.process.wait()
        self._end_descendants()

    def _end_descendants(self) -> None:
        import psutil  # slow to import

        for _ in range(_ROUNDS):
            found = [
                other
                for other in psutil.process_iter(["environ"])
                if self._mark in (other.info["environ"] or ()) and other.pid != os.getpid()
            ]
            if not found:
                return
            for other in found:
                with contextlib.suppress(psutil.Error):
                    other.kill()
            psutil.wait_procs(found, timeout=1.0)


def run(command: Sequence[str], folder: Path, seconds: float) -> Ended:
    """Run a program in a folder.

    Raises
    ------
    FailedError
        If it cannot be started or takes too long.
    """
    with tempfile.TemporaryFile(dir=folder) as output:
        started = Started(
            command,
            folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            code = started.process.wait(seconds)
        except subprocess.TimeoutExpired as error:
            raise FailedError(f"it gave no answer within {seconds:g} s") from error
        finally:
            started.end()
        output.seek(0)
        return Ended(code=code, text=output.read(_MOST_OUTPUT).decode("utf-8", "replace"))


def how_it_ended(code: int) -> str:
    """Return how a program ended, from its exit code, as the end of a sentence without full stop.

    Codes below zero are those of signals, as `subprocess` gives them.
    """
    if code >= 0:
        return f"ended its process with exit code {code}"
    with contextlib.suppress(ValueError):
        return f"crashed with signal {-code} ({signal.Signals(-code).name})"
    return f"crashed with signal {-code}"
