"""Outliers and trends over days.

Scores are z = (x - median) / s, with s the scaled MAD; of logarithms for positive values. The MAD
of n values is as precise as the standard deviation of 0.37 n values (Rousseeuw and Croux
1993), so z has Student's t distribution with 0.37 (n - 1) degrees of freedom: conservative in
simulations with at least 5 values.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

MIN_SAMPLE_SIZE = 5  # fewer values are neither compared nor fitted
_MAD_TO_DEVIATION = 1.4826  # standard deviation of a normal distribution over its MAD
_EFFICIENCY = 0.37  # statistical efficiency of the MAD
_OUTLIER_TOLERANCE = 1e-3  # values within this fraction of the median are never outliers


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Distance of a value from the median in robust standard deviations, two-sided p-value."""

    value: float
    median: float
    z: float
    p: float


def compute_deviations(values: Sequence[float], errors: Sequence[float | None]) -> list[Deviation]:
    """Return the distance of each of at least `MIN_SAMPLE_SIZE` values from the median of all.

    Standard `errors`, None if unknown, limit the distance.
    """
    x = np.array(values, dtype=float)
    std_errors = np.array([0.0 if error is None else error for error in errors])
    median = float(np.median(x))
    if np.all(x > 0.0):
        std_errors = std_errors / x  # of the logarithms
        x = np.log(x)
        smallest_scale = _OUTLIER_TOLERANCE
    else:
        # The largest value if the median is 0, and 1 if all values are.
        magnitude = float(np.median(np.abs(x))) or float(np.max(np.abs(x))) or 1.0
        smallest_scale = _OUTLIER_TOLERANCE * magnitude
    distances = x - np.median(x)
    mad = _MAD_TO_DEVIATION * float(np.median(np.abs(distances)))
    z = distances / np.maximum(np.maximum(mad, std_errors), smallest_scale)
    p = 2.0 * stdtr(_EFFICIENCY * (len(x) - 1), -np.abs(z))
    return [
        Deviation(value=float(value), median=median, z=float(z_score), p=float(p_value))
        for value, z_score, p_value in zip(values, z, p, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Straight line by least squares, with a two-sided p-value by Student's t."""

    slope: float  # per day, or per log without days
    change: float  # over all days
    p: float


def fit_trend(days: Sequence[float], values: Sequence[float]) -> Trend | None:
    """Return the trend of values over days; None if too few."""
    x = np.array(days, dtype=float)
    y = np.array(values, dtype=float)
    if len(x) < MIN_SAMPLE_SIZE or not np.ptp(x) > 0.0:
        return None
    x0 = x - x.mean()
    slope = float(x0 @ y / (x0 @ x0))
    residual = y - y.mean() - slope * x0
    # A line through all values is certain up to round-off.
    rounding = np.finfo(float).eps * float(np.max(np.abs(y)))
    spread = max(float(np.sqrt(residual @ residual / (len(x) - 2))), rounding)
    error = spread / float(np.sqrt(x0 @ x0))
    p = 1.0
    if error:  # 0 if all values are 0, which has no trend
        p = 2.0 * float(stdtr(len(x) - 2, -abs(slope) / error))
    return Trend(slope=slope, change=slope * float(np.ptp(x)), p=p)
