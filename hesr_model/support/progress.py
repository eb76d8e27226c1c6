"""How work that takes long tells how far it is."""

from collections.abc import Callable, Collection, Iterator
from typing import TypeVar

Progress = Callable[[int, int], None]
"""Told how much is done, and how much there is."""

Stages = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and how much there is."""

Item = TypeVar("Item")


def unheard(*_told: object) -> None:
    """Tell nobody."""


def counted(items: Collection[Item], progress: Progress) -> Iterator[Item]:
    """Yield items, telling before each and after the last how many are done."""
    for done, item in enumerate(items):
        progress(done, len(items))
        yield item
    progress(len(items), len(items))
