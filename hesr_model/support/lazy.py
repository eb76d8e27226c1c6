"""Import time: public names imported on first use (PEP 562), and rare garbage collection."""

import atexit
import gc
import re
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

Names = tuple[Callable[[str], object], Callable[[], list[str]]]


def lazy(module: str, file: str) -> Names:
    """Return ``__getattr__`` and ``__dir__`` of a module that imports its names on use.

    The names are those in the stub next to its `file`.
    """
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = re.findall(r"^from (\S+) import (\w+)", stub, re.MULTILINE)
    modules_by_name = {name: home_module for home_module, name in imports}

    def find(name: str) -> object:
        if name not in modules_by_name:
            raise AttributeError(f"module '{module}' has no attribute '{name}'")
        value = getattr(import_module(modules_by_name[name]), name)
        _show_signatures(value)
        setattr(sys.modules[module], name, value)
        return value

    return find, lambda: sorted(modules_by_name)


def _show_signatures(value: object) -> None:
    from hesr_model.support.signatures import show_signatures  # needs NumPy

    if callable(value):
        show_signatures(value)


_THRESHOLDS = (100_000, 20, 20)


def collect_seldom() -> None:
    """Collect garbage rarely: it takes a sixth of the import time."""
    gc.set_threshold(*_THRESHOLDS)
    atexit.register(gc.freeze)
