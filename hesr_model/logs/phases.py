"""Moving, resting and reversing rows of a motion."""

import numpy as np

from hesr_model.support.arrays import Array, Integers, Mask

MOVING = 0.02  # speed [rad/s] below which a joint rests
REVERSAL_WINDOW = 0.1  # half width [s] of the window around a reversal


def moving(dq: Array) -> Mask:
    """Return the moving rows of a velocity (N,) [rad/s]."""
    return np.asarray(np.abs(dq) > MOVING)


def reversals(dq: Array) -> Integers:
    """Return the rows of smallest |dq| at each change of sign."""
    rows = np.flatnonzero(moving(dq))
    changes = np.flatnonzero(np.diff(np.sign(dq[rows])))
    placed = [rows[k] + np.argmin(np.abs(dq[rows[k] : rows[k + 1] + 1])) for k in changes]
    return np.array(placed, dtype=np.intp)


def near_reversals(t: Array, dq: Array) -> Mask:
    """Return the rows within `REVERSAL_WINDOW` of a reversal."""
    near = np.zeros(len(t), dtype=bool)
    for instant in t[reversals(dq)]:
        near |= np.abs(t - instant) <= REVERSAL_WINDOW
    return near
