"""A motion and its time-reversed counterpart, matched by position (section III-B)."""

from dataclasses import replace
from typing import Any

import numpy as np

from hesr_model.errors import FitError
from hesr_model.logs.signals import Motion
from hesr_model.support.arrays import Array, Mask

_LONGEST_SHIFT = 0.5  # latency [s] of command and measurement, which reversal keeps
_LARGEST_MISMATCH = 0.1  # position mismatch [rad]; 20 mrad are harmless


def matched(forward: Motion, backward: Motion) -> tuple[Motion, Motion]:
    """Match a motion with its counterpart at the best mirrored time; raises FitError."""
    from scipy.interpolate import make_interp_spline  # slow to import

    period = float(np.median(np.diff(forward.t)))
    count = int(_LONGEST_SHIFT / period)
    position = make_interp_spline(backward.t, backward.q, k=1)
    mirror = backward.t[-1] - (forward.t - forward.t[0])

    def mismatch(shift: float) -> float:
        rows = _covered(mirror + shift, backward.t)
        if np.sum(rows) < 0.5 * len(mirror):
            return float("inf")
        distance = forward.q[rows] - position(mirror[rows] + shift)
        return float(np.sqrt(np.mean(distance**2)))

    shifts = period * np.arange(-count, count + 1)
    distances = [mismatch(shift) for shift in shifts]
    best = int(np.argmin(distances))
    if not distances[best] <= _LARGEST_MISMATCH:
        raise FitError(
            f"log {backward.name}: is not the time-reversed counterpart of {forward.name}; "
            f"positions differ by {distances[best]:.3g} rad on average; at most "
            f"{_LARGEST_MISMATCH:g} rad is allowed."
        )
    times = mirror + shifts[best]
    rows = _covered(times, backward.t)
    return forward.rows(rows), _at(backward, times[rows])


def _covered(times: Array, t: Array) -> Mask:
    return np.asarray((times >= t[0]) & (times <= t[-1]))


def _at(motion: Motion, times: Array) -> Motion:
    from scipy.interpolate import make_interp_spline

    orders = {"q": 3, "dq": 3, "ddq": 3, "tau": 1, "q_raw": 1}
    read: dict[str, Any] = {
        name: make_interp_spline(motion.t, getattr(motion, name), k=order)(times)
        for name, order in orders.items()
    }
    return replace(motion, t=times, **read)
