"""Which inputs of a sweep matter: shares of an output's variance."""

from dataclasses import dataclass

import numpy as np

from cosim.batch import Array

_CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Shares of the variance of one output.

    Attributes
    ----------
    output : its name.
    first : (d,) what each input explains by itself.
    total : (d,) what it explains with all of its interactions.
    first_interval, total_interval : (d, 2) bootstrap intervals of 95 %.
    """

    output: str
    first: Array
    total: Array
    first_interval: Array
    total_interval: Array


def sensitivities(
    outputs: Array, names: tuple[str, ...], *, inputs: int, runs: int, seed: int
) -> list[Sensitivity]:
    """Return first- and total-order indices of each output, by scipy's Saltelli estimators.

    An output that failed in some runs, or does not vary, has none.

    Parameters
    ----------
    outputs : (runs x (inputs + 2), m) in the order of `design.chosen`.
    names : (m,) of the outputs.
    inputs : how many numbers are varied.
    runs : of each block.
    seed : of the bootstrap.
    """
    from scipy.stats import sobol_indices  # slow to import

    found = []
    for name, values in zip(names, outputs.T, strict=True):
        if not np.isfinite(values).all() or np.ptp(values) == 0.0:
            continue
        blocks = values.reshape(inputs + 2, runs)
        # The output stands there twice, since scipy fails on one output of one input.
        result = sobol_indices(
            func={
                "f_A": blocks[:1].repeat(2, axis=0),
                "f_B": blocks[1:2].repeat(2, axis=0),
                "f_AB": blocks[2:, None].repeat(2, axis=1),
            },
            n=runs,
            rng=np.random.default_rng(seed),
        )
        spread = result.bootstrap(confidence_level=_CONFIDENCE, n_resamples=499)
        first, total = (
            spread.first_order.confidence_interval,
            spread.total_order.confidence_interval,
        )
        found.append(
            Sensitivity(
                output=name,
                first=np.ravel(result.first_order[0]),
                total=np.ravel(result.total_order[0]),
                first_interval=np.column_stack([np.ravel(first.low[0]), np.ravel(first.high[0])]),
                total_interval=np.column_stack([np.ravel(total.low[0]), np.ravel(total.high[0])]),
            )
        )
    return found
