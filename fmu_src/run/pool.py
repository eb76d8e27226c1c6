"""FMUs that stay loaded from one system to the next: loading them takes longer than a short run."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fmu_src.run.fmu import Component
from hesr_model.errors import SimulationError

_Key = tuple[Path, int, int, int, str]


class Loaded:
    """Components that wait for their next use; those that have waited longest are freed first.

    Parameters
    ----------
    most : so many are kept.
    """

    def __init__(self, most: int = 48) -> None:
        self._most = most
        self._idle: dict[_Key, Component] = {}

    @contextmanager
    def lend(self, fmu: Path, *, name: str) -> Iterator[Component]:
        """Return a component as `Component` does, a kept one if the file has not changed.

        It is kept again afterwards, reset, if nothing has failed.
        """
        key = _key(fmu, name)
        component = self._idle.pop(key, None) if key else None
        if component is None:
            component = Component(fmu, name=name).__enter__()
        try:
            yield component
        except BaseException as error:
            component.__exit__(type(error), error, error.__traceback__)
            raise
        if key and key not in self._idle and _ready(component):
            self._idle[key] = component
            while len(self._idle) > self._most:
                self._idle.pop(next(iter(self._idle))).__exit__(None, None, None)
        else:
            component.__exit__(None, None, None)

    def clear(self) -> None:
        """Free all."""
        while self._idle:
            self._idle.popitem()[1].__exit__(None, None, None)


HERE = Loaded()
"""Of this process; workers keep theirs until they end."""


def _key(fmu: Path, name: str) -> _Key | None:
    try:
        about = fmu.stat()
    except OSError:  # which the component says
        return None
    return fmu.resolve(), about.st_ino, about.st_size, about.st_mtime_ns, name


def _ready(component: Component) -> bool:
    """Bring a component back to before its initialisation; false where it cannot be trusted."""
    if component.failed:
        return False
    try:
        if component.used:
            component.reset()
    except SimulationError:
        return False
    component.time = 0.0
    component.messages.clear()
    return True
