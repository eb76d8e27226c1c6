"""Garbage collection for processes whose objects mostly stay."""

import atexit
import gc

_THRESHOLDS = (100_000, 20, 20)


def collect_seldom() -> None:
    """Collect garbage rarely: it takes a sixth of the import time."""
    gc.set_threshold(*_THRESHOLDS)
    atexit.register(gc.freeze)
