"""Comparison of laws on the same test logs: significance and smallest detectable differences.

Since errors are correlated and peak at reversals, the variance of the log ratio of two RMSEs is
estimated from low-frequency cosines of the squared errors (equally weighted cosines: Müller 2007;
Lazarus, Lewis and Stock 2021) and from the differences between logs.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, TypeVar

import numpy as np
from pydantic import Field
from scipy.optimize import brentq
from scipy.special import chdtri, stdtr, stdtrit

from hesr_model.inference.covariance import correlation_length
from hesr_model.support.arrays import Array, Mask

Key = TypeVar("Key")
BIN_SECONDS = 0.05  # length of a bin, whose rows are averaged [s]
SECONDS_PER_DEGREE = 8.0  # minimum duration per degree of freedom [s]
_TIMES_PER_DEGREE = 3.0  # minimum duration per degree of freedom in correlation times
MIN_DEGREES = 4  # degrees of freedom below which no law is called worse: about 40 s of logs
# Standard error of a difference between two sets of logs, over that of one.
_BOTH_SETS_FACTOR = 2.0**0.5
MIN_SECONDS = 40.0
MAX_SECONDS = 1e7
# Factor on p for up to `CALIBRATED_COMPARISONS` simultaneous comparisons and many degrees of
# freedom: a level of 5 % is then at most 6.5 % from 40 s of logs on (`tests/benchmarks`).
CALIBRATION = 5.0
CALIBRATED_COMPARISONS = 8
SIGNIFICANCE = 0.05  # level of p after the factor, adjusted for all laws of a table
POWER = 0.8  # probability with which the smallest detectable difference is found


@dataclass(frozen=True, kw_only=True)
class ErrorRatio:
    """Ratio of the RMSEs of two laws: value and 95 % interval, None if the logs are too short.

    `others` is the interval on as many other logs of this kind: both sets vary within and between
    logs. It needs several logs. `p` is two-sided, times `calibration`, not adjusted. `detectable`
    is the smallest ratio above 1 that these logs would show. All but the value are None if the logs
    are too short.
    """

    value: float
    low: float | None
    high: float | None
    p: float | None = None  # also in earlier results
    others: tuple[float, float] | None = None
    detectable: Annotated[float | None, Field(exclude=True)] = None  # not in JSON

    @property
    def verdict(self) -> str:
        """Comparison of the laws: "better", "worse" or "alike"."""
        if self.p is not None:
            is_significant = self.p < SIGNIFICANCE
        else:  # short logs; rule of earlier versions
            low = self.low
            high = self.high
            is_significant = low is not None and high is not None and (high < 1.0 or low > 1.0)
        if not is_significant:
            return "alike"
        return "better" if self.value < 1.0 else "worse"


@dataclass(frozen=True)
class LawErrors:
    """Squared errors of several laws on the same logs of one joint, ready to be compared.

    Attributes
    ----------
    laws : names.
    log_rmse : (L,) logarithm of the RMSE over all rows.
    rows : (nu, L) contrasts of the influence of time and of logs on `log_rmse`, scaled to the
        variance of one bin; cosines of rising frequency log by log, then differences between logs.
    is_slow : (nu,) whether a row is of the lower half of the frequencies or between logs.
    is_between : (nu,) whether a row is a difference between logs.
    bins : number of bins.
    seconds : duration of all logs [s].
    """

    laws: tuple[str, ...]
    log_rmse: Array
    rows: Array
    is_slow: Mask
    is_between: Mask
    bins: int
    seconds: float

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the variance."""
        return len(self.rows)

    @property
    def too_short(self) -> bool:
        """Whether the logs are too short for any statement."""
        return self.degrees < MIN_DEGREES

    @cached_property
    def best(self) -> int:
        """Number of the law with the lowest error."""
        return int(np.argmin(self.log_rmse))

    def standard_errors(self, other: int) -> Array:
        """Return the standard errors (L,) of the log ratios to another law."""
        return self._estimate_deviations(self.rows - self.rows[:, [other]])

    def ratios(self, other: str, comparison_count: int | None = None) -> dict[str, ErrorRatio]:
        """Return the ratios of all other laws to a law.

        `comparison_count` is the number of simultaneous comparisons, by default that of the other
        laws.
        """
        k = self.laws.index(other)
        values = np.exp(self.log_rmse - self.log_rmse[k])
        if self.too_short:
            return {
                law_name: ErrorRatio(value=float(value), low=None, high=None)
                for law_name, value in zip(self.laws, values, strict=True)
                if law_name != other
            }
        errors = np.maximum(self.standard_errors(k), 1e-300)
        factor = calibration(self._count_comparisons(comparison_count), self.degrees)
        p = np.minimum(1.0, factor * two_sided_probability(np.log(values) / errors, self.degrees))
        interval_factors = np.exp(stdtrit(self.degrees, 0.975) * errors)
        other_factors = self._widening_factors(k, interval_factors)
        detectable_ratios = np.exp(
            errors
            * detection_factor(
                self.degrees, self._find_significance_level(comparison_count, self.degrees)
            )
        )
        return {
            law_name: ErrorRatio(
                value=float(values[i]),
                low=float(values[i] / interval_factors[i]),
                high=float(values[i] * interval_factors[i]),
                p=float(p[i]),
                detectable=float(detectable_ratios[i]),
                others=None
                if other_factors is None
                else (float(values[i] / other_factors[i]), float(values[i] * other_factors[i])),
            )
            for i, law_name in enumerate(self.laws)
            if law_name != other
        }

    def required_seconds(
        self, law_name: str, other: str, ratio: float, comparison_count: int | None = None
    ) -> float:
        """Return the duration [s] of such logs, up to `MAX_SECONDS`, that would show a ratio."""
        difference = self.rows[:, self.laws.index(law_name)] - self.rows[:, self.laws.index(other)]
        error = float(self._estimate_deviations(difference[:, None])[0])

        def surplus(seconds: float) -> float:
            degrees = self.degrees * seconds / self.seconds
            scaled_error = error * np.sqrt(self.seconds / seconds)
            factor = detection_factor(
                degrees, self._find_significance_level(comparison_count, degrees)
            )
            return float(np.log(ratio) - scaled_error * factor)

        shortest = max(MIN_SECONDS, MIN_DEGREES * self.seconds / self.degrees)
        if surplus(shortest) >= 0.0:
            return shortest
        longest = shortest
        while surplus(longest) < 0.0 and longest < MAX_SECONDS:
            longest *= 4.0
        if longest >= MAX_SECONDS:
            return MAX_SECONDS
        return float(brentq(surplus, shortest, longest, rtol=1e-3))

    def _widening_factors(self, other: int, interval_factors: Array) -> Array | None:
        """Return the factors (L,) of the intervals for other logs; None for a single log."""
        log_differences = (self.rows - self.rows[:, [other]])[self.is_between]
        if not len(log_differences):
            return None
        between = stdtrit(len(log_differences), 0.975) * np.sqrt(
            (log_differences**2).mean(axis=0) / self.bins
        )
        return np.asarray(np.exp(_BOTH_SETS_FACTOR * np.maximum(np.log(interval_factors), between)))

    def _find_significance_level(self, comparison_count: int | None, degrees: float) -> float:
        comparisons = self._count_comparisons(comparison_count)
        return SIGNIFICANCE / calibration(comparisons, degrees) / comparisons

    def _count_comparisons(self, comparison_count: int | None) -> int:
        return comparison_count or max(1, len(self.laws) - 1)

    def _estimate_deviations(self, differences: Array) -> Array:
        squares = differences**2
        row_sets = (np.ones(self.degrees, dtype=bool), self.is_slow, self.is_between)
        largest = np.max([squares[rows].mean(axis=0) for rows in row_sets if rows.any()], axis=0)
        return np.asarray(np.sqrt(largest / self.bins))


def law_errors(
    errors: Mapping[str, Sequence[Array]], periods: Sequence[float], among: Iterable[str] = ()
) -> LawErrors:
    """Return the errors of laws on one joint, ready to be compared.

    Parameters
    ----------
    errors : errors (N,) [N.m] of each law on each log.
    periods : sample period of each log [s].
    among : laws whose correlation time counts; by default all.
    """
    laws = tuple(errors)
    squares = [
        np.stack([errors[law_name][k] ** 2 for law_name in laws]) for k in range(len(periods))
    ]
    total = sum(square.sum(axis=1) for square in squares) / sum(
        square.shape[1] for square in squares
    )
    mean = np.maximum(np.asarray(total), 1e-300)
    binned = [
        _average_over_bins(square / (2.0 * mean[:, None]), period)
        for square, period in zip(squares, periods, strict=True)
    ]
    counted_laws = [laws.index(law_name) for law_name in among] or list(range(len(laws)))
    rows = []
    is_slow = []
    for psi, square, period in zip(binned, squares, periods, strict=True):
        degrees = _count_degrees(psi[counted_laws], square.shape[1] * period)
        n = psi.shape[1]
        m = np.arange(1, degrees + 1)
        cosines = np.sqrt(2.0 / n) * np.cos(np.pi * m[:, None] * (np.arange(n) + 0.5) / n)
        rows.append(cosines @ psi.T)
        is_slow.append(m <= (degrees + 1) // 2)
    sizes = np.sqrt([psi.shape[1] for psi in binned])
    _, _, directions = np.linalg.svd(sizes[None, :])  # the first is that of the sizes
    means = np.stack([psi.mean(axis=1) - 0.5 for psi in binned])
    log_differences = directions[1:] @ (sizes[:, None] * means)
    within = sum(map(len, rows))
    between = len(log_differences)
    return LawErrors(
        laws=laws,
        log_rmse=0.5 * np.log(mean),
        rows=np.concatenate([*rows, log_differences]),
        is_slow=np.concatenate([*is_slow, np.ones(between, dtype=bool)]),
        is_between=np.arange(within + between) >= within,
        bins=sum(psi.shape[1] for psi in binned),
        seconds=float(
            sum(square.shape[1] * period for square, period in zip(squares, periods, strict=True))
        ),
    )


def _average_over_bins(values: Array, period: float) -> Array:
    """Return the means (L, n) of values (L, N) over bins; the last bin takes the rest."""
    width = max(1, round(BIN_SECONDS / period))
    count = max(1, values.shape[1] // width)
    starts = width * np.arange(count)
    lengths = np.diff(np.append(starts, values.shape[1]))
    return np.asarray(np.add.reduceat(values, starts, axis=1) / lengths)


def _count_degrees(psi: Array, seconds: float) -> int:
    if psi.shape[1] < 4:
        return 0
    times = [correlation_length(row) for row in psi - psi.mean(axis=0)]
    time = float(np.median(times)) * seconds / psi.shape[1]
    return int(seconds / max(SECONDS_PER_DEGREE, _TIMES_PER_DEGREE * time) + 1e-9)


def calibration(comparisons: int, degrees: float) -> float:
    """Return the factor on p, proportional to the comparisons if many; higher for short logs."""
    return CALIBRATION * (1.0 + 1.5 / degrees) * max(1.0, comparisons / CALIBRATED_COMPARISONS)


def two_sided_probability(t: Array, degrees: float) -> Array:
    """Return the two-sided probabilities of Student's t."""
    return np.asarray(2.0 * stdtr(degrees, -np.abs(t)))


def detection_factor(degrees: float, level: float) -> float:
    """Return the smallest log ratio, in standard errors, that is found with probability `POWER`."""
    low_quantile = chdtri(degrees, POWER)  # the standard error may be estimated too low
    t = stdtrit(degrees, 1.0 - level / 2.0) + stdtrit(degrees, POWER)
    return float(t * np.sqrt(degrees / low_quantile))


def adjust_by_holm(p: Mapping[Key, float]) -> dict[Key, float]:
    """Return probabilities adjusted for the number of comparisons (Holm 1979)."""
    adjusted_p: dict[Key, float] = {}
    running_maximum = 0.0
    for rank, key in enumerate(sorted(p, key=lambda k: p[k])):
        running_maximum = max(running_maximum, min(1.0, (len(p) - rank) * p[key]))
        adjusted_p[key] = running_maximum
    return {key: adjusted_p[key] for key in p}
