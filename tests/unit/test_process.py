"""Exit statuses of processes in words, and programs that end with their parent."""

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from hesr_model.support.process import describe_end, run, tie_command


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0, "ended its process with exit code 0"),
        (1, "ended its process with exit code 1"),
        (-11, "crashed with signal 11 (SIGSEGV)"),
    ],
)
def test_exit_status_in_words(code: int, text: str) -> None:
    assert describe_end(code) == text


@pytest.mark.skipif(sys.platform != "linux", reason="the system must end it with its parent")
def test_a_tied_program_ends_with_its_killed_parent(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from hesr_model.support.process import run, "
        "tie_command\n"
        "run(tie_command(['sh', '-c', 'echo $$ > pid; exec sleep 100']), Path(sys.argv[1]), 100.0)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)])
    try:
        file = tmp_path / "pid"
        wait_for(lambda: file.exists() and file.read_text().strip() != "")
        program = psutil.Process(int(file.read_text()))
        assert program.is_running()
    finally:
        parent.kill()
        parent.wait()
    with suppress(psutil.NoSuchProcess):
        wait_for(lambda: program.status() == psutil.STATUS_ZOMBIE)


@pytest.mark.skipif(sys.platform != "linux", reason="the system must end it with its parent")
def test_a_tied_program_keeps_its_output_and_exit_code(tmp_path: Path) -> None:
    ended = run(
        tie_command([sys.executable, "-c", "print(7); raise SystemExit(3)"]), tmp_path, 60.0
    )
    assert (ended.returncode, ended.stdout) == (3, "7\n")


def wait_for(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)
