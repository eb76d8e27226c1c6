"""Predictions of laws for measured friction records, and their errors over rows of all logs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict, record_start
from hesr_model.friction.thermal import Thermal
from hesr_model.logs.signals import moving, near_reversals
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import find_resting_speed
from hesr_model.support.arrays import Array, Mask


def predict_record(
    law: FrictionLaw,
    record: FrictionRecord,
    *,
    measured_start: bool = False,
    thermal: Thermal | None = None,
) -> Array:
    """Return the (N,) torque [N.m] of a law for a record, at its temperature if `thermal` is given.

    `measured_start` estimates the initial states from the first torques.
    """
    start = None
    if measured_start and law.start_samples:
        start = record_start(law, record)
    if thermal:
        # it imports SciPy's optimisers
        from hesr_model.friction.thermal_law import predict_thermal

        return predict_thermal(law, thermal, record, start)
    return predict(law, **record.motion, start=start)


def training_error(law: FrictionLaw, joint_records: Sequence[FrictionRecord]) -> float:
    """Return the RMSE [N.m] of a law over all records of its joint."""
    return rmse(
        np.concatenate([predict_record(law, record) - record.tau for record in joint_records])
    )


@dataclass(frozen=True, kw_only=True)
class Score:
    """Prediction errors [N.m] and R^2 of one joint; None without rows of the kind."""

    tau_std: float  # error of the measured mean
    rmse: float
    rmse_reversal: float | None
    rmse_moving: float | None
    r2: float | None
    rmse_rest: float | None = None


def score(joint_records: Sequence[FrictionRecord], predictions: Sequence[Array]) -> Score:
    """Score predictions (N,) [N.m] of one joint's friction on each record's rows."""
    error = _subtract_predictions(joint_records, predictions)
    is_near_reversal, is_moving = _classify_rows(joint_records)
    tau_std = float(np.std(np.concatenate([record.tau for record in joint_records])))
    determination = None
    if tau_std > 0:
        determination = 1.0 - (rmse(error) / tau_std) ** 2
    return Score(
        tau_std=tau_std,
        rmse=rmse(error),
        rmse_reversal=_find_rmse(error, is_near_reversal),
        rmse_moving=_find_rmse(error, is_moving),
        r2=determination,
        rmse_rest=_find_rmse(error, ~is_moving),
    )


def _subtract_predictions(
    joint_records: Sequence[FrictionRecord], predictions: Sequence[Array]
) -> Array:
    """Return measured less predicted torques [N.m] over the rows of all records."""
    errors = []
    for record, tau_predicted in zip(joint_records, predictions, strict=True):
        errors.append(record.tau - tau_predicted)
    return np.concatenate(errors)


def _find_rmse(error: Array, rows: Mask) -> float | None:
    """Return the RMSE over some rows; None if there are none."""
    if not np.any(rows):
        return None
    return rmse(error[rows])


@dataclass(frozen=True, kw_only=True)
class BandScore:
    """Coverage of one joint's band; None without rows of the kind."""

    held: float  # share of the rows within the band
    held_moving: float | None
    held_reversal: float | None
    least_log: float  # lowest share of a log
    width: float | None  # mean, over that of the constant band of the same coverage


def score_band(
    joint_records: Sequence[FrictionRecord],
    predictions: Sequence[Array],
    bands: Sequence[tuple[Array, Array]],
) -> BandScore:
    """Score the ends (N,) [N.m] of one joint's band on each record's rows."""
    log_masks = []
    for record, (lower, upper) in zip(joint_records, bands, strict=True):
        log_masks.append((record.tau >= lower) & (record.tau <= upper))
    is_held = np.concatenate(log_masks)
    is_near_reversal, is_moving = _classify_rows(joint_records)
    error = np.abs(_subtract_predictions(joint_records, predictions))
    constant = 2.0 * float(np.quantile(error, is_held.mean()))
    width = float(np.concatenate([upper - lower for lower, upper in bands]).mean())
    return BandScore(
        held=float(is_held.mean()),
        held_moving=_find_share(is_held, is_moving),
        held_reversal=_find_share(is_held, is_near_reversal),
        least_log=min(float(log_mask.mean()) for log_mask in log_masks),
        width=width / constant if constant > 0.0 else None,
    )


def _find_share(is_held: Mask, rows: Mask) -> float | None:
    """Return the share of held ones among some rows; None if there are none."""
    if not np.any(rows):
        return None
    return float(is_held[rows].mean())


def _classify_rows(joint_records: Sequence[FrictionRecord]) -> tuple[Mask, Mask]:
    resting_speed = find_resting_speed(joint_records)
    is_near_reversal = np.concatenate(
        [near_reversals(record.t, record.dq, resting_speed) for record in joint_records]
    )
    is_moving = [moving(record.dq, resting_speed) for record in joint_records]
    return is_near_reversal, np.concatenate(is_moving)


def rmse(error: Array) -> float:
    """Return the root mean square of errors."""
    return float(np.sqrt(np.mean(np.square(error))))


def time_band(t: Array, start: float, stop: float) -> Mask:
    """Return the (N,) mask of start <= t < stop [s]."""
    return np.asarray((t >= start) & (t < stop))
