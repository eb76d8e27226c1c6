"""Functions that tests run in a child process."""

import ctypes
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any


def start_threads() -> int:
    """Start threads until no more can be started; return their number."""
    end = threading.Event()
    threading.stack_size(1 << 16)
    threads = []
    try:
        for _ in range(2500):
            threads.append(threading.Thread(target=end.wait, daemon=True))
            threads[-1].start()
    except (RuntimeError, MemoryError):
        threads.pop()
    end.set()
    return len(threads)


def use_threads() -> str:
    """Run threads that wait for each other."""
    with ThreadPoolExecutor(16) as pool:
        return "done" if sum(pool.map(len, [b"x"] * 1000)) == 1000 else "wrong"


def use_fortran() -> str:
    """Solve equations with LAPACK and its runtime of Fortran."""
    import numpy as np
    import scipy.linalg

    matrix = np.eye(200) + 0.001 * np.arange(40000.0).reshape(200, 200) / 200
    x = scipy.linalg.lu_solve(scipy.linalg.lu_factor(matrix), np.ones(200))
    return "done" if np.allclose(matrix @ x, 1.0) else "wrong"


def use_openmp() -> str:
    """Run a parallel region of the GNU or LLVM runtime, where a package carries one."""
    import importlib.util

    spec = importlib.util.find_spec("sklearn")
    assert spec is not None
    assert spec.origin is not None
    (library,) = Path(spec.origin).parents[1].glob("scikit_learn.libs/libgomp*")
    counts: list[int] = []
    body = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(lambda _: counts.append(1))
    ctypes.CDLL(str(library)).GOMP_parallel(body, None, 4, 0)
    return "done" if len(counts) == 4 else "wrong"


def use_java() -> str:
    """Create a Java machine in this process, as an FMU with a runtime of Java does."""
    (library,) = sorted(Path("/usr/lib/jvm").glob("*/lib/server/libjvm.so"))[:1]

    class Option(ctypes.Structure):
        _fields_ = (("text", ctypes.c_char_p), ("more", ctypes.c_void_p))

    class Arguments(ctypes.Structure):
        _fields_ = (
            ("version", ctypes.c_int),
            ("count", ctypes.c_int),
            ("options", ctypes.POINTER(Option)),
            ("is_lenient", ctypes.c_ubyte),
        )

    options = (Option * 2)(Option(b"-Xmx256m", None), Option(b"-XX:-UsePerfData", None))
    machine, environment = ctypes.c_void_p(), ctypes.c_void_p()
    given = Arguments(0x00010008, 2, options, 0)
    code = ctypes.CDLL(str(library)).JNI_CreateJavaVM(
        ctypes.byref(machine), ctypes.byref(environment), ctypes.byref(given)
    )
    return "done" if code == 0 else f"code {code}"


def yield_what_a_parser_can_do(
    _parser: str, path: str, options: dict[str, Any]
) -> Iterator[tuple[Any, list[bytes]]]:
    """Yield the deeds that succeed in the child of a log, as a refusal's sentence."""
    secret = options["secret"]
    deeds: dict[str, Callable[[], object]] = {
        "read the log": Path(path).read_bytes,
        "read its neighbour": Path(secret).read_bytes,
        "list its folder": lambda: list(Path(secret).parent.iterdir()),
        "follow a link": lambda: _follow_link(secret),
        "write the log": lambda: os.truncate(path, 0),
        "write its neighbour": lambda: Path(secret).write_bytes(b""),
        "write next to it": lambda: Path(path).with_name("new").write_bytes(b""),
        "start a process": _fork,
        "use the network": lambda: socket.socket().close(),
    }
    successes = [name for name, deed in deeds.items() if _succeeds(deed)]
    yield {"refusal": {"sentence": ", ".join(successes), "code": "", "key": ""}}, []


def _fork() -> None:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


def _follow_link(target: str) -> None:
    Path("link").symlink_to(target)
    try:
        Path("link").read_bytes()
    finally:
        Path("link").unlink()


def _succeeds(deed: Callable[[], object]) -> bool:
    try:
        deed()
    except OSError:
        return False
    return True


def end_as_a_parser(way: str, _path: str, _options: Any) -> Iterator[tuple[Any, list[bytes]]]:
    """End, wait or take memory within a parser."""
    way = way.partition(":")[2]
    if way == "crash":
        os.abort()
    if way == "exit":
        os._exit(3)
    if way == "hang":
        time.sleep(1000.0)
    if way == "memory":
        bytearray(1 << 40)
    yield {}, []


def call_system(calls: list[list[int]]) -> list[int]:
    """Make system calls, number and arguments each; return their errors, 0 for none."""
    library = ctypes.CDLL(None, use_errno=True)
    errors = []
    for number, *arguments in calls:
        ctypes.set_errno(0)
        padded = [*arguments, *[0] * (6 - len(arguments))]
        result = library.syscall(ctypes.c_long(number), *map(ctypes.c_long, padded))
        errors.append(ctypes.get_errno() if result == -1 else 0)
    return errors
