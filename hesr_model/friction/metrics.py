"""How good a torque prediction is: over all rows, around reversals, while moving.

Everything is on the raw rows of the logs, pooled: rows count alike, whatever log they are from.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hesr_model.logs.phases import Mask, moving, near_reversals
from hesr_model.rigid_body.residual import FrictionRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Score:
    """One joint's prediction errors, [N.m] but for `r2`; None where no row is of that kind.

    Attributes
    ----------
    tau_std
        Standard deviation of the measured friction, the error of predicting its mean.
    """

    tau_std: float
    rmse: float
    rmse_reversal: float | None
    rmse_moving: float | None
    r2: float | None


def score(records: Sequence[FrictionRecord], predictions: Sequence[Array]) -> Score:
    """Score predictions of one joint's friction, pooled over its records.

    Parameters
    ----------
    predictions
        One array (N,) [N.m] per record, on its rows.
    """
    error = np.concatenate(
        [record.tau - predicted for record, predicted in zip(records, predictions, strict=True)]
    )
    tau = np.concatenate([record.tau for record in records])
    near = np.concatenate([near_reversals(record.t, record.dq) for record in records])
    fast = np.concatenate([moving(record.dq) for record in records])
    tau_std = float(np.std(tau))
    return Score(
        tau_std=tau_std,
        rmse=rmse(error),
        rmse_reversal=rmse(error[near]) if np.any(near) else None,
        rmse_moving=rmse(error[fast]) if np.any(fast) else None,
        r2=1.0 - (rmse(error) / tau_std) ** 2 if tau_std > 0 else None,
    )


def rmse(error: Array) -> float:
    """Root of the mean squared error, of any shape, in the error's unit."""
    return float(np.sqrt(np.mean(np.square(error))))


def time_band(t: Array, start: float, stop: float) -> Mask:
    """Rows (N,) with start <= t < stop [s], for instance one frequency band of a chirp."""
    return np.asarray((t >= start) & (t < stop))
