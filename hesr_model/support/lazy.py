"""Public names that are imported on first use (PEP 562)."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy(
    module: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a module that imports its names on use.

    `homes` gives the module of each public name, with a colon and the name there if it differs.
    """

    def find(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module '{module}' has no attribute '{name}'")
        home, _, own = homes[name].partition(":")
        value = getattr(import_module(home), own or name)
        setattr(sys.modules[module], name, value)
        return value

    return find, lambda: sorted(homes)
