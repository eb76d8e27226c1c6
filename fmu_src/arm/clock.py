"""Clock of MuJoCo: its Python package times every stage of every step."""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any

_lock = Lock()
_users = 0
_saved_callback: int | None = None


@contextmanager
def stop_clock() -> Iterator[None]:
    """Stop MuJoCo's clock, a sixth of a small arm's step; `MjData.timer` stays as it is."""
    global _users, _saved_callback
    clock = None
    if "mujoco" in sys.modules:
        clock = _clock()
    if clock is None:
        yield
        return
    with _lock:
        if not _users:
            _saved_callback = clock.value
            clock.value = None
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                clock.value = _saved_callback


@cache
def _clock() -> Any:
    from fmu_src.arm.library import find_host_libraries

    try:
        return ctypes.c_void_p.in_dll(ctypes.CDLL(str(find_host_libraries()[-1])), "mjcb_time")
    except (IndexError, OSError, ValueError):
        return None


__all__ = ["stop_clock"]
