"""Other programs, run with a time limit; none of the processes that they start outlives it."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_MOST_OUTPUT = 4 << 20
_WORKER = Path(__file__).with_name("worker.py")


class FailedError(Exception):
    """A program gave no answer; the text says why and has no full stop."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a program ended and what it wrote."""

    code: int
    text: str


def run(command: Sequence[str], folder: Path, seconds: float) -> Ended:
    """Run a program in a folder.

    Raises
    ------
    FailedError
        If it cannot be started or takes too long.
    """
    with tempfile.TemporaryFile(dir=folder) as output:
        try:
            # A session of its own: on timeout what the program has started ends with it.
            process = subprocess.Popen(
                list(command),
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise FailedError(f"it cannot be started ({error.strerror})") from error
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired as error:
            raise FailedError(f"it gave no answer within {seconds:g} s") from error
        finally:
            _end(process)
        output.seek(0)
        return Ended(code=code, text=output.read(_MOST_OUTPUT).decode("utf-8", "replace"))


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is not None:
        return
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def work(job: str, file: Path, folder: Path, seconds: float) -> Any:
    """Do a job of `worker.py` in a process of its own.

    Raises
    ------
    FailedError
        If it crashes or takes too long.
    """
    answer = folder / "answer.json"
    answer.unlink(missing_ok=True)
    # -P: what lies in the current folder is not imported.
    command = (sys.executable, "-P", str(_WORKER), job, str(file), str(answer))
    ended = run(command, folder, seconds)
    if ended.code < 0:
        raise FailedError(f"it crashed with signal {-ended.code}")
    if ended.code or not answer.exists():
        lines = ended.text.strip().splitlines() or ["no message"]
        raise FailedError(f"it failed with '{lines[-1].rstrip('.')}'")
    return json.loads(answer.read_text(encoding="utf-8"))
