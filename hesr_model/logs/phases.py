"""Phases of a motion: where a joint moves, rests or reverses."""

import numpy as np

from hesr_model.support.arrays import Array, Integers, Mask

MOVING = 0.02
"""[rad/s] Slower rows count as standing still."""

REVERSAL_WINDOW = 0.1
"""[s] To either side of a reversal."""


def moving(dq: Array) -> Mask:
    """Rows (N,) at which a joint moves: |dq| > `MOVING` [rad/s]."""
    return np.asarray(np.abs(dq) > MOVING)


def reversals(dq: Array) -> Integers:
    """Rows of the reversals of one joint's velocity (N,) [rad/s].

    A reversal is a change of sign from one moving row to the next moving one, however long the
    joint rests between; it is placed at the smallest |dq| of the two and those between.
    """
    rows = np.flatnonzero(moving(dq))
    changes = np.flatnonzero(np.diff(np.sign(dq[rows])))
    placed = [rows[k] + np.argmin(np.abs(dq[rows[k] : rows[k + 1] + 1])) for k in changes]
    return np.array(placed, dtype=np.intp)


def near_reversals(t: Array, dq: Array) -> Mask:
    """Rows (N,) within `REVERSAL_WINDOW` of a reversal, of t [s] and dq [rad/s], (N,) each."""
    near = np.zeros(len(t), dtype=bool)
    for instant in t[reversals(dq)]:
        near |= np.abs(t - instant) <= REVERSAL_WINDOW
    return near
