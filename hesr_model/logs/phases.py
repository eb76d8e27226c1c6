"""Phases of a motion: moving, resting, reversing."""

import numpy as np

from hesr_model.support.arrays import Array, Integers, Mask

MOVING = 0.02
"""Speed below which a joint is at rest [rad/s]."""

REVERSAL_WINDOW = 0.1
"""Half width of the window around a reversal [s]."""


def moving(dq: Array) -> Mask:
    """Return the moving rows (N,) of a joint: |dq| > `MOVING` [rad/s]."""
    return np.asarray(np.abs(dq) > MOVING)


def reversals(dq: Array) -> Integers:
    """Return the rows of smallest |dq| at each change of sign of a velocity (N,) [rad/s].

    Rests between two moving rows of opposite sign may have any length.
    """
    rows = np.flatnonzero(moving(dq))
    changes = np.flatnonzero(np.diff(np.sign(dq[rows])))
    placed = [rows[k] + np.argmin(np.abs(dq[rows[k] : rows[k + 1] + 1])) for k in changes]
    return np.array(placed, dtype=np.intp)


def near_reversals(t: Array, dq: Array) -> Mask:
    """Return the rows within `REVERSAL_WINDOW` of a reversal; t [s] and dq [rad/s] are (N,)."""
    near = np.zeros(len(t), dtype=bool)
    for instant in t[reversals(dq)]:
        near |= np.abs(t - instant) <= REVERSAL_WINDOW
    return near
