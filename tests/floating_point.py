"""The floating-point exceptions that a call raises, which hosts may trap."""

import ctypes
import platform
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

_X86_FLAGS = {"invalid": 1, "divide by zero": 4, "overflow": 8}
needs_flags = pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.system() != "Linux",
    reason="flags of floating-point exceptions are read as on Linux and x86",
)


@contextmanager
def without_exceptions(call: str) -> Iterator[None]:
    """Assert that no invalid operation, division by zero or overflow occurs in a block."""
    library = ctypes.CDLL("libm.so.6")
    library.feclearexcept(sum(_X86_FLAGS.values()))
    yield
    raised = library.fetestexcept(sum(_X86_FLAGS.values()))
    names = [name for name, flag in _X86_FLAGS.items() if raised & flag]
    assert not names, f"{call}: {', '.join(names)}"
