"""Import time: public names imported on first use (PEP 562), and rare garbage collection."""

import atexit
import gc
import re
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

Names = tuple[Callable[[str], object], Callable[[], list[str]]]


def lazy_stub(module: str, file: str) -> Names:
    """Return `lazy` for the names in the stub next to a module's `file`."""
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    imported = re.findall(r"^from (\S+) import (\w+)", stub, re.MULTILINE)
    return lazy(module, {name: f"{home}:{name}" for home, name in imported})


def lazy(module: str, homes: Mapping[str, str]) -> Names:
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


_THRESHOLDS = (100_000, 20, 20)


def collect_seldom() -> None:
    """Collect garbage rarely: it takes a sixth of the import time."""
    gc.set_threshold(*_THRESHOLDS)
    atexit.register(gc.freeze)
