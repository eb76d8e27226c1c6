"""Start of a fit from commands: least squares of the servo's error on the motion.

Along a log, the servo's error is the torque over its gain:

    e + integral (sum of e) + derivative (dq_cmd(t - latency) - dq)
        = (body + armature ddq + viscous dq + coulomb sgn(dq)) / kp,    e = q_cmd(t - latency) - q

Rows that move determine the ratios; the latency is the one with the least squares. Commands may
pass a first-order filter before. A servo of positions has neither integral nor derivative.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.servo.record import ServoRecord
from hesr_model.errors import FitError
from hesr_model.fitting.joint_rows import non_negative_least_squares
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.servo_description import ServoKind
from hesr_model.support.arrays import Array, Mask

MAX_LATENCY = 0.25  # longest latency that is tried [s]
_LATENCY_STEP = 2.5e-3  # [s]
_FILTERS = (0.02, 0.05, 0.1, 0.2, 0.4)  # of commands that are tried [s]
_LEAST_ROWS = 50  # moving rows for four ratios and a latency


@dataclass(frozen=True, kw_only=True)
class ServoStart:
    """Ratios over the gain, latency and filter of the commands [s], and squares [rad2; m2]."""

    body: float
    armature: float
    viscous: float
    coulomb: float
    derivative: float
    integral: float
    latency: float
    command_filter: float
    cost: float


def delay_commands(record: ServoRecord, latency: float, command_filter: float = 0.0) -> Array:
    """Return the commands (N,) in force at each row after a latency, held between rows."""
    return _delay(record, record.q_cmd, latency, command_filter)


def _delay(record: ServoRecord, commands: Array, latency: float, command_filter: float) -> Array:
    """Return commands (N,) of any quantity in force at each row."""
    if command_filter > 0.0:
        filtered = _filter_commands(record.t, commands, command_filter)
        return np.asarray(np.interp(record.t - latency, record.t, filtered))
    acting_rows = np.searchsorted(record.t, record.t - latency + 1e-9, side="right") - 1
    return np.asarray(commands[np.maximum(acting_rows, 0)])


def _filter_commands(t: Array, commands: Array, command_filter: float) -> Array:
    """Return the commands (N,) after a first-order filter, each held until the next row."""
    shares = np.exp(-np.diff(t) / command_filter).tolist()
    steps = commands.tolist()
    filtered = [steps[0]]
    for share, command in zip(shares, steps, strict=False):
        filtered.append(command + share * (filtered[-1] - command))
    return np.array(filtered)


def find_moving_rows(records: Sequence[ServoRecord]) -> list[Mask]:
    """Return the rows of each record that are faster than the resting joint."""
    limit = find_resting_speeds(
        [record.t for record in records],
        [record.q[:, None] for record in records],
        [record.dq[:, None] for record in records],
    )[0]
    return [np.abs(record.dq) > limit for record in records]


def find_filtered_start(records: Sequence[ServoRecord], kind: ServoKind = "position") -> ServoStart:
    """Return the start of least squares whose commands pass a filter."""
    starts = [find_start(records, kind, command_filter) for command_filter in _FILTERS]
    return min(starts, key=lambda start: start.cost)


def find_start(
    records: Sequence[ServoRecord], kind: ServoKind = "position", command_filter: float = 0.0
) -> ServoStart:
    """Return the ratios and the latency of least squares; raise FitError if nothing moves."""
    moving = find_moving_rows(records)
    if sum(int(rows.sum()) for rows in moving) < _LEAST_ROWS:
        raise FitError(
            f"joint '{records[0].joint}' moves in fewer than {_LEAST_ROWS} rows; log more motion"
        )
    columns = _gather([_columns(record) for record in records], moving)
    gain_count = {"position": 0, "voltage": 0, "pd": 1, "pid": 2}[kind]
    best_cost = np.inf
    best: tuple[Array, float] | None = None
    for latency in np.arange(0.0, MAX_LATENCY, _LATENCY_STEP):
        parts = [_find_servo_parts(record, latency, command_filter) for record in records]
        gathered = _gather(parts, moving)
        errors = gathered[:, 0]
        gains = gathered[:, 1 : 1 + gain_count]
        all_columns = np.hstack([columns, -gains])
        count = all_columns.shape[1]
        ratios, cost = non_negative_least_squares(all_columns, errors, non_negative=count)
        if cost < best_cost:
            best_cost = cost
            best = ratios, float(latency)
    assert best is not None
    ratios, latency = best
    body, armature, viscous, coulomb = ratios[:4].tolist()
    derivative, integral = [*ratios[4:].tolist(), 0.0, 0.0][:2]
    return ServoStart(
        body=body,
        armature=armature,
        viscous=viscous,
        coulomb=coulomb,
        derivative=derivative,
        integral=integral,
        latency=latency,
        command_filter=command_filter,
        cost=best_cost,
    )


def _gather(parts: Sequence[Array], moving: Sequence[Mask]) -> Array:
    """Return the moving rows of arrays (N, K), one below the other."""
    return np.concatenate([part[rows] for part, rows in zip(parts, moving, strict=True)])


def _find_servo_parts(record: ServoRecord, latency: float, command_filter: float) -> Array:
    """Return the servo's error, that of the speed, and the integral of the first (N, 3)."""
    errors = delay_commands(record, latency, command_filter) - record.q
    speed_errors = _delay(record, record.dq_cmd, latency, command_filter) - record.dq
    integral = np.concatenate([[0.0], np.cumsum(errors[:-1] * np.diff(record.t))])
    return np.column_stack([errors, speed_errors, integral])


def _columns(record: ServoRecord) -> Array:
    return np.column_stack([record.tau_load, record.ddq, record.dq, np.sign(record.dq)])


def separate_friction(records: Sequence[ServoRecord], start: ServoStart) -> list[FrictionRecord]:
    """Return what the servo's error leaves for friction on moving rows, for starts of laws."""
    friction_records = []
    for record, rows in zip(records, find_moving_rows(records), strict=True):
        load = start.body * record.tau_load
        parts = _find_servo_parts(record, start.latency, start.command_filter)
        servo_torque = parts @ [1.0, start.derivative, start.integral]
        tau = servo_torque - load - start.armature * record.ddq
        if np.any(rows):
            friction_records.append(record.to_friction_record(load, tau).rows(rows))
    return friction_records
