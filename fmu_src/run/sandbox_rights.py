"""Rights that the process of a sandbox gives up on Linux, before it loads foreign code.

Landlock limits files and signals, seccomp system calls; both hold for all threads started later and
cannot be undone.
"""

import ctypes
import logging
import os
import platform
import struct
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

_log = logging.getLogger(__name__)

_LANDLOCK = 444  # system calls: create_ruleset, add_rule, restrict_self
_READ = 1 << 2 | 1 << 3
_EXECUTE = 1  # access rights: files and folders, programs
_FILE = 1 << 1 | 1 << 2 | 1 << 14 | 1 << 15  # of single files: write, read, truncate, control
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}  # number of rights by version of Landlock
_SCOPED = 3  # abstract sockets and signals, from version 6
_NO_NEW_PRIVILEGES = 38
_SECCOMP = 22
_FILTER = 2

_SYSTEM = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/proc/self",
           "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/sys/devices/system/cpu")  # fmt: skip
_DEVICES = ("/dev/null", "/dev/zero", "/dev/random", "/dev/urandom")

# System calls by processor: clone, fcntl, prlimit64; those of signals, whose first argument is a
# process; and those that are refused: sockets, programs, processes, other processes' memory and
# signals, permissions and attributes of files, mounts, keys, clocks, modules.
_CALLS = {
    "x86_64": (0xC000003E, 56, 72, 302, (62, 129, 234, 297), (
        41, 57, 58, 59, 322, 101, 310, 311, 312, 200, 90, 91, 92, 93, 94, 132, 188, 189, 190, 197,
        198, 199, 235, 260, 261, 268, 280, 155, 161, 165, 166, 167, 169, 170, 164, 227, 175, 313,
        246, 320, 248, 249, 250, 272, 308, 298, 304, 321, 323)),
    "aarch64": (0xC00000B7, 220, 25, 261, (129, 138, 131, 240), (
        198, 221, 281, 117, 270, 271, 272, 130, 52, 53, 54, 55, 5, 6, 7, 14, 15, 16, 88, 41, 51, 40,
        39, 224, 142, 161, 170, 112, 105, 273, 104, 294, 217, 218, 219, 97, 268, 241, 265, 280,
        282)),
}  # fmt: skip
_CALLS_OF_BOTH = (*range(424, 435), 438, 440, 442, 452, 463, 466)  # pidfds, io_uring, mounts
_CLONE3 = 435
_THREAD = 0x10000
_OWNERS = (8, 10, 15)  # commands of fcntl that direct signals: F_SETOWN, F_SETSIG, F_SETOWN_EX

_LOAD = 0x20
_EQUAL = 0x15
_AT_LEAST = 0x35
_ANY = 0x45
_RETURN = 0x06  # instructions
_ALLOW = 0x7FFF0000
_REFUSE = 0x00050001
_MISSING = 0x00050026  # results: EPERM, ENOSYS
_NUMBER = 0
_PROCESSOR = 4
_FIRST = 16
_SECOND = 24  # places in the data of a filter


@cache
def warn() -> None:
    """Warn once of promises that this system cannot keep."""
    lacks = []
    if _landlock_version() < 1:
        lacks.append("files (Landlock)")
    elif _landlock_version() < 6 and not _has_seccomp():
        lacks.append("signals (Landlock 6)")
    if not _has_seccomp():
        lacks.append("programs and network (seccomp)")
    if lacks:
        _log.warning(
            "foreign FMUs run with your rights to %s; see SECURITY.md.", " and ".join(lacks)
        )


def give_up(writable: Path, readable: Path) -> None:
    """Give up all rights but to compute, and to read and write below two folders.

    The system's and Python's own files can still be read. Raises OSError.
    """
    if sys.platform != "linux":
        return
    _control(_NO_NEW_PRIVILEGES, 1)
    if _landlock_version() >= 1:
        _restrict_files(writable, [readable, *_python(), *map(Path, _SYSTEM)])
    if _has_seccomp():
        _restrict_calls()


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _call(*arguments: object) -> int:
    result: int = _library().syscall(*map(_long, arguments))
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _long(argument: object) -> object:
    return ctypes.c_long(argument) if isinstance(argument, int) else argument


def _control(*arguments: object) -> None:
    padded = [*map(_long, arguments), *[ctypes.c_long(0)] * (5 - len(arguments))]
    if _library().prctl(*padded) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _landlock_version() -> int:
    if sys.platform != "linux":
        return 0
    try:
        return _call(_LANDLOCK, None, 0, 1)
    except OSError:
        return 0


def _has_seccomp() -> bool:
    if sys.platform != "linux" or platform.machine() not in _CALLS:
        return False
    try:
        _control(_SECCOMP, _FILTER, None)
    except OSError as error:
        return error.errno == 14  # EFAULT: it would read the filter
    return False


def _python() -> Iterator[Path]:
    """Yield folders of modules and libraries, but none that contains the user's home."""
    home = Path(os.path.expanduser("~"))  # noqa: PTH111  # never fails
    folder_names = [*sys.path, sys.prefix, sys.base_prefix, *sysconfig.get_paths().values()]
    folder_names += os.environ.get("LD_LIBRARY_PATH", "").split(":")
    for path in {Path(name) for name in folder_names if name}:
        if not home.is_relative_to(path):
            yield path


def _restrict_files(writable: Path, readable: Sequence[Path]) -> None:
    version = _landlock_version()
    rights = (1 << _RIGHTS[min(version, max(_RIGHTS))]) - 1
    scoped = _SCOPED if version >= 6 else 0
    about = struct.pack("<QQQ", rights, 0, scoped)[: 24 if scoped else 8]
    rules = _call(_LANDLOCK, about, len(about), 0)
    try:
        for paths, allowed in (
            (readable, _READ),
            (map(Path, _DEVICES), _READ | _FILE),
            ([writable], rights & ~_EXECUTE),
        ):
            for path in paths:
                with suppress(FileNotFoundError):
                    _allow(rules, path, allowed & rights)
        _call(_LANDLOCK + 2, rules, 0)
    finally:
        os.close(rules)


def _allow(rules: int, path: Path, allowed: int) -> None:
    handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        if not path.is_dir():
            allowed &= _FILE
        _call(_LANDLOCK + 1, rules, 1, struct.pack("<Qi", allowed, handle), 0)
    finally:
        os.close(handle)


def _restrict_calls() -> None:
    """Refuse system calls with EPERM; clone3, whose flags are hidden, does not exist."""
    processor, clone, fcntl, limits, signals, refused = _CALLS[platform.machine()]
    steps = [
        (_LOAD, _PROCESSOR), (_EQUAL, processor, 1, 0), (_RETURN, _REFUSE),
        (_LOAD, _NUMBER), (_AT_LEAST, 1 << 30, 0, 1), (_RETURN, _REFUSE),
        (_EQUAL, _CLONE3, 0, 1), (_RETURN, _MISSING),
    ]  # fmt: skip
    for number in (*refused, *(n for n in _CALLS_OF_BOTH if n != _CLONE3)):
        steps += [(_EQUAL, number, 0, 1), (_RETURN, _REFUSE)]
    steps += [(_EQUAL, clone, 0, 4), (_LOAD, _FIRST), (_ANY, _THREAD, 1, 0), (_RETURN, _REFUSE),
              (_RETURN, _ALLOW)]  # fmt: skip
    process_id = os.getpid()
    for number, offset, allowed in (
        (limits, _FIRST, (0, process_id)),
        *((number, _FIRST, (process_id, -process_id & 0xFFFFFFFF)) for number in signals),
    ):
        first, second = allowed
        steps += [(_EQUAL, number, 0, 5), (_LOAD, offset), (_EQUAL, first, 2, 0),
                  (_EQUAL, second, 1, 0), (_RETURN, _REFUSE), (_RETURN, _ALLOW)]  # fmt: skip
    steps += [(_EQUAL, fcntl, 0, len(_OWNERS) + 3), (_LOAD, _SECOND)]
    steps += [(_EQUAL, command, len(_OWNERS) - k, 0) for k, command in enumerate(_OWNERS)]
    steps += [(_RETURN, _ALLOW), (_RETURN, _REFUSE), (_RETURN, _ALLOW)]
    code = b"".join(struct.pack("<HBBI", step[0], *(step[2:] or (0, 0)), step[1]) for step in steps)
    code_buffer = ctypes.create_string_buffer(code, len(code))
    program = struct.pack("<HxxxxxxQ", len(steps), ctypes.addressof(code_buffer))
    _control(_SECCOMP, _FILTER, program)
