"""Commands in separate processes, to be interrupted and killed, and the traces they leave."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

COMMAND = ("-c", "from hesr.cli import main; main()")

HANG = 120.0
"""Seconds after which something that takes no time has hung, also on a slow, busy machine."""


@contextmanager
def started(
    *arguments: object, folder: Path, program: tuple[str, ...] = COMMAND, **environment: str
) -> Iterator["subprocess.Popen[str]"]:
    """Run Python in its own process group with its own temporary folder."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    process = subprocess.Popen(
        [sys.executable, *program, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=folder,
        env=os.environ | {"TMPDIR": str(temporary)} | environment,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def wait_for(happened: Callable[[], object], process: "subprocess.Popen[str]") -> None:
    end = time.monotonic() + HANG
    while not happened():
        if process.poll() is not None:
            raise AssertionError(process.communicate())
        assert time.monotonic() < end, f"nothing happened for {HANG:.0f} s"
        time.sleep(0.02)


def wait_for_line(process: "subprocess.Popen[str]", matches: Callable[[str], object]) -> None:
    """Read standard error up to a line that matches; a line ends without its newline."""
    assert process.stderr
    read = []
    for line in process.stderr:
        read.append(line)
        if matches(line.rstrip("\n")):
            return
    raise AssertionError(f"standard error ended after {read}")


def running(group: int) -> dict[int, str]:
    """Command lines of a group's processes by PID, without zombies."""
    found = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # Fields after the bracketed name: state, parent, group.
            state, _, of_group = status.read_text().rpartition(")")[2].split()[:3]
            if int(of_group) == group and state not in "ZX":
                command = (status.parent / "cmdline").read_bytes()
                found[int(status.parent.name)] = command.replace(b"\0", b" ").decode()
    return found


def workers(group: int) -> list[int]:
    """PIDs of the worker processes of a group."""
    return [
        number
        for number, command in running(group).items()
        if "hesr_model.support.parallel" in command
    ]


def is_nursery(process: psutil.Process) -> bool:
    """Whether a process forks the children that handle foreign code; it stays until the end."""
    with suppress(psutil.Error, ValueError, IndexError):
        return len(json.loads(process.cmdline()[-2])) == 1
    return False


def list_children() -> list[psutil.Process]:
    """Return the children of this process, with those of its nursery in place of it."""
    found = []
    for child in psutil.Process().children():
        found += child.children() if is_nursery(child) else [child]
    return found


def assert_nothing_left(group: int, folder: Path) -> None:
    """Check that a command run by `started` has left no process and no temporary file."""
    assert_nothing_runs(group)
    assert not list((folder / "tmp").iterdir())


def assert_nothing_runs(group: int) -> None:
    end = time.monotonic() + HANG
    while left := running(group):
        assert time.monotonic() < end, left
        time.sleep(0.05)
