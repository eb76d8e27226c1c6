"""Fits of slow and fast joints in a unit of length that gives them the peak of usual joints.

Bounds, starts and thresholds of laws are those of usual joints: a fretting rig of 0.3 mm/s, a
cylinder of 18 mm/s or a motor of 1000 rad/s is outside them. What the law of such a joint learns is
converted back by the units of its coefficients; forces and times stay.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hesr_model.fitting.estimator import Estimator, estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.logs.rest import FAST_SHARE, MOVING, MOVING_SHARE
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import find_resting_speed, require_reversals

_LENGTH = re.compile(r"\brad(\d*)")
_MAX_CHANGE = 1e-6  # of the largest torque: round-off of another unit, not a length in the form


def fit_in_own_units(
    law_estimator: Estimator,
    joint_records: Sequence[FrictionRecord],
    fit: Callable[[Sequence[FrictionRecord]], FrictionLaw],
) -> FrictionLaw:
    """Return what `fit` gives for records in a unit of length that suits the joint's speed.

    A form with lengths of its own, as stops of given deflections, is fitted in true units.
    """
    scale = find_motion_scale(joint_records)
    if scale == 1.0:
        return fit(joint_records)
    if law_estimator.baseline:
        # Any motion determines it, also without a reversal; only its band has speeds.
        law = fit(joint_records)
        return replace(law, form=replace(law.form, steady_speed=MOVING / scale))
    if law_estimator.form(law_estimator.typical).stops:
        return fit(joint_records)
    require_reversals(joint_records)  # names the true speeds
    scaled_records = [scale_motion(record, scale) for record in joint_records]
    scaled_law = fit(scaled_records)
    law = unscale_law(scaled_law, scale)
    for record, scaled_record in zip(joint_records, scaled_records, strict=True):
        torque = predict_record(scaled_law, scaled_record)
        change = np.abs(predict_record(law, record) - torque)
        if not np.max(change) <= _MAX_CHANGE * np.max(np.abs(torque)):
            return fit(joint_records)
    return law


def find_motion_scale(joint_records: Sequence[FrictionRecord]) -> float:
    """Return the factor that brings a joint's peak to those of usual joints, 1 for these and rest.

    A slow joint comes near the least of their peaks, 0.2 rad/s, a fast one near the largest,
    10 rad/s. A power of two keeps all digits, so that the same motion in other units gives the same
    fit.
    """
    resting_speed = find_resting_speed(joint_records)
    peak = max(float(np.max(np.abs(record.dq))) for record in joint_records)
    if resting_speed < MOVING:
        exponent = max(round(np.log2(MOVING / MOVING_SHARE / peak)), 0)
    elif resting_speed > MOVING:
        exponent = min(round(np.log2(MOVING / FAST_SHARE / peak)), 0)
    else:
        exponent = 0
    return float(2.0**exponent)


def scale_motion(record: FrictionRecord, scale: float) -> FrictionRecord:
    """Return a record whose positions and velocities are multiplied by `scale`."""
    causal = record.dq_causal
    if causal is not None:
        causal = scale * causal
    gear_ratio = record.gear_ratio
    if gear_ratio is not None:
        gear_ratio = gear_ratio / scale  # the motor turns as far as before
    return replace(
        record,
        q=scale * record.q,
        dq=scale * record.dq,
        dq_causal=causal,
        gear_ratio=gear_ratio,
    )


def unscale_law(law: FrictionLaw, scale: float) -> FrictionLaw:
    """Return the law of the original motion, given that of the motion times `scale`."""
    structure: dict[str, Any] = dict(law.structure)
    if "gear_ratio" in structure.get("ripple", ()):
        ripple = structure["ripple"]
        structure["ripple"] = {**ripple, "gear_ratio": scale * ripple["gear_ratio"]}
    form = estimator(law.name).form(structure)
    form = replace(form, steady_speed=law.form.steady_speed / scale)
    factors = {
        quantity.name: scale ** -find_length_power(quantity.unit) for quantity in form.coefficients
    }
    start = []
    for element, value in zip(form.memory, law.start, strict=True):
        start.append(scale ** -find_length_power(element.unit) * value)
    covariance = law.covariance
    if covariance is not None:
        slopes = np.diag([factors[name] for name in covariance.names])
        covariance = covariance.transform(covariance.names, slopes)
    return replace(
        law,
        structure=structure,
        form=form,
        values={name: factors[name] * value for name, value in law.values.items()},
        start=tuple(start),
        standard_errors={
            name: factors[name] * error for name, error in law.standard_errors.items()
        },
        covariance=covariance,
    )


def find_length_power(unit: str) -> int:
    """Return the power of rad in a unit as ``N.m.s2/rad2``."""
    numerator, _, denominator = unit.partition("/")
    return _count_lengths(numerator) - _count_lengths(denominator)


def _count_lengths(unit: str) -> int:
    return sum(int(power or 1) for power in _LENGTH.findall(unit))
