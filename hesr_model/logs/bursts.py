"""Time stamps in bursts: rows that were taken evenly and stamped when a buffer arrived."""

import numpy as np

from hesr_model.support.arrays import Array, Mask

_SHORT_STEP = 0.1  # of the usual step, below which a row belongs to the burst of the row before
_MIN_SHORT_SHARE = 0.3  # of steps; jitter makes a tenth of them short, bursts of two rows a half
_GAP_SHARE = 0.002  # of the steps, the longest ones, which may be gaps
_MAX_SPACING = 2.0  # of rows over the usual spacing; a longer time before a burst is a gap


def find_short_steps(t: Array) -> Mask:
    """Return whether each step (N - 1,) of stamps (N,) [s] is one within a burst."""
    steps = np.diff(t)
    if not len(steps):
        return np.zeros(0, dtype=bool)
    usual_steps = steps[steps <= np.quantile(steps, 1.0 - _GAP_SHARE, method="higher")]
    return np.asarray(np.abs(steps) < _SHORT_STEP * np.mean(usual_steps))


def has_bursts(t: Array) -> bool:
    """Return whether many rows were stamped together with the row before."""
    short_steps = find_short_steps(t)
    return len(t) > 2 and bool(np.mean(short_steps) > _MIN_SHORT_SHARE)


def find_period(t: Array) -> float:
    """Return the median time [s] between rows, of bursts the mean."""
    summarise = np.mean if has_bursts(t) else np.median
    return float(summarise(np.diff(t)))


def spread_bursts(t: Array) -> Array:
    """Return stamps (N,) [s] at even distances within and before bursts; falling ones unchanged."""
    if len(t) < 3 or np.any(np.diff(t) < 0.0):
        return t
    # A buffer arrives when its last row was taken.
    ends = np.append(np.flatnonzero(~find_short_steps(t)), len(t) - 1)
    if len(ends) < 3:
        return t
    counts = np.diff(ends, prepend=-1)
    durations = np.diff(t[ends])
    rows = np.arange(len(t))
    # A source that is even over the whole log has less jitter than the stamps of its bursts.
    even = np.polynomial.Polynomial.fit(ends, t[ends], 1)(rows)
    if np.max(np.abs(even[ends] - t[ends])) < np.min(durations):
        return np.asarray(even)
    spacings = durations / counts[1:]
    usual_spacing = float(np.median(spacings))
    spacings[spacings > _MAX_SPACING * usual_spacing] = usual_spacing
    spacing_of_row = np.repeat(np.concatenate([[usual_spacing], spacings]), counts)
    end_of_row = np.repeat(ends, counts)
    return np.asarray(t[end_of_row] - (end_of_row - rows) * spacing_of_row)
