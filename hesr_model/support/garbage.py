"""The garbage collector, where most of what is made stays: modules and symbolic expressions."""

import atexit
import gc

_THRESHOLDS = (100_000, 20, 20)


def collect_seldom() -> None:
    """Let this process look for garbage less often, and not at its end.

    A sixth of the time of an import goes there, and a second or two of the end, when the system
    takes everything back anyhow.
    """
    gc.set_threshold(*_THRESHOLDS)
    atexit.register(gc.freeze)
