"""Friction that differs by the direction of motion, beyond an offset, which every law has."""

from collections.abc import Iterator, Sequence

import numpy as np

from hesr_model.fitting.estimator import select_laws
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.health.referee import Hypothesis, LeftOutRows, Race
from hesr_model.logs.signals import moving
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import find_resting_speed
from hesr_model.support.text import join_with_or
from hesr_model.units import unit_of_joint


def doubt_one_slope(
    law_name: str, law: FrictionLaw, joint_records: Sequence[FrictionRecord]
) -> Iterator[Hypothesis]:
    """Doubt a law whose errors rise with the speed, with one sign in both directions.

    Laws are odd in the velocity: where each direction has a slope of its own, they leave errors
    that are even.

    Parameters
    ----------
    law_name, law : the fitted law of a joint.
    joint_records : friction of the joint in all logs.
    """
    resting_speed = find_resting_speed(joint_records)
    times = []
    errors = []
    speeds = []
    for record in joint_records:
        is_moving = moving(record.dq, resting_speed)
        times.append(record.t[is_moving])
        errors.append((record.tau - predict_record(law, record))[is_moving])
        speeds.append(record.dq[is_moving])
    error = np.concatenate(errors)
    speed = np.concatenate(speeds)
    if not (np.any(speed > 0.0) and np.any(speed < 0.0)):
        return
    rows = LeftOutRows.split([record.log for record in joint_records], times)
    # What every law has: an offset, a level and a slope, which the fit may have missed.
    usual_columns = np.column_stack([np.ones_like(speed), np.sign(speed), speed])
    columns = np.column_stack([usual_columns, np.abs(speed)])
    slope = float(np.linalg.lstsq(columns, error)[0][-1])
    unit = unit_of_joint("N.m.s/rad", is_prismatic=joint_records[0].sliding)
    direction = "positive" if slope > 0.0 else "negative"
    remedy = "no law that is installed has a slope for each direction"
    names = select_laws("by_direction")
    if names:
        remedy = f"fit {join_with_or(names)}, which has a slope for each direction"
    yield Hypothesis(
        check="direction",
        joint=joint_records[0].joint,
        observation=(
            f"friction rises faster with the speed in {direction} direction, by "
            f"{2.0 * abs(slope):.3g} {unit}, and the law {law_name} has one slope for both"
        ),
        remedy=remedy,
        severity="warning",
        trials=(
            Race(
                rival="one slope for both directions",
                rival_squares=rows.predict(usual_columns, error) ** 2,
                squares=rows.predict(columns, error) ** 2,
            ),
        ),
    )
