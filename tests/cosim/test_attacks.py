"""Attacks on the system from within a foreign FMU: each call is refused and leaves nothing."""

import os
import platform
import resource
import subprocess
import sys
from errno import ENOTTY, EPERM
from pathlib import Path

import pytest
from processes import list_children
from system_calls import read_numbers
from test_foreign_fmus import go, hostile_lag, linux

from fmu_src.run.fmu import FmuInstance
from fmu_src.run.sandbox import SandboxedInstance
from hesr_model.errors import SimulationError
from hesr_model.support import rights
from hesr_model.support.child import run_in_child
from hesr_model.support.process import DiedError

__all__ = ["hostile_lag"]

ATTACKS = (
    # Shared memory, semaphores and queues of System V and POSIX; files in memory.
    "shmget 0x7357 4096 0o1600", "shmat 0 0 0", "shmdt p", "shmctl 0 0 p",
    "semget 0x7357 1 0o1600", "semop 0 p 1", "semctl 0 0 0", "semtimedop 0 p 1 p",
    "msgget 0x7357 0o1600", "msgsnd 0 p 1 0", "msgrcv 0 p 1 0 0", "msgctl 0 0 p",
    "mq_open t 0x42 0o600 0", "mq_unlink t", "memfd_create t 0", "memfd_secret 0",
    # Programs, processes, and other processes.
    "fork", "vfork", "clone 17 0 0 0 0", "clone 0x10000000 0 0 0 0", "execve t 0 0",
    "execveat -100 t 0 0 0", "ptrace 16 1 0 0", "process_vm_readv 1 p 1 p 1 0",
    "process_vm_writev 1 p 1 p 1 0", "pidfd_open 1 0", "pidfd_getfd 3 0 0",
    "pidfd_send_signal 3 9 0 0", "kill -1 0", "kill 1 9", "tkill 1 9", "tgkill 1 1 9",
    "rt_sigqueueinfo 1 9 p", "kcmp 1 1 0 0 0", "process_madvise 3 p 1 0 0",
    "prlimit64 1 7 0 p", "setns 3 0", "unshare 0x10000000", "setsid", "setpgid 0 0",
    # Priorities and affinity.
    "setpriority 0 1 19", "ioprio_set 1 1 0", "sched_setaffinity 1 8 p", "sched_setscheduler 1 0 p",
    "sched_setparam 1 p", "sched_setattr 1 p 0", "migrate_pages 1 1 p p", "move_pages 1 0 0 0 0 0",
    # Networks and terminals; signals through files.
    "socket 2 1 0", "socketpair 1 1 0 p", "connect 3 p 16", "bind 3 p 16", "sendmsg 3 p 0",
    "ioctl 3 0x5412 p", "ioctl 3 0x8901 p", "fcntl 3 8 1", "fcntl 3 10 9", "fcntl 3 1031 1048576",
    "fcntl 3 1024 1",
    # Interfaces of the kernel.
    "keyctl 0 0 0", "add_key p p p 0 0", "request_key p p 0 0", "io_uring_setup 1 p",
    "io_uring_enter 3 0 0 0 0", "bpf 0 p 8", "userfaultfd 1", "perf_event_open p 0 -1 -1 0",
    "fanotify_init 0 0", "inotify_init1 0", "name_to_handle_at -100 t p p 0",
    "open_by_handle_at 3 p 0", "seccomp 1 0 p", "prctl 22 2 0", "prctl 1 0 0", "prctl 4 1",
    "personality 0x40000", "syslog 2 p 1", "quotactl 0 0 0 0", "acct t", "swapon t 0",
    "mount t t t 0 0", "umount2 t 0", "pivot_root t t", "chroot t", "open_tree -100 t 0",
    "move_mount 3 t 3 t 0", "fsopen t 0", "init_module p 0 p", "kexec_load 0 0 0 0", "reboot 0 0 0",
    "clock_settime 0 p", "settimeofday p 0", "adjtimex p", "sethostname p 1", "vhangup",
    "io_setup 1 p", "lookup_dcookie 0 p 1", "splice 3 0 4 0 1 0", "vmsplice 3 p 1 0", "tee 3 4 1 0",
    # Owners, permissions and attributes of files; devices.
    "chmod t 0o777", "fchmodat -100 t 0o777", "chown t 0 0", "fchownat -100 t 0 0 0",
    "utimensat -100 t 0 0", "setxattr t t p 1 0", "removexattr t t", "mknod t 0o10600 0",
    "mknodat -100 t 0o10600 0", "link t t", "linkat -100 t -100 t 0", "flock 3 2", "mlockall 1",
    # Users and capabilities.
    "setuid 0", "setgid 0", "setgroups 0 0", "setresuid 0 0 0", "setfsuid 0", "capset p p",
)  # fmt: skip
"""System calls, one of each family at least, and their arguments; see `call_system`."""


def write_attacks() -> str:
    """Return the attacks with the numbers of this machine, those that it has."""
    numbers = read_numbers(platform.machine())
    lines = []
    for line in ATTACKS:
        name, *arguments = line.split()
        if name in numbers:
            values = [str(int(a, 0)) if a not in ("p", "t") else a for a in arguments]
            lines.append(" ".join([str(numbers[name]), *values]))
    return "".join(f"{line}\n" for line in lines)


@pytest.fixture
def target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    target = tmp_path / "target"
    target.write_text("untouched", encoding="utf-8")
    monkeypatch.setenv("TARGET", str(target))
    monkeypatch.setenv("ATTACKS", write_attacks())
    return target


def list_ipc() -> list[str]:
    """Objects of System V and queues, those of other users included."""
    places = [Path(f"/proc/sysvipc/{kind}") for kind in ("shm", "sem", "msg")]
    texts = [place.read_text(encoding="utf-8") for place in places if place.exists()]
    return [*texts, *sorted(entry.name for entry in Path("/dev/shm").iterdir())]


@linux
@pytest.mark.parametrize("place", ["load", "fmi2DoStep"])
def test_every_attack_is_refused(
    place: str, hostile_lag: Path, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exit code is the number of the first attack that gives another error than EPERM."""
    assert write_attacks().count("\n") > 100
    priority = os.getpriority(os.PRIO_PROCESS, 0)
    affinity = os.sched_getaffinity(0)
    objects = list_ipc()
    monkeypatch.setenv("DEED", f"{place} attack")
    with pytest.raises(SimulationError, match=r"ended its process with exit code 0\."):
        go(hostile_lag)
    assert target.read_text(encoding="utf-8") == "untouched"
    assert list_ipc() == objects
    assert os.getpriority(os.PRIO_PROCESS, 0) == priority
    assert os.sched_getaffinity(0) == affinity


CONTROL = """
import ctypes, os, sys
library = ctypes.CDLL(sys.argv[1])
"""


@pytest.mark.ci
@linux
def test_attacks_elsewhere_are_not_refused_alike(hostile_lag: Path, target: Path) -> None:
    """A control: without the sandbox the same calls succeed, or fail with other errors."""
    harmless = [
        line
        for line in write_attacks().splitlines(keepends=True)
        if line.split()[0] in map(str, HARMLESS_NUMBERS)
    ]
    with FmuInstance(hostile_lag) as lag:
        assert isinstance(lag._instance, SandboxedInstance)
        library = next(lag._instance.sandbox.readable.rglob("*.so"))
        process = subprocess.run(
            [sys.executable, "-c", CONTROL, library],
            env=os.environ | {"DEED": "load attack", "REPORT": "1", "ATTACKS": "".join(harmless)},
            capture_output=True,
            text=True,
            check=False,
        )
    errors = [int(line) for line in process.stderr.split()]
    assert len(errors) == len(harmless) > 8
    assert 1 not in errors


HARMLESS = ("memfd_create", "pidfd_open", "setsid", "socketpair",
            "inotify_init1", "io_setup", "splice", "chmod", "utimensat", "flock")  # fmt: skip
HARMLESS_NUMBERS = [read_numbers(platform.machine()).get(name, -1) for name in HARMLESS]
"""Calls that need no special rights and do nothing to other processes."""


@pytest.mark.parametrize(("column", "processor"), [(0, "x86_64"), (1, "aarch64")])
def test_numbers_of_calls_are_those_of_the_kernel(column: int, processor: str) -> None:
    known = read_numbers(processor)
    for name, row in rights.CALLS.items():
        assert row[column] == known.get(name), name


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_no_attack_is_on_the_list(processor: str) -> None:
    checked = {"clone", "ioctl", "fcntl", "prctl", "prlimit64", "kill", "tgkill", "rt_sigqueueinfo"}
    names = {line.split()[0] for line in ATTACKS}
    assert names & rights.CALLS.keys() <= checked
    assert len(names & read_numbers(processor).keys()) > 90


LAST_NUMBER = 1023
"""The kernel's table ends at 470 today; further calls get the next numbers."""
PROBES = (335, 336)
"""uretprobe and uprobe on x86-64: no filter sees them. They do nothing without a probe, or end
the process."""
COMPATIBLE = 0x40000000
"""Bit of the calls of the x32 interface, a second way to each call."""


def list_allowed() -> dict[int, str]:
    """Return the names of the allowed calls by their number on this machine."""
    column, _ = rights._PROCESSORS[platform.machine()]
    return {row[column]: name for name, row in rights.CALLS.items() if row[column] is not None}


def read_limits() -> list[tuple[int, int]]:
    names = [name for name in vars(resource) if name.startswith("RLIMIT_")]
    return [resource.getrlimit(getattr(resource, name)) for name in names]


def call_in_child(folder: Path, calls: list[list[int]], seconds: float = 60.0) -> list[int]:
    return run_in_child(
        "attackers:call_system", calls, folder=folder, seconds=seconds, readable=[folder]
    )


def find_end(folder: Path, number: int) -> int | str:
    """Return the error of a call without arguments, or how it ended its process."""
    try:
        (error,) = call_in_child(folder, [[number]], seconds=2.0)
    except DiedError as death:
        return str(death)
    return error


@linux
def test_every_number_that_is_not_on_the_list_is_refused(tmp_path: Path) -> None:
    """Numbers of the kernel's table, those that later kernels may have, and those of x32."""
    allowed = list_allowed()
    probes = PROBES if platform.machine() == "x86_64" else ()
    numbers = [n for n in range(LAST_NUMBER + 1) if n not in allowed and n not in probes]
    numbers += [number | COMPATIBLE for number in range(LAST_NUMBER + 1)]
    numbers += [-1, -(2**31), 2**31 - 1, 2**32]
    if 0 in allowed:
        numbers.remove(2**32)  # the kernel reads the lower half only: a read of no bytes
    errors = call_in_child(tmp_path, [[number] for number in numbers])
    others = {n: e for n, e in zip(numbers, errors, strict=True) if e != EPERM}
    assert others == {}
    for number in probes:
        assert find_end(tmp_path, number) != 0


@linux
def test_every_argument_that_is_not_on_the_list_is_refused(tmp_path: Path) -> None:
    """All commands of calls that are allowed for some; -1 is no file, so that nothing happens."""
    numbers = {name: number for number, name in list_allowed().items()}
    calls = [[numbers["fcntl"], -1, c] for c in range(2048) if c not in rights._COMMANDS]
    calls += [[numbers["prctl"], option] for option in range(1024) if option not in rights._OPTIONS]
    requests = set(range(1 << 16)) - {*rights._REQUESTS, *rights._INHERITANCE}
    calls += [[numbers["ioctl"], -1, request] for request in requests]
    for bit in range(32):
        flag = 1 << bit
        if flag != rights._THREAD:  # a process, whatever else
            calls.append([numbers["clone"], flag])
        if flag & rights._FOREIGN_CLONES:
            calls.append([numbers["clone"], rights._THREAD | flag])
    for process in (1, -1, os.getpid(), os.getppid()):
        calls += [[numbers[name], process] for name in (*rights._OF_ITSELF, "prlimit64")]
    errors = call_in_child(tmp_path, calls)
    others = [call for call, error in zip(calls, errors, strict=True) if error != EPERM]
    assert others == []
    inheritance = [[numbers["ioctl"], -1, request] for request in rights._INHERITANCE]
    assert call_in_child(tmp_path, inheritance) == [ENOTTY] * 2


@pytest.mark.ci
@linux
def test_each_allowed_call_without_arguments_harms_the_child_only(
    target: Path, tmp_path: Path
) -> None:
    """Some wait for ever, end the process or break it; nothing else changes."""
    priority = os.getpriority(os.PRIO_PROCESS, 0)
    affinity = os.sched_getaffinity(0)
    limits = read_limits()
    objects = list_ipc()
    ends = {}
    for number, name in list_allowed().items():
        folder = tmp_path / name
        folder.mkdir()
        ends[name] = find_end(folder, number)
    assert len(ends) > 100
    assert ends["exit_group"] == "ended its process with exit code 0"
    assert "2 s" in ends["pause"]
    assert list_children() == []
    assert target.read_text(encoding="utf-8") == "untouched"
    assert list_ipc() == objects
    assert os.getpriority(os.PRIO_PROCESS, 0) == priority
    assert os.sched_getaffinity(0) == affinity
    assert read_limits() == limits


@linux
def test_threads_are_limited(tmp_path: Path) -> None:
    """Starting them ends with an error of this process, not with the machine's last thread."""
    count = run_in_child(
        "attackers:start_threads", folder=tmp_path, seconds=60, readable=[tmp_path]
    )
    assert 64 < count < 600


@pytest.mark.ci
@linux
@pytest.mark.parametrize("runtime", ["openmp", "fortran", "threads", "java"])
def test_runtimes_of_numerical_libraries_work(runtime: str, tmp_path: Path) -> None:
    if runtime == "java" and not list(Path("/usr/lib/jvm").glob("*/lib/server/libjvm.so")):
        pytest.skip("there is no Java")
    answer = run_in_child(
        f"attackers:use_{runtime}", folder=tmp_path, seconds=60, readable=[tmp_path]
    )
    assert answer == "done"
