"""Rights that a process for foreign code or files gives up on Linux, before it handles them.

Landlock limits files and signals, seccomp system calls; both hold for all threads started later and
cannot be undone. Namespaces hide other processes and their objects.
"""

import ctypes
import errno
import os
import platform
import signal
import struct
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, NoReturn

_LANDLOCK = 444  # system calls: create_ruleset, add_rule, restrict_self
# Access rights of Landlock.
_READ = 1 << 2 | 1 << 3  # of files and folders
_EXECUTE = 1  # of programs
_FILE = 1 << 1 | 1 << 2 | 1 << 14 | 1 << 15  # of single files: write, read, truncate, control
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}  # number of rights by version of Landlock
_SCOPED = 3  # abstract sockets and signals, from version 6
# Options of prctl.
_END_SIGNAL = 1  # PR_SET_PDEATHSIG
_SECCOMP = 22
_FILTER = 2
_ADOPT_ORPHANS = 36  # PR_SET_CHILD_SUBREAPER
_NO_NEW_PRIVILEGES = 38
_NAMESPACES = 0x10000000 | 0x20000000 | 0x08000000 | 0x40000000  # users, PIDs, IPC, network
_CAPABILITIES_VERSION = 0x20080522

_SYSTEM = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/proc/self",
           "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/sys/devices/system/cpu")  # fmt: skip
_DEVICES = ("/dev/null", "/dev/zero", "/dev/random", "/dev/urandom")

_PROCESSORS = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}  # column below, AUDIT_ARCH
CALLS: dict[str, tuple[int | None, int | None]] = {
    # Files.
    "read": (0, 63), "write": (1, 64), "readv": (19, 65), "writev": (20, 66), "pread64": (17, 67),
    "pwrite64": (18, 68), "preadv": (295, 69), "pwritev": (296, 70), "preadv2": (327, 286),
    "pwritev2": (328, 287), "open": (2, None), "openat": (257, 56), "openat2": (437, 437),
    "creat": (85, None), "close": (3, 57), "close_range": (436, 436), "lseek": (8, 62),
    "stat": (4, None), "fstat": (5, 80), "lstat": (6, None), "newfstatat": (262, 79),
    "statx": (332, 291), "statfs": (137, 43), "fstatfs": (138, 44), "access": (21, None),
    "faccessat": (269, 48), "faccessat2": (439, 439), "readlink": (89, None),
    "readlinkat": (267, 78), "getcwd": (79, 17), "chdir": (80, 49), "fchdir": (81, 50),
    "getdents": (78, None), "getdents64": (217, 61), "mkdir": (83, None), "mkdirat": (258, 34),
    "rmdir": (84, None), "unlink": (87, None), "unlinkat": (263, 35), "rename": (82, None),
    "renameat": (264, 38), "renameat2": (316, 276), "symlink": (88, None), "symlinkat": (266, 36),
    "truncate": (76, 45), "ftruncate": (77, 46), "fallocate": (285, 47), "fadvise64": (221, 223),
    "fsync": (74, 82), "fdatasync": (75, 83), "sendfile": (40, 71), "copy_file_range": (326, 285),
    "umask": (95, 166), "dup": (32, 23), "dup2": (33, None), "dup3": (292, 24), "pipe": (22, None),
    "pipe2": (293, 59),
    # Waiting for files.
    "poll": (7, None), "ppoll": (271, 73), "select": (23, None), "pselect6": (270, 72),
    "epoll_create": (213, None), "epoll_create1": (291, 20), "epoll_ctl": (233, 21),
    "epoll_wait": (232, None), "epoll_pwait": (281, 22), "epoll_pwait2": (441, 441),
    "eventfd": (284, None), "eventfd2": (290, 19),
    # Memory.
    "brk": (12, 214), "mmap": (9, 222), "munmap": (11, 215), "mremap": (25, 216),
    "mprotect": (10, 226), "madvise": (28, 233), "msync": (26, 227), "mincore": (27, 232),
    "membarrier": (324, 283),
    # Threads.
    "futex": (202, 98), "futex_waitv": (449, 449), "futex_wake": (454, 454),
    "futex_wait": (455, 455), "futex_requeue": (456, 456), "set_tid_address": (218, 96),
    "set_robust_list": (273, 99), "rseq": (334, 293),
    "sched_yield": (24, 124), "sched_getaffinity": (204, 123), "sched_get_priority_max": (146, 125),
    "sched_get_priority_min": (147, 126), "getcpu": (309, 168), "gettid": (186, 178),
    "exit": (60, 93), "exit_group": (231, 94),
    # Time.
    "nanosleep": (35, 101), "clock_nanosleep": (230, 115), "clock_gettime": (228, 113),
    "clock_getres": (229, 114), "gettimeofday": (96, 169), "time": (201, None), "times": (100, 153),
    "getitimer": (36, 102), "setitimer": (38, 103), "alarm": (37, None), "timer_create": (222, 107),
    "timer_settime": (223, 110), "timer_gettime": (224, 108), "timer_getoverrun": (225, 109),
    "timer_delete": (226, 111),
    # Own signals.
    "rt_sigaction": (13, 134), "rt_sigprocmask": (14, 135), "rt_sigreturn": (15, 139),
    "rt_sigpending": (127, 136), "rt_sigsuspend": (130, 133), "rt_sigtimedwait": (128, 137),
    "sigaltstack": (131, 132), "pause": (34, None), "restart_syscall": (219, 128),
    "wait4": (61, 260), "waitid": (247, 95),
    # Facts.
    "getpid": (39, 172), "getppid": (110, 173), "getuid": (102, 174), "geteuid": (107, 175),
    "getgid": (104, 176), "getegid": (108, 177), "getresuid": (118, 148), "getresgid": (120, 150),
    "getgroups": (115, 158), "getpgrp": (111, None), "getpgid": (121, 155), "getsid": (124, 156),
    "uname": (63, 160), "sysinfo": (99, 179), "getrlimit": (97, 163), "setrlimit": (160, 164),
    "getrusage": (98, 165), "getrandom": (318, 278), "arch_prctl": (158, None), "capget": (125, 90),
    # Arguments.
    "ioctl": (16, 29), "fcntl": (72, 25), "clone": (56, 220), "clone3": (435, 435),
    "prctl": (157, 167), "prlimit64": (302, 261), "kill": (62, 129), "tgkill": (234, 131),
    "rt_sigqueueinfo": (129, 138), "rt_tgsigqueueinfo": (297, 240),
}  # fmt: skip
"""System calls that a library of numbers needs, with their numbers on x86_64 and aarch64.

All others fail with EPERM, among them sockets, programs and processes, other processes' memory,
shared memory and queues, priorities and affinity, keys, io_uring, bpf, performance counters, mounts
and permissions of files.
"""

_THREAD = 0x10000
# Threads in other namespaces, traced or with another parent.
_FOREIGN_CLONES = 0x7E020000 | 0x1000 | 0x2000 | 0x4000 | 0x8000 | 0x800000
_REQUESTS = (0x5401, 0x5413)  # of ioctl: attributes and size of a terminal
_INHERITANCE = (0x5450, 0x5451)  # of ioctl: files of programs; Python uses fcntl after ENOTTY
_COMMANDS = (0, 1, 2, 3, 4, 5, 6, 7, 36, 37, 38, 1030)  # of fcntl: copies, flags and locks
_OPTIONS = (15, 16, 23, 0x53564D41)  # of prctl: names of threads and memory, read capabilities
_OF_ITSELF = ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo")  # first argument: a process

# Instructions of a filter.
_LOAD = 0x20
_EQUAL = 0x15
_ANY = 0x45
_RETURN = 0x06
# Its results.
_ALLOW = 0x7FFF0000
_REFUSE = 0x00050001  # EPERM
_MISSING = 0x00050026  # ENOSYS
_NO_TERMINAL = 0x00050019  # ENOTTY
# Places in its data: the call, the processor and arguments.
_NUMBER = 0
_PROCESSOR = 4
_FIRST = 16
_SECOND = 24
_Instruction = tuple[int, ...]  # code, value, and for comparisons the jumps if true and if false


class Mechanism(NamedTuple):
    """A mechanism of the kernel, and what foreign code can do without it."""

    name: str
    risk: str


LANDLOCK = Mechanism("Landlock", "read and write your files")
SECCOMP = Mechanism(
    "seccomp", "start programs, use the network and shared memory, and send signals"
)
NAMESPACES = Mechanism("namespaces", "see which processes run")
THREADS = Mechanism("thread limit", "start any number of threads")
MECHANISMS = (LANDLOCK, SECCOMP, NAMESPACES, THREADS)


def give_up(writable: Path, readable: Sequence[Path]) -> list[str]:
    """Give up all rights but to compute, to write below a folder, and to read there and elsewhere.

    The system's and Python's own files can still be read. Returns the names of the mechanisms.
    Raises OSError.
    """
    if sys.platform != "linux":
        return []
    held = []
    _control(_NO_NEW_PRIVILEGES, 1)
    if get_landlock_version() >= 1:
        _restrict_files([writable], [*readable, *_list_python_folders(), *map(Path, _SYSTEM)])
        held.append(LANDLOCK.name)
    if has_seccomp():
        _restrict_calls()
        held.append(SECCOMP.name)
    return held


def run_confined(
    command: Sequence[str], writable: Sequence[str], readable: Sequence[str], limit: int
) -> NoReturn:
    """Replace this process by a program that reads and writes below some folders only. Linux only.

    It may execute what lies next to it, has `limit` [s] of processor time, and ends with its
    parent. Raises OSError.
    """
    import resource

    _control(_NO_NEW_PRIVILEGES, 1)
    end_with_parent()
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if get_landlock_version() >= 1:
        _restrict_files(
            [Path(name) for name in writable],
            [Path(name) for name in (*_SYSTEM, *readable)],
            [Path(command[0]).parent],
        )
    os.execv(command[0], list(command))


def enter_namespaces() -> bool:
    """Enter new namespaces of users, processes, IPC and network; return whether all is well.

    Processes started later are in the new namespace of processes. After False the caller must end,
    since it may have no name for its user.
    """
    user = os.getuid()
    group = os.getgid()
    if _library().unshare(_NAMESPACES) != 0:
        return False
    try:
        Path("/proc/self/setgroups").write_text("deny", encoding="ascii")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1", encoding="ascii")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1", encoding="ascii")
    except OSError:
        return False
    return True


def drop_capabilities() -> None:
    """Drop the rights of an administrator, which the new namespace of users has given."""
    header = struct.pack("<Ii", _CAPABILITIES_VERSION, 0)
    if _library().capset(header, bytes(24)) != 0:
        raise _build_error()


def end_with_parent() -> None:
    """Let the kernel kill this process at the end of its parent."""
    _control(_END_SIGNAL, signal.SIGKILL)


def adopt_orphans() -> None:
    """Become the parent of all descendants whose parents end."""
    _control(_ADOPT_ORPHANS, 1)


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _build_error() -> OSError:
    """Return the error of the last call of the C library."""
    code = ctypes.get_errno()
    return OSError(code, os.strerror(code))


def _call(*arguments: object) -> int:
    result: int = _library().syscall(*map(_long, arguments))
    if result < 0:
        raise _build_error()
    return result


def _long(argument: object) -> object:
    if isinstance(argument, int):
        return ctypes.c_long(argument)
    return argument


def _control(*arguments: object) -> None:
    padded = [*arguments, 0, 0, 0, 0, 0][:5]  # prctl reads five
    if _library().prctl(*map(_long, padded)) != 0:
        raise _build_error()


def get_landlock_version() -> int:
    """Return the version of Landlock, 0 without it."""
    if sys.platform != "linux":
        return 0
    try:
        return _call(_LANDLOCK, None, 0, 1)
    except OSError:
        return 0


def has_seccomp() -> bool:
    """Return whether system calls can be filtered on this kernel and processor."""
    if sys.platform != "linux" or platform.machine() not in _PROCESSORS:
        return False
    try:
        _control(_SECCOMP, _FILTER, None)
    except OSError as error:
        return error.errno == errno.EFAULT  # it would read the filter
    return False


def _list_python_folders() -> Iterator[Path]:
    """Yield folders of modules and libraries, but none that contains the user's home."""
    home = Path(os.path.expanduser("~"))  # noqa: PTH111  # Path.home() fails without a home
    folder_names = [*sys.path, sys.prefix, sys.base_prefix, *sysconfig.get_paths().values()]
    folder_names += os.environ.get("LD_LIBRARY_PATH", "").split(":")
    for path in {Path(name) for name in folder_names if name}:
        if not home.is_relative_to(path):
            yield path


def _restrict_files(
    writable: Sequence[Path], readable: Sequence[Path], executable: Sequence[Path] = ()
) -> None:
    """Refuse all access to files but below some folders; those that are missing are left out."""
    version = get_landlock_version()
    rights = (1 << _RIGHTS[min(version, max(_RIGHTS))]) - 1
    attributes = struct.pack("<Q", rights)
    if version >= 6:
        attributes = struct.pack("<QQQ", rights, 0, _SCOPED)
    rules = _call(_LANDLOCK, attributes, len(attributes), 0)
    grants = [(path, _READ) for path in readable]
    grants += [(path, _READ | _EXECUTE) for path in executable]
    grants += [(Path(name), _READ | _FILE) for name in _DEVICES]
    grants += [(path, rights & ~_EXECUTE) for path in writable]
    try:
        for path, allowed in grants:
            with suppress(FileNotFoundError, PermissionError):
                _allow(rules, path, allowed & rights)
        _call(_LANDLOCK + 2, rules, 0)
    finally:
        os.close(rules)


def _allow(rules: int, path: Path, allowed: int) -> None:
    handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        if not path.is_dir():
            allowed &= _FILE | _EXECUTE
        _call(_LANDLOCK + 1, rules, 1, struct.pack("<Qi", allowed, handle), 0)
    finally:
        os.close(handle)


def _restrict_calls() -> None:
    """Refuse all system calls but `CALLS`; clone3, whose flags are hidden, does not exist."""
    column, processor = _PROCESSORS[platform.machine()]
    instructions: list[_Instruction] = [
        (_LOAD, _PROCESSOR), (_EQUAL, processor, 1, 0), (_RETURN, _REFUSE), (_LOAD, _NUMBER),
    ]  # fmt: skip
    checks = _list_checks()
    for name, numbers in CALLS.items():
        number = numbers[column]
        if number is not None:
            check = checks.get(name, [(_RETURN, _ALLOW)])
            instructions += [(_EQUAL, number, 0, len(check)), *check]
    instructions.append((_RETURN, _REFUSE))
    code = b"".join(map(_encode, instructions))
    code_buffer = ctypes.create_string_buffer(code, len(code))
    program = struct.pack("<HxxxxxxQ", len(instructions), ctypes.addressof(code_buffer))
    _control(_SECCOMP, _FILTER, program)


def _encode(instruction: _Instruction) -> bytes:
    """Return an instruction as the kernel reads it, with jumps before the value."""
    code, value, *jumps = instruction
    if_true, if_false = jumps or (0, 0)
    return struct.pack("<HBBI", code, if_true, if_false, value)


def _list_checks() -> dict[str, list[_Instruction]]:
    """Return instructions that end a filter by the arguments of a call, by its name."""
    checks: dict[str, list[_Instruction]] = {
        "clone3": [(_RETURN, _MISSING)],
        "clone": [(_LOAD, _FIRST), (_ANY, _THREAD, 1, 0), (_RETURN, _REFUSE),
                  (_ANY, _FOREIGN_CLONES, 0, 1), (_RETURN, _REFUSE), (_RETURN, _ALLOW)],
        "ioctl": [(_LOAD, _SECOND), (_EQUAL, _INHERITANCE[0], 1, 0),
                  (_EQUAL, _INHERITANCE[1], 0, 1), (_RETURN, _NO_TERMINAL),
                  *_require_value(_SECOND, _REQUESTS)],
        "fcntl": _require_value(_SECOND, _COMMANDS),
        "prctl": _require_value(_FIRST, _OPTIONS),
        "prlimit64": _require_value(_FIRST, (0, os.getpid())),
    }  # fmt: skip
    for name in _OF_ITSELF:
        checks[name] = _require_value(_FIRST, (os.getpid(),))
    return checks


def _require_value(place: int, values: Sequence[int]) -> list[_Instruction]:
    """Return instructions that allow a call whose argument is one of some values.

    The lower half of the argument is compared, since the kernel ignores the upper one.
    """
    count = len(values)
    comparisons = [(_EQUAL, value, count - k, 0) for k, value in enumerate(values)]
    return [(_LOAD, place), *comparisons, (_RETURN, _REFUSE), (_RETURN, _ALLOW)]
