"""How work that takes long tells how far it is."""

import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TypeVar

Progress = Callable[[int, int], None]
"""Told how much is done, and how much there is."""

Stages = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and how much there is."""

Item = TypeVar("Item")


def silent(*_told: object) -> None:
    """Tell nobody."""


def counted(items: Collection[Item], progress: Progress) -> Iterator[Item]:
    """Yield items, telling before each and after the last how many are done."""
    for done, item in enumerate(items):
        progress(done, len(items))
        yield item
    progress(len(items), len(items))


_steps: ContextVar[Progress] = ContextVar("_steps", default=silent)

PARTS = 100
"""Of one job, where several are counted together by the steps inside them."""

_LOOKED = 0.3  # [s] between two looks at how far workers are


def step(done: int, total: int) -> None:
    """Tell how many starts or candidates of the work at hand are done, to whom `steps_told` named.

    A search calls it from inside; nobody need listen.
    """
    _steps.get()(done, total)


@contextmanager
def steps_told(to: Progress) -> Iterator[None]:
    """Have `step` tell somebody within the block."""
    token = _steps.set(to)
    try:
        yield
    finally:
        _steps.reset(token)


def into_file(path: Path) -> Progress:
    """Return what writes the greatest share that was told into a file, for another process."""
    most = 0

    def tell(done: int, total: int) -> None:
        nonlocal most
        if (share := PARTS * done // max(total, 1)) > most:
            most = share
            with suppress(OSError):  # it is no reason to lose the work
                path.write_text(str(share), encoding="utf-8")

    return tell


@contextmanager
def watched(files: Sequence[Path], progress: Progress) -> Iterator[None]:
    """Tell the sum of what jobs write by `into_file`, in `PARTS` of each, while the block runs."""
    total, ended = PARTS * len(files), threading.Event()

    def look() -> None:
        most = 0
        while not ended.wait(_LOOKED):
            most = max(most, sum(map(_share, files)))  # a file is empty while it is written
            progress(min(most, total), total)

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
    except (OSError, ValueError):  # not begun, or being written
        return 0
