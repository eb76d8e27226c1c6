"""Sensitivities: shares of an output's variance."""

from dataclasses import dataclass

import numpy as np

from hesr.extras.sweep.study import SweepStudy
from hesr_model.support.arrays import Array

_CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Shares of the variance of an output by input (d,), with 95 % bootstrap intervals (d, 2)."""

    output: str
    first: Array
    total: Array
    first_interval: Array
    total_interval: Array


def sensitivities(outputs: Array, study: SweepStudy) -> list[Sensitivity]:
    """Return the indices of outputs (runs, m) that vary and never failed, for a "sobol" design."""
    if study.design != "sobol" or study.runs is None:
        return []
    from scipy.stats import bootstrap  # slow to import

    found = []
    for one, values in zip(study.outputs, outputs.T, strict=True):
        if not np.isfinite(values).all() or np.ptp(values) == 0.0:
            continue
        blocks = values.reshape(len(study.names) + 2, study.runs)
        blocks = blocks - blocks[:2].mean()  # reduces the error of the estimates
        # The bootstrap of scipy's `sobol_indices` takes no seed.
        spread = bootstrap(
            [np.arange(study.runs)],
            lambda chosen, of=blocks: _shares(of[:, chosen]),
            vectorized=False,
            confidence_level=_CONFIDENCE,
            n_resamples=499,
            rng=np.random.default_rng(study.seed),
        )
        first, total = _shares(blocks)
        intervals = np.stack(spread.confidence_interval, axis=-1)
        found.append(
            Sensitivity(
                output=one.name,
                first=first,
                total=total,
                first_interval=intervals[0],
                total_interval=intervals[1],
            )
        )
    return found


def _shares(blocks: Array) -> Array:
    """Return (2, d) indices by Saltelli et al. (2010)."""
    a, b, mixed = blocks[0], blocks[1], blocks[2:]
    first = np.mean(b * (mixed - a), axis=1)
    total = 0.5 * np.mean((a - mixed) ** 2, axis=1)
    return np.asarray(np.stack([first, total]) / np.var(blocks[:2]))
