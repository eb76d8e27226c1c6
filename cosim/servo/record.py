"""Records of one joint in one log: commands, positions, and the rigid body along the motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hesr_model.errors import FitError
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.servo import compute_commands
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_ROUND_OFF = 1e-9  # of positions [rad; m]
_FIRST_ROWS = 10  # least rows that show the first speed
_FIRST_SECONDS = 0.03  # least time that shows the first speed
_CLEAR = 3.0  # least first speed, in its standard errors
_RESTING = 1e-3  # share of the fastest speed below which a log starts at rest
_SLOPE_STEP = 1e-5  # [rad; m] between the postures of a difference


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoRecord:
    """Commands and motion of one joint in one log, and what the bodies need along it.

    Attributes
    ----------
    log, joint : names.
    t : (N,) [s], from 0.
    q_cmd, dq_cmd : (N,) commanded position and speed [rad, rad/s; m, m/s], in force from their row
        until the next.
    q : (N,) measured position, unsmoothed.
    posture, dq, ddq : (N,) smoothed motion.
    inertia : (N,) of the links about the joint [kg.m2; kg], without armature.
    bias : (N,) torque [N.m; N] of gravity and of all motion but the joint's own acceleration, at
        the posture.
    slope : (N,) of the bias over the joint's position [N.m/rad; N/m].
    sliding : whether the joint slides.
    added : known inertia [kg.m2; kg] that the log adds to that of the links.
    current_size : (N,) [A], current without a sign; None if not logged.
    """

    log: str
    joint: str
    t: Array
    q_cmd: Array
    dq_cmd: Array
    q: Array
    posture: Array
    dq: Array
    ddq: Array
    inertia: Array
    bias: Array
    slope: Array
    sliding: bool = False
    added: float = 0.0
    current_size: Array | None = None

    @property
    def tau_load(self) -> Array:
        """Torque (N,) [N.m; N] that the bodies need along the measured motion."""
        return self.inertia * self.ddq + self.bias

    @cached_property
    def first_speed(self) -> float:
        """Speed [rad/s; m/s] at the first row; 0 if the first positions allow it."""
        return _find_first_speed(self)

    def to_friction_record(self, tau_load: Array, tau: Array) -> FrictionRecord:
        """Return a record of friction `tau` under a load (N,) along the measured motion."""
        return FrictionRecord(
            log=self.log,
            joint=self.joint,
            t=self.t,
            dq=self.dq,
            q=self.q,
            tau_load=tau_load,
            tau=tau,
            sliding=self.sliding,
        )


def remove_rotors(robot: Robot, parameters: Array) -> Array:
    """Return parameters (P,) without rotor inertias, which the fit finds as armature."""
    links_only = parameters.copy()
    links_only[10 * robot.links : robot.inertial] = 0.0
    return links_only


def read_servo_records(
    logs: Sequence[Log], robot: Robot, parameters: Array
) -> list[list[ServoRecord]]:
    """Return the records of each joint, [joint][part of a log].

    Parameters
    ----------
    logs : logs with commanded positions.
    robot : robot of the logs, without coupled motors.
    parameters : rigid-body parameters (P,), for inertia and gravity.

    Raises
    ------
    FitError
        If a log has no commanded positions, or motors turn several joints.
    """
    if robot.description.coupling is not None:
        raise FitError("servos of coupled motors are not identified")
    links_only = remove_rotors(robot, parameters)
    joint_records: list[list[ServoRecord]] = [[] for _ in robot.joints]
    for log in logs:
        if log.q_cmd is None:
            raise FitError(f"{log.where}: has no commanded positions (log.columns.q_cmd)")
        for part in log.parts():
            for j, record in enumerate(_read_part(part, robot, links_only)):
                joint_records[j].append(record)
    return joint_records


def _read_part(log: Log, robot: Robot, parameters: Array) -> list[ServoRecord]:
    """Return the records of a part without gaps, by joint."""
    motion = smooth(log, robot.description.log.filter_cutoff)
    assert log.q_cmd is not None
    speeds = compute_commands(log)[1]
    mass, velocity_bias = robot.dynamics(parameters, motion.q, motion.dq)
    records = []
    for j, joint in enumerate(robot.joints):
        other_acceleration = motion.ddq.copy()
        other_acceleration[:, j] = 0.0
        bias = velocity_bias[:, j] + np.einsum("tk,tk->t", mass[:, j], other_acceleration)
        shifted = motion.q.copy()
        shifted[:, j] += _SLOPE_STEP
        shifted_bias = robot.torque(parameters, shifted, motion.dq, other_acceleration)[:, j]
        record = ServoRecord(
            log=log.name,
            joint=joint,
            t=log.t - log.t[0],
            q_cmd=log.q_cmd[:, j],
            dq_cmd=speeds[:, j],
            q=log.q[:, j],
            posture=motion.q[:, j],
            dq=motion.dq[:, j],
            ddq=motion.ddq[:, j],
            inertia=mass[:, j, j],
            bias=bias,
            slope=(shifted_bias - bias) / _SLOPE_STEP,
            sliding=robot.slides[j],
            added=robot.description.scale.find_added_inertia(log.name, joint),
            current_size=None if log.current_size is None else log.current_size[:, j],
        )
        records.append(record)
    return records


def find_encoder_step(records: Sequence[ServoRecord]) -> float:
    """Return the smallest step of the measured positions [rad; m]."""
    steps = np.concatenate([np.abs(np.diff(record.q)) for record in records])
    return float(np.min(steps[steps > _ROUND_OFF], initial=np.inf))


def _find_first_speed(record: ServoRecord) -> float:
    """Return the speed at the first row; 0 if the first positions allow it.

    Smoothed speeds are least known at the ends of a log, and most logs begin at rest.
    """
    smoothed = float(record.dq[0])
    if abs(smoothed) <= _RESTING * float(np.max(np.abs(record.dq))):
        return 0.0
    row_count = max(_FIRST_ROWS, int(np.searchsorted(record.t, _FIRST_SECONDS)))
    t = record.t[:row_count]
    if len(t) < _FIRST_ROWS:
        return smoothed
    q = record.q[:row_count]
    columns = np.column_stack([np.ones_like(t), t, t**2])
    coefficients = np.linalg.lstsq(columns, q, rcond=None)[0]
    changes = np.abs(np.diff(record.q))
    step = float(np.min(changes[changes > 0.0], initial=np.inf))
    noise = max(float(np.std(columns @ coefficients - q)), step / np.sqrt(12.0))
    error = noise * np.sqrt(np.linalg.inv(columns.T @ columns)[1, 1])
    if abs(coefficients[1]) < _CLEAR * error:
        return 0.0
    return smoothed
