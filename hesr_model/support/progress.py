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


class _Silent:
    """Progress that reports nothing; signatures show its name."""

    def __call__(self, *_told: object) -> None:
        pass

    def __repr__(self) -> str:
        return "silent"


silent = _Silent()


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
def steps_told(progress: Progress) -> Iterator[None]:
    """Pass reports of `step` to `progress` within the block."""
    token = _steps.set(progress)
    try:
        yield
    finally:
        _steps.reset(token)


def make_file_progress(path: Path) -> Progress:
    """Return a progress that writes the largest share into a file."""
    largest_share = 0

    def write_share(done: int, total: int) -> None:
        nonlocal largest_share
        share = UNITS_PER_JOB * done // max(total, 1)
        if share > largest_share:
            # The number never gets shorter, so the file is not truncated: some take 3 ms for that.
            mode = "r+" if largest_share else "w"
            largest_share = share
            with suppress(OSError), path.open(mode, encoding="utf-8") as file:
                file.write(str(share))

    return write_share


@contextmanager
def watched(files: Sequence[Path], progress: Progress) -> Iterator[None]:
    """Report the sum of the shares written by `make_file_progress`."""
    total = UNITS_PER_JOB * len(files)
    has_ended = threading.Event()

    def poll_files() -> None:
        largest_sum = 0
        while not has_ended.wait(_POLL_PERIOD):
            # A file is empty while it is written.
            largest_sum = max(largest_sum, sum(map(_read_share, files)))
            progress(min(largest_sum, total), total)

    watcher = threading.Thread(target=poll_files, daemon=True)
    progress(0, total)
    watcher.start()
    try:
        yield
    finally:
        has_ended.set()
        watcher.join()
    progress(total, total)


def _read_share(file: Path) -> int:
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
    received_signals: list[int] = []
    is_posix = hasattr(signal, "pthread_sigmask")
    previous_handlers = {
        number: signal.signal(number, lambda number, _frame: received_signals.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    # Child processes inherit the mask. It cannot replace the handlers, because another thread may
    # take the signal.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if is_posix else set()
    try:
        yield
    finally:
        if is_posix:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in previous_handlers.items():
            if handler is not None:  # None if set by C code
                signal.signal(number, handler)
        if received_signals:
            signal.raise_signal(received_signals[0])


_take_draft: ContextVar[Callable[[object], None]] = ContextVar("_take_draft", default=silent)


def publish_draft(answer: object) -> None:
    """Pass the answer of a command so far to `drafts_passed_to`, in case the command is killed."""
    _take_draft.get()(answer)


@contextmanager
def drafts_passed_to(take_draft: Callable[[object], None]) -> Iterator[None]:
    """Pass the answers of `publish_draft` to `take_draft` within the block."""
    token = _take_draft.set(take_draft)
    try:
        yield
    finally:
        _take_draft.reset(token)


class Interrupted(KeyboardInterrupt):
    """Interrupt of work; `resume_hint` says what is kept or how it can be continued.

    `answer` is the result so far, if a command has one.
    """

    def __init__(
        self, resume_hint: str, interrupt: KeyboardInterrupt, answer: object = None
    ) -> None:
        super().__init__(resume_hint)
        self.resume_hint = resume_hint
        self.interrupt = interrupt
        self.answer = answer
