"""Progress reports of slow work, and deferral of its interrupts by Ctrl-C and SIGTERM."""

import signal
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TypeVar

Progress = Callable[[int, int], None]  # number of finished items, total
Stages = Callable[[str, int, int], None]  # name of a stage, number of finished items, total
Item = TypeVar("Item")


def silent(*_told: object) -> None:
    """Report nothing."""


_current: ContextVar[list[str]] = ContextVar("_current")


def current() -> list[str]:
    """Return the list of the work in progress, which `running` changes."""
    return _current.get([])


@contextmanager
def listed_in(names: list[str]) -> Iterator[None]:
    """List the work in progress within the block in `names`."""
    token = _current.set(names)
    try:
        yield
    finally:
        _current.reset(token)


@contextmanager
def running(name: str, listed: list[str]) -> Iterator[None]:
    """List the block as work in progress."""
    listed.append(name)
    try:
        yield
    finally:
        listed.remove(name)


def report_progress(
    items: Collection[Item], progress: Progress, name: Callable[[Item], str] | None = None
) -> Iterator[Item]:
    """Yield items; report the number of finished ones, and the `name` of the current one."""
    for done, item in enumerate(items):
        progress(done, len(items))
        with running(name(item), current()) if name else nullcontext():
            yield item
    progress(len(items), len(items))


_steps: ContextVar[Progress] = ContextVar("_steps", default=silent)
UNITS_PER_JOB = 100  # units of one job among several
_POLL_PERIOD = 0.3  # [s] between two polls of workers


def step(done: int, total: int) -> None:
    """Report the progress of a search to `steps_told`."""
    _steps.get()(done, total)


@contextmanager
def steps_told(to: Progress) -> Iterator[None]:
    """Pass reports of `step` to `to` within the block."""
    token = _steps.set(to)
    try:
        yield
    finally:
        _steps.reset(token)


def make_file_progress(path: Path) -> Progress:
    """Return a progress that writes the largest share into a file."""
    most = 0

    def tell(done: int, total: int) -> None:
        nonlocal most
        share = UNITS_PER_JOB * done // max(total, 1)
        if share > most:
            # The number never gets shorter, so the file is not truncated: some take 3 ms for that.
            mode = "r+" if most else "w"
            most = share
            with suppress(OSError), path.open(mode, encoding="utf-8") as file:
                file.write(str(share))

    return tell


@contextmanager
def watched(files: Sequence[Path], progress: Progress) -> Iterator[None]:
    """Report the sum of the shares written by `make_file_progress`."""
    total = UNITS_PER_JOB * len(files)
    ended = threading.Event()

    def look() -> None:
        largest_sum = 0
        while not ended.wait(_POLL_PERIOD):
            largest_sum = max(
                largest_sum, sum(map(_share, files))
            )  # a file is empty while it is written
            progress(min(largest_sum, total), total)

    watcher = threading.Thread(target=look, daemon=True)
    progress(0, total)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
    progress(total, total)


def _share(file: Path) -> int:
    try:
        return int(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # missing, or being written
        return 0


@contextmanager
def deferred() -> Iterator[None]:
    """Defer signals that would end the program; new processes begin with Ctrl-C blocked."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    posix = hasattr(signal, "pthread_sigmask")
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    # Child processes inherit the mask. It cannot replace the handlers, because another thread may
    # take the signal.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if posix else set()
    try:
        yield
    finally:
        if posix:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            if handler is not None:  # None if set by C code
                signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


class Interrupted(KeyboardInterrupt):
    """Interrupt of work that can be continued; `kept` describes how."""

    def __init__(self, kept: str, interrupt: KeyboardInterrupt) -> None:
        super().__init__(kept)
        self.kept = kept
        self.interrupt = interrupt
