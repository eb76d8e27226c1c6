"""Comparison of laws on the same test logs: significance and smallest detectable differences.

Since errors are correlated and peak at reversals, the variance of the log ratio of two RMSEs is
estimated from low-frequency cosines of the squared errors (equally weighted cosines: Müller 2007;
Lazarus, Lewis and Stock 2021). A single log allows statements about itself only. Several logs allow
statements about other logs of the kind: the variance between logs then decides, with one degree of
freedom less than logs. It is shrunk to that of the other pairs of laws (Smyth 2004).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, NamedTuple, TypeVar

import numpy as np
from pydantic import Field
from scipy.optimize import brentq
from scipy.special import chdtri, digamma, polygamma, stdtr, stdtrit

from hesr_model.inference.covariance import correlation_length
from hesr_model.support.arrays import Array, Mask

Key = TypeVar("Key")
BIN_SECONDS = 0.05  # length of a bin, whose rows are averaged [s]
SECONDS_PER_DEGREE = 8.0  # minimum duration per degree of freedom [s]
_TIMES_PER_DEGREE = 3.0  # minimum duration per degree of freedom in correlation times
MIN_DEGREES = 4  # degrees of freedom below which no law is called worse: about 40 s of logs
MIN_BETWEEN_DEGREES = 3  # or degrees of freedom between logs: four logs, also if they are short
MAX_PRIOR_DEGREES = 3.0  # of the variance between logs, taken from the other pairs of laws
_MIN_SHOWN = 1e-6  # share of the variance between logs that differences show
_MAX_LOG_RATIO = 5.0  # intervals and detectable ratios end at a factor of 150
MAX_DETECTION_FACTOR = 20.0  # standard errors above which logs are too few to find a difference
_PRIOR_DEGREES_PER_LAW = 0.25  # of those beyond two; pairs of few laws are no independent draws
_MIN_PRIOR_PAIRS = 3  # pairs whose spread can be estimated
MIN_SECONDS = 40.0
MAX_SECONDS = 1e7
# Factor on the p of a single log for up to `CALIBRATED_COMPARISONS` simultaneous comparisons and
# many degrees of freedom: a level of 5 % is then at most 6.5 % from 40 s on (`tests/benchmarks`).
CALIBRATION = 5.0
CALIBRATED_COMPARISONS = 8
BETWEEN_CALIBRATION = 1.25  # factor on the p of several logs: of two laws 5.8 % were wrong without
SIGNIFICANCE = 0.05  # level of p after the factor, adjusted for all laws of a table
POWER = 0.8  # probability with which the smallest detectable difference is found


@dataclass(frozen=True, kw_only=True)
class ErrorRatio:
    """Ratio of the RMSEs of two laws.

    Attributes
    ----------
    value : the ratio.
    low, high : its 95 % interval, not adjusted for the number of comparisons; None if the logs are
        too short. With several logs it is that of the mean ratio on other logs of the kind, with
        one log that of its rows.
    p : of the interval: below 5 % if and only if that excludes 1.
    others : only in earlier results.
    detectable : smallest ratio above 1 that such logs would show; None if they are too few.
    adjusted_p : `p` adjusted for the number of comparisons (Holm); None in earlier results.
    on_other_logs : whether the interval is that of other logs of the kind.
    """

    value: float
    low: float | None
    high: float | None
    p: float | None = None  # adjusted in earlier results
    others: tuple[float, float] | None = None
    detectable: Annotated[float | None, Field(exclude=True)] = None  # not in JSON
    adjusted_p: float | None = None
    on_other_logs: bool = False

    @property
    def verdict(self) -> str:
        """Comparison of the laws: "better", "worse" or "alike"."""
        p = self.p if self.adjusted_p is None else self.adjusted_p
        if p is not None:
            is_significant = p < SIGNIFICANCE
        else:  # short logs; rule of earlier versions
            low = self.low
            high = self.high
            is_significant = low is not None and high is not None and (high < 1.0 or low > 1.0)
        if not is_significant:
            return "alike"
        if self.value < 1.0:
            return "better"
        return "worse"


class _Deviation(NamedTuple):
    """Standard errors (L,) of log ratios, and their degrees of freedom."""

    errors: Array
    degrees: float


@dataclass(frozen=True)
class LawErrors:
    """Squared errors of several laws on the same logs of one joint, ready to be compared.

    Attributes
    ----------
    laws : names.
    log_rmse : (L,) logarithm of the RMSE over all rows.
    rows : (nu, L) contrasts of the influence of time and of logs on `log_rmse`, scaled to the
        variance of one bin; cosines of rising frequency log by log, then differences between logs.
    is_slow : (nu,) whether a row is of the lower half of the frequencies, or a difference between
        logs or parts of one.
    is_between : (nu,) whether a row is a difference between logs.
    between_degrees : degrees of freedom between logs, fewer if few logs hold most of the error.
    bins : number of bins.
    seconds : duration of all logs [s].
    """

    laws: tuple[str, ...]
    log_rmse: Array
    rows: Array
    is_slow: Mask
    is_between: Mask
    between_degrees: float
    bins: int
    seconds: float

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the variance."""
        return len(self.rows)

    @property
    def too_short(self) -> bool:
        """Whether the logs are too short for any statement."""
        return bool(self.degrees < MIN_DEGREES and self.is_between.sum() < MIN_BETWEEN_DEGREES)

    @cached_property
    def best(self) -> int:
        """Number of the law with the lowest error."""
        return int(np.argmin(self.log_rmse))

    def deviations(self, other: int) -> list[_Deviation]:
        """Return the standard errors of log ratios to another law; the one with the largest counts.

        The first is that of the statement: between logs if there are several. The second is a guard
        against logs that are alike by chance: it is that within logs.
        """
        differences = self.rows - self.rows[:, [other]]
        within = ~self.is_between
        deviations = []
        if self.between_degrees:
            deviations.append(self._estimate_between(other))
        # Of short logs few rows are within; they would be no guard but the largest doubt.
        if within.sum() >= MIN_DEGREES or not deviations:
            is_slow = self.is_slow[within]
            squares = differences[within] ** 2
            largest = np.maximum(squares.mean(axis=0), squares[is_slow].mean(axis=0))
            deviations.append(_Deviation(np.sqrt(largest / self.bins), float(within.sum())))
        return deviations

    def ratios(self, other: str, comparison_count: int | None = None) -> dict[str, ErrorRatio]:
        """Return the ratios of all other laws to a law, with p adjusted for their number.

        `comparison_count` is the number of simultaneous comparisons for which a difference is
        detectable, by default that of the other laws.
        """
        k = self.laws.index(other)
        values = np.exp(self.log_rmse - self.log_rmse[k])
        if self.too_short:
            return {
                law_name: ErrorRatio(value=float(value), low=None, high=None)
                for law_name, value in zip(self.laws, values, strict=True)
                if law_name != other
            }
        half_widths = np.zeros(len(self.laws))
        p = np.zeros(len(self.laws))
        detectable = np.zeros(len(self.laws))
        too_few_logs = False
        for errors, degrees in self.deviations(k):
            level = self._find_significance_level(comparison_count, degrees)
            standard_error_count = detection_factor(degrees, level)
            # By the number of logs and laws alone: a limit on the ratio would select small ones.
            is_too_large = standard_error_count > MAX_DETECTION_FACTOR
            too_few_logs |= self.between_degrees > 0 and is_too_large
            half_widths = np.maximum(half_widths, stdtrit(degrees, 0.975) * errors)
            t = np.log(values) / np.maximum(errors, 1e-300)
            p = np.maximum(p, two_sided_probability(t, degrees))
            detectable = np.maximum(detectable, errors * standard_error_count)
        half_widths = np.minimum(half_widths, _MAX_LOG_RATIO)
        detectable_ratios = np.exp(np.minimum(detectable, _MAX_LOG_RATIO))
        ratios = {}
        for i, law_name in enumerate(self.laws):
            if law_name == other:
                continue
            ratio = ErrorRatio(
                value=float(values[i]),
                low=float(values[i] * np.exp(-half_widths[i])),
                high=float(values[i] * np.exp(half_widths[i])),
                p=float(p[i]),
                on_other_logs=self.between_degrees > 0,
            )
            if not too_few_logs:
                ratio = replace(ratio, detectable=float(detectable_ratios[i]))
            ratios[law_name] = ratio
        return self.adjust(ratios)

    def adjust(self, ratios: Mapping[Key, ErrorRatio]) -> dict[Key, ErrorRatio]:
        """Return ratios whose `adjusted_p` considers that all of them are compared at once."""
        if self.too_short:
            return dict(ratios)
        factor = self._find_factor(len(ratios), self.degrees)
        calibrated_p = {
            key: min(1.0, factor * ratio.p) for key, ratio in ratios.items() if ratio.p is not None
        }
        adjusted_p = adjust_by_holm(calibrated_p)
        return {
            key: replace(ratio, adjusted_p=adjusted_p.get(key)) for key, ratio in ratios.items()
        }

    def required_seconds(
        self, law_name: str, other: str, ratio: float, comparison_count: int | None = None
    ) -> float:
        """Return the duration [s] of such logs, up to `MAX_SECONDS`, that would show a ratio."""
        i = self.laws.index(law_name)
        deviations = self.deviations(self.laws.index(other))

        def surplus(seconds: float) -> float:
            growth = seconds / self.seconds
            detectable = 0.0
            for errors, degrees in deviations:
                # More logs of the same length: each adds a degree of freedom between logs.
                more_degrees = degrees * growth
                level = self._find_significance_level(comparison_count, more_degrees)
                error = float(errors[i]) / np.sqrt(growth)
                detectable = max(detectable, error * detection_factor(more_degrees, level))
            return float(np.log(ratio) - detectable)

        shortest = max(MIN_SECONDS, MIN_DEGREES * self.seconds / max(self.degrees, 1))
        if surplus(shortest) >= 0.0:
            return shortest
        longest = shortest
        while surplus(longest) < 0.0 and longest < MAX_SECONDS:
            longest *= 4.0
        if longest >= MAX_SECONDS:
            return MAX_SECONDS
        return float(brentq(surplus, shortest, longest, rtol=1e-3))

    def _estimate_between(self, other: int) -> _Deviation:
        """Return the deviation between logs of log ratios to a law, shrunk to that of all pairs.

        With few logs the variance of one pair is uncertain. Over that within logs it is similar for
        all pairs, so that their spread tells how much a pair may borrow (Smyth 2004, "limma").
        """
        variance = self._between_variances[:, other]
        degrees = self.between_degrees
        prior_degrees, log_inflation = self._between_prior
        if prior_degrees > 0.0:
            prior = np.exp(log_inflation) * self._within_variances[:, other]
            # Only upwards: some pairs do differ more than others from log to log.
            shrunk = (prior_degrees * prior + degrees * variance) / (prior_degrees + degrees)
            variance = np.maximum(variance, shrunk)
        return _Deviation(np.sqrt(variance / self.bins), degrees + prior_degrees)

    @cached_property
    def _between_variances(self) -> Array:
        return _pair_variances(self.rows[self.is_between])

    @cached_property
    def _within_variances(self) -> Array:
        return _pair_variances(self.rows[~self.is_between])

    @cached_property
    def _between_prior(self) -> tuple[float, float]:
        """Degrees of freedom and logarithm of the usual variance between logs over that within."""
        degrees = self.between_degrees
        if self.is_between.all():
            return 0.0, 0.0
        pairs = np.triu_indices(len(self.laws), 1)
        between = self._between_variances[pairs]
        within = self._within_variances[pairs]
        differs = np.minimum(between, within) > 0.0  # equal predictions have no variance
        if np.count_nonzero(differs) < _MIN_PRIOR_PAIRS:
            return 0.0, 0.0
        # Logarithms of chi-square variables: their mean and variance are known.
        log_inflations = np.log(between[differs] / within[differs])
        log_inflations -= digamma(0.5 * degrees) - np.log(0.5 * degrees)
        excess = float(np.var(log_inflations, ddof=1) - polygamma(1, 0.5 * degrees))
        most = min(MAX_PRIOR_DEGREES, degrees, _PRIOR_DEGREES_PER_LAW * (len(self.laws) - 2))
        half = min(_invert_trigamma(excess), 0.5 * most)
        centre = float(np.mean(log_inflations) + digamma(half) - np.log(half))
        return 2.0 * half, centre

    def _find_significance_level(self, comparison_count: int | None, degrees: float) -> float:
        comparisons = comparison_count or max(1, len(self.laws) - 1)
        return SIGNIFICANCE / self._find_factor(comparisons, degrees) / comparisons

    def _find_factor(self, comparisons: int, degrees: float) -> float:
        """Return the factor on p before Holm's adjustment."""
        if not self.between_degrees:
            return calibration(comparisons, degrees)
        # The law compared with may be the best of these logs, so that all pairs are candidates.
        return BETWEEN_CALIBRATION * 0.5 * (comparisons + 1)


def _pair_variances(rows: Array) -> Array:
    """Return the mean squares (L, L) of differences of all columns of (nu, L)."""
    return np.asarray(((rows[:, :, None] - rows[:, None, :]) ** 2).mean(axis=0))


def _invert_trigamma(value: float) -> float:
    """Return x with trigamma(x) = value by Newton's method; infinity if there is none."""
    if value <= 0.0:
        return np.inf
    x = 0.5 + 1.0 / value  # below the root; 1/trigamma is convex, so that steps converge
    for _ in range(50):
        trigamma = polygamma(1, x)
        step = trigamma * (1.0 - trigamma / value) / polygamma(2, x)
        x += step
        if abs(step) < 1e-10 * x:
            break
    return float(x)


def law_errors(
    errors: Mapping[str, Sequence[Array]],
    periods: Sequence[float],
    among: Iterable[str] = (),
    log_names: Sequence[str] | None = None,
) -> LawErrors:
    """Return the errors of laws on one joint, ready to be compared.

    Parameters
    ----------
    errors : errors (N,) [N.m] of each law on each log.
    periods : sample period of each log [s].
    among : laws whose correlation time counts; by default all.
    log_names : name of each log; parts of one log share it. By default each is a log of its own.
    """
    laws = tuple(errors)
    squares = [_stack_squares(errors, k) for k in range(len(periods))]
    row_count = sum(square.shape[1] for square in squares)
    total = sum(square.sum(axis=1) for square in squares) / row_count
    mean = np.maximum(np.asarray(total), 1e-300)
    counted_laws = [laws.index(law_name) for law_name in among] or list(range(len(laws)))
    binned = []
    rows = []
    is_slow = []
    seconds = 0.0
    for square, period in zip(squares, periods, strict=True):
        duration = square.shape[1] * period
        psi = _average_over_bins(square / (2.0 * mean[:, None]), period)
        degrees = _count_degrees(psi[counted_laws], duration)
        binned.append(psi)
        rows.append(_project_on_cosines(psi, degrees))
        is_slow.append(np.arange(1, degrees + 1) <= (degrees + 1) // 2)
        seconds += duration
    names: list[int | str] = list(range(len(periods)))
    if log_names is not None:
        names = list(log_names)
    bin_counts = np.array([psi.shape[1] for psi in binned])
    means = np.stack([psi.mean(axis=1) - 0.5 for psi in binned])
    weights = bin_counts * (means[:, counted_laws] + 0.5).mean(axis=1)
    log_counts = []
    log_means = []
    log_weights = []
    for name in dict.fromkeys(names):
        parts = [k for k, part_name in enumerate(names) if part_name == name]
        part_differences = _contrast(bin_counts[parts], means[parts])
        rows.append(part_differences)
        is_slow.append(np.ones(len(part_differences), dtype=bool))
        log_counts.append(bin_counts[parts].sum())
        log_means.append(np.average(means[parts], axis=0, weights=bin_counts[parts]))
        log_weights.append(weights[parts].sum())
    inflation, between_degrees = _assess_weights(np.array(log_weights))
    log_differences = np.sqrt(inflation) * _contrast(np.array(log_counts), np.stack(log_means))
    within = sum(map(len, rows))
    between = len(log_differences)
    return LawErrors(
        laws=laws,
        log_rmse=0.5 * np.log(mean),
        rows=np.concatenate([*rows, log_differences]),
        is_slow=np.concatenate([*is_slow, np.ones(between, dtype=bool)]),
        is_between=np.arange(within + between) >= within,
        between_degrees=between_degrees,
        bins=int(bin_counts.sum()),
        seconds=float(seconds),
    )


def _stack_squares(errors: Mapping[str, Sequence[Array]], k: int) -> Array:
    """Return the squared errors (L, N) of all laws on a log."""
    return np.stack([law_errors[k] ** 2 for law_errors in errors.values()])


def _project_on_cosines(psi: Array, degrees: int) -> Array:
    """Return the weights (degrees, L) of the slowest cosines in bins (L, n); the mean is none."""
    n = psi.shape[1]
    m = np.arange(1, degrees + 1)
    cosines = np.sqrt(2.0 / n) * np.cos(np.pi * m[:, None] * (np.arange(n) + 0.5) / n)
    return np.asarray(cosines @ psi.T)


def _contrast(bin_counts: Array, means: Array) -> Array:
    """Return the differences (m - 1, L) between means (m, L), with the variance of one bin."""
    sizes = np.sqrt(bin_counts)
    _, _, directions = np.linalg.svd(sizes[None, :])  # the first is that of the sizes
    return np.asarray(directions[1:] @ (sizes[:, None] * means))


def _assess_weights(log_weights: Array) -> tuple[float, float]:
    """Return the factor on the variance between logs, and its degrees of freedom.

    A log that holds most of the squared error pulls the ratio of all rows to its own, so that
    differences from it are too small. If log ratios of logs have equal variance, that of their
    weighted mean is the sum of w^2, and w^2 (1 - 2 w + sum of w^2) is what differences show.
    """
    count = len(log_weights)
    if count < 2:
        return 1.0, 0.0
    shares = log_weights / max(float(log_weights.sum()), 1e-300)
    square_sum = float(np.sum(shares**2))
    shown = float(np.sum(shares**2 * (1.0 - 2.0 * shares + square_sum)))
    inflation = square_sum / max(shown, _MIN_SHOWN) * (count - 1) / count
    # Halfway between the number of logs and that of logs of equal weight, 1 / sum of w^2, less 1:
    # on draws with unequal logs the first is slightly too many, the second too few.
    degrees = 0.5 * (count + 1.0 / max(square_sum, 1.0 / count)) - 1.0
    return inflation, degrees


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
