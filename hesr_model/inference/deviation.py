"""What deviates from others of its kind, and what changes over days.

A value deviates by z = (x - median) / s, s the median absolute deviation as that of a normal
distribution; values that are all positive are compared by their logarithms. The MAD knows s only
as well as a standard deviation of 0.37 times as many values would (Rousseeuw and Croux 1993), so
that z is judged by Student's t of 0.37 (n - 1) degrees of freedom: by simulation on the safe side
from 5 values on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

ENOUGH = 5
"""Values from which on there is a kind to deviate from, and logs from which on a trend."""

_NORMAL = 1.4826
"""Standard deviation of a normal distribution over its MAD."""

_EFFICIENCY = 0.37
"""Of the MAD."""

_ALIKE = 1e-3
"""Of the median: values that are nearer to it do not deviate, however alike the others are."""


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """How far a value is from the others.

    Attributes
    ----------
    value, median : in one unit.
    z : distance in robust standard deviations.
    p : probability of such a distance by chance, two-sided.
    """

    value: float
    median: float
    z: float
    p: float


def deviations(values: Sequence[float], errors: Sequence[float | None]) -> list[Deviation]:
    """Return how far each value is from the median of all.

    Parameters
    ----------
    values : (n,) of one quantity, `ENOUGH` at least.
    errors : (n,) their standard errors, in the same unit, where known: what is less certain than
        others differ deviates by no more than its own uncertainty lets it.
    """
    x = np.array(values, dtype=float)
    own = np.array([0.0 if error is None else error for error in errors])
    median = float(np.median(x))
    if np.all(x > 0.0):
        own, x = own / x, np.log(x)
        least = _ALIKE
    else:
        least = _ALIKE * (float(np.median(np.abs(x))) or float(np.max(np.abs(x))) or 1.0)
    apart = x - np.median(x)
    mad = _NORMAL * float(np.median(np.abs(apart)))
    z = apart / np.maximum(np.maximum(mad, own), least)
    p = 2.0 * stdtr(_EFFICIENCY * (len(x) - 1), -np.abs(z))
    return [
        Deviation(value=float(value), median=median, z=float(one), p=float(chance))
        for value, one, chance in zip(values, z, p, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class Trend:
    """A straight line over days, by least squares.

    Attributes
    ----------
    slope : per day, or per log where logs have no days.
    change : from the first day to the last one, by the line.
    p : probability of such a slope by chance, two-sided, by Student's t.
    """

    slope: float
    change: float
    p: float


def trend(days: Sequence[float], values: Sequence[float]) -> Trend | None:
    """Return the trend of values, in their unit, over days; None where these are too few."""
    x, y = np.array(days, dtype=float), np.array(values, dtype=float)
    if len(x) < ENOUGH or not np.ptp(x) > 0.0:
        return None
    x0 = x - x.mean()
    slope = float(x0 @ y / (x0 @ x0))
    residual = y - y.mean() - slope * x0
    # A line through all values is certain up to rounding.
    rounding = np.finfo(float).eps * float(np.max(np.abs(y)))
    spread = max(float(np.sqrt(residual @ residual / (len(x) - 2))), rounding)
    error = spread / float(np.sqrt(x0 @ x0))
    p = 2.0 * float(stdtr(len(x) - 2, -abs(slope) / error)) if error else 1.0
    return Trend(slope=slope, change=slope * float(np.ptp(x)), p=p)
