"""Paired test of two predictions of the same logs, not of other days or motions.

Errors of neighbouring rows are correlated, so rows are summed in units: whole logs if there are
`ENOUGH`, else blocks of time, longer if residuals are correlated for longer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from scipy.special import stdtrit

from hesr_model.inference.correlation import correlation_length
from hesr_model.support.arrays import Array

Key = TypeVar("Key")
ENOUGH = 8  # minimum number of logs for one unit per log
SHORTEST = 8.0  # minimum length of a block [s]; errors at rest are correlated over 2.4 to 2.8 s
_LENGTHS = 4.0  # minimum length of a block in correlation times
_MOST_UNITS = 256

DRAWS = 20_000

LEVEL = 0.95


@dataclass(frozen=True, kw_only=True)
class Paired:
    """Ratio of two RMSEs, with its 95 % interval; None if there is only one unit.

    `p` is the two-sided probability of a ratio as far from 1 if both were equally good.
    """

    value: float
    low: float | None
    high: float | None
    p: float


def units(
    above: Sequence[Array], below: Sequence[Array], periods: Sequence[float]
) -> tuple[Array, Array]:
    """Return the sums of squares (units,) of two errors (N,) for logs with sample `periods` [s]."""
    if len(above) >= ENOUGH:
        whole = [np.array([float(e @ e) for e in of]) for of in (above, below)]
        return whole[0], whole[1]
    length = max(
        SHORTEST,
        *(
            _LENGTHS * period * correlation_length(error)
            for of in (above, below)
            for error, period in zip(of, periods, strict=True)
        ),
    )
    spans = [len(error) * period for error, period in zip(above, periods, strict=True)]
    length = max(length, sum(spans) / _MOST_UNITS)
    sums = []
    for of in (above, below):
        parts = [
            np.array_split(error**2, max(1, int(span / length)))
            for error, span in zip(of, spans, strict=True)
        ]
        sums.append(np.array([part.sum() for log in parts for part in log]))
    return sums[0], sums[1]


def compare_errors(
    above: Sequence[Array], below: Sequence[Array], periods: Sequence[float]
) -> Paired:
    """Compare two predictions by their errors; see `units`.

    The interval is a bootstrap over units, widened by Student's t. The probability is that of the
    sign-flip test: the errors of each unit can be exchanged if both are equally good.
    """
    a, b = units(above, below, periods)
    flips, seen, drawn = _resamples(len(a))
    value = float(np.sqrt(np.sum(a) / max(float(np.sum(b)), 1e-300)))
    found = abs(_log_ratio(np.sum(a), np.sum(b)))
    change = flips @ (b - a)
    exchanged = np.abs(_log_ratio(np.sum(a) + change, np.sum(b) - change))
    p = (np.count_nonzero(exchanged >= found - 1e-9) + seen) / (len(flips) + seen)
    low = high = None
    if len(a) > 1:
        spread = _log_ratio(drawn @ a, drawn @ b) - _log_ratio(np.sum(a), np.sum(b))
        few = len(a) - 1
        wider = stdtrit(few, (1 + LEVEL) / 2) / 1.96 * np.sqrt(len(a) / few)
        tails = np.quantile(spread, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        low, high = (value * float(np.exp(wider * tail)) for tail in tails)
    return Paired(value=value, low=low, high=high, p=float(p))


@lru_cache(maxsize=8)
def _resamples(count: int) -> tuple[Array, int, Array]:
    rng = np.random.default_rng(0)
    if 2**count <= DRAWS:
        flips, seen = (np.arange(2**count)[:, None] >> np.arange(count)) % 2, 0
    else:
        flips, seen = rng.integers(0, 2, (DRAWS, count)), 1
    drawn = rng.multinomial(count, np.full(count, 1.0 / count), DRAWS)
    return flips.astype(float), seen, drawn.astype(float)


def holm(p: Mapping[Key, float]) -> dict[Key, float]:
    """Return probabilities adjusted for the number of comparisons (Holm 1979)."""
    adjusted: dict[Key, float] = {}
    least = 0.0
    for rank, key in enumerate(sorted(p, key=lambda k: p[k])):
        least = max(least, min(1.0, (len(p) - rank) * p[key]))
        adjusted[key] = least
    return {key: adjusted[key] for key in p}


def _log_ratio(a: Array | float, b: Array | float) -> Array:
    return np.asarray(0.5 * np.log(np.maximum(a, 1e-300) / np.maximum(b, 1e-300)))
