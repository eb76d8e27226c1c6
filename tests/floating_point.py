"""The floating-point exceptions that a call raises, which hosts may trap."""

import ctypes
import platform
from collections.abc import Iterator
from contextlib import contextmanager

_FLAGS = {"invalid": 1, "divide by zero": 4, "overflow": 8}  # of x86
_EVERY = sum(_FLAGS.values())
_HAS_FLAGS = (platform.system(), platform.machine()) == ("Linux", "x86_64")
_LIBRARY = ctypes.CDLL("libm.so.6") if _HAS_FLAGS else None


@contextmanager
def without_exceptions(call: str) -> Iterator[None]:
    """Assert that no invalid operation, division by zero or overflow occurs in a block.

    Only on Linux and x86 are the flags of these exceptions read.
    """
    if _LIBRARY is None:
        yield
        return
    _LIBRARY.feclearexcept(_EVERY)
    yield
    raised = _LIBRARY.fetestexcept(_EVERY)
    names = [name for name, flag in _FLAGS.items() if raised & flag]
    assert not names, f"{call}: {', '.join(names)}"
