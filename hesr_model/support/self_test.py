"""What a child process can do on this machine, tried there."""

import ctypes
import errno
import mmap
import os
import platform
import socket
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

from hesr_model.support.child import run_in_child
from hesr_model.support.child_main import MAX_FILE_BYTES, MAX_THREADS
from hesr_model.support.files import scratch_folder

_HUGE = 1 << 36  # bytes of memory, more than any limit
_SHMGET = {"x86_64": 29, "aarch64": 194}  # the system call


def find_holes() -> dict[str, bool]:
    """Return what foreign code may not do, and whether it can. Raises DiedError."""
    with scratch_folder() as folder:
        outside = folder / "outside"
        outside.write_text("a file of the user", encoding="utf-8")
        answer = run_in_child(
            f"{__name__}:try_all",
            str(outside),
            os.getpid(),
            folder=folder,
            seconds=60.0,
            readable=[Path(__file__)],
        )
        return {str(deed): bool(succeeds) for deed, succeeds in dict(answer).items()}


def try_all(outside: str, parent: int) -> dict[str, bool]:
    """Try each deed and return whether it succeeds. Called in a child."""
    deeds: dict[str, Callable[[], object]] = {
        "read files of the user": lambda: Path(outside).read_bytes(),
        "write files of the user": lambda: Path(outside).write_bytes(b""),
        "see other processes": _require_other_processes,
        "start processes": _fork,
        "use the network": lambda: socket.socket().close(),
        "use shared memory": _share_memory,
        "make files in memory": lambda: os.close(os.memfd_create("hesr")),
        "signal other processes": lambda: os.kill(parent, 0),
        "change priorities": lambda: os.setpriority(os.PRIO_PROCESS, 0, 19),
        "choose processors": lambda: os.sched_setaffinity(0, os.sched_getaffinity(0)),
        "use memory without a limit": lambda: mmap.mmap(-1, _HUGE).close(),
        "write files without a limit": _write_large_file,
        f"start more than {MAX_THREADS} threads": _start_threads,
    }
    return {deed: _succeeds(attempt) for deed, attempt in deeds.items()}


def _succeeds(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except (OSError, RuntimeError, MemoryError, ValueError, AttributeError):
        return False
    return True


def _share_memory() -> None:
    """Ask for the size of no segment, which fails with ENOENT where it is permitted."""
    number = _SHMGET.get(platform.machine())
    library = ctypes.CDLL(None, use_errno=True)
    if number is None or library.syscall(number, 0x7357_0001, 0, 0) >= 0:
        return
    if ctypes.get_errno() != errno.ENOENT:
        raise OSError


def _fork() -> None:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


def _require_other_processes() -> None:
    own_numbers = {str(os.getpid()), str(os.getppid())}
    numbers = {entry.name for entry in Path("/proc").iterdir() if entry.name.isdigit()}
    if not numbers - own_numbers:
        raise OSError


def _write_large_file() -> None:
    with tempfile.TemporaryFile(dir=".") as file:
        file.truncate(2 * MAX_FILE_BYTES)


def _start_threads() -> None:
    end = threading.Event()
    size = threading.stack_size(1 << 16)
    try:
        for _ in range(MAX_THREADS + 1):
            threading.Thread(target=end.wait, daemon=True).start()
    finally:
        end.set()
        threading.stack_size(size)
