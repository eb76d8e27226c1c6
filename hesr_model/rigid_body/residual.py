"""Friction records: measured torque minus rigid-body torque (eq. 8)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, find_settled_rows, reversals, smooth
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.units import unit_of_joint


def transform_records(log_records: Sequence[FrictionRecord]) -> list[FrictionRecord]:
    """Transform the records of one log to friction coordinates, as laws need."""
    if not log_records or log_records[0].coupling is None:
        return list(log_records)
    coupling = log_records[0].coupling
    transforms = dict.fromkeys(("dq", "dq_causal", "q"), coupling.motion)
    transforms |= dict.fromkeys(("tau_load", "tau", "tau_load_spread"), coupling.torque)
    transformed_columns: dict[str, Array | None] = {}
    for name, transform in transforms.items():
        columns = [getattr(record, name) for record in log_records]
        is_known = all(column is not None for column in columns)
        transformed_columns[name] = transform(np.stack(columns, axis=1)) if is_known else None
    transformed_records = []
    for j, record in enumerate(log_records):
        changes = {name: _select_joint(values, j) for name, values in transformed_columns.items()}
        transformed_records.append(replace(record, **changes, coupling=None))
    return transformed_records


def _select_joint(values: Array | None, j: int) -> Any:
    """Return the values of a joint (N, ..) from those of all, (N, n, ..); None if unknown."""
    if values is None:
        return None
    return np.ascontiguousarray(values[:, j])


def transform_all_records(
    records: Sequence[Sequence[FrictionRecord]],
) -> list[list[FrictionRecord]]:
    """Transform records [joint][log] to friction coordinates; see `transform_records`."""
    records_by_log = [transform_records(log_records) for log_records in zip(*records, strict=True)]
    return [list(joint_records) for joint_records in zip(*records_by_log, strict=True)]


def friction_records(log: Log, robot: Robot, body: RigidBody) -> list[FrictionRecord]:
    """Separate friction from a log (eq. 8); raises LogError or RobotError."""
    return motion_records(smooth(log, robot.description.log.filter_cutoff), robot, body)


def motion_records(motion: Motion, robot: Robot, body: RigidBody) -> list[FrictionRecord]:
    """Return the friction records of a smoothed log; LogError if it has no torque."""
    if not motion.tau.shape[1]:
        raise LogError(
            f"log '{motion.name}': has no torque, from which friction would be separated.",
            code="log.no_torque",
            where=motion.name,
            key="tau",
        )
    tau_body = body.torque(robot, motion)
    has_own_load = motion.load is not None  # of a cylinder
    tau_load = motion.load
    tau_spread = None
    if tau_load is None:
        tau_load = tau_body
        tau_spread = body.torque_spread(robot, motion)
    ratios = robot.description.gear_ratio or (None,) * robot.n
    records = []
    for j, joint in enumerate(robot.description.joints):
        record = FrictionRecord(
            log=motion.name,
            joint=joint,
            t=motion.t,
            dq=_select_joint(motion.dq, j),
            q=_select_joint(motion.q_raw, j),
            tau_load=_select_joint(tau_load, j),
            tau=motion.tau[:, j] - tau_body[:, j],
            tau_load_spread=None if tau_spread is None else tau_spread[:, j],
            gear_ratio=ratios[j],
            sliding=robot.slides[j],
            temperature=None if motion.temperature is None else motion.temperature[:, j],
            coupling=robot.description.coupling,
            dq_causal=_select_joint(motion.dq_causal, j),
            tau_body=tau_body[:, j] if has_own_load else None,
        )
        records.append(record)
    return records


def find_resting_speed(joint_records: Sequence[FrictionRecord]) -> float:
    """Return the speed [rad/s, m/s] at or below which a joint rests in all of its records."""
    speeds = find_resting_speeds(
        [record.t for record in joint_records],
        [record.q[:, None] for record in joint_records],
        [record.dq[:, None] for record in joint_records],
    )
    return float(speeds[0])


def require_reversals(joint_records: Sequence[FrictionRecord]) -> None:
    """Raise LogError if the velocity of a joint never reverses, or only where it is smoothed."""
    resting_speed = find_resting_speed(joint_records)
    if not any(_reverses(record, resting_speed) for record in joint_records):
        unit = unit_of_joint("rad/s", is_prismatic=joint_records[0].sliding)
        raise LogError(
            f"log {', '.join(record.log for record in joint_records)}: the velocity of joint "
            f"'{joint_records[0].joint}' never reverses between speeds of more than "
            f"{resting_speed:.3g} {unit}, so that an offset and Coulomb friction cannot be "
            "separated; at least one log must reverse it."
        )


def _reverses(record: FrictionRecord, resting_speed: float) -> bool:
    """Return whether a joint reverses where the low pass did not have to guess at an end."""
    rows = find_settled_rows(record.t)
    return len(reversals(record.dq[rows], resting_speed)) > 0
