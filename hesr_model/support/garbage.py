"""Garbage collection for processes whose objects mostly stay."""

import atexit
import gc

_THRESHOLDS = (100_000, 20, 20)


def collect_seldom() -> None:
    """Collect garbage less often, and not at the end of the process.

    It takes a sixth of the import time, and a second or two at the end.
    """
    gc.set_threshold(*_THRESHOLDS)
    atexit.register(gc.freeze)
