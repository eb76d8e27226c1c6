"""Start of a fit from commands: least squares of the servo's error on the motion.

Along a log, the servo's error is the torque over its gain:

    q_cmd(t - latency) - q = (body + armature ddq + viscous dq + coulomb sgn(dq)) / kp

Rows that move determine the ratios; the latency is the one with the least squares. Commands may
pass a first-order filter before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.servo.record import ServoRecord
from hesr_model.errors import FitError
from hesr_model.fitting.joint_rows import non_negative_least_squares
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.rigid_body.friction_record import FrictionRecord
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
    latency: float
    command_filter: float
    cost: float


def delay_commands(record: ServoRecord, latency: float, command_filter: float = 0.0) -> Array:
    """Return the commands (N,) in force at each row after a latency, held between rows."""
    if command_filter > 0.0:
        filtered = _filter_commands(record, command_filter)
        return np.asarray(np.interp(record.t - latency, record.t, filtered))
    acting_rows = np.searchsorted(record.t, record.t - latency + 1e-9, side="right") - 1
    return np.asarray(record.q_cmd[np.maximum(acting_rows, 0)])


def _filter_commands(record: ServoRecord, command_filter: float) -> Array:
    """Return the commands (N,) after a first-order filter, each held until the next row."""
    shares = np.exp(-np.diff(record.t) / command_filter).tolist()
    commands = record.q_cmd.tolist()
    filtered = [commands[0]]
    for share, command in zip(shares, commands, strict=False):
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


def find_filtered_start(records: Sequence[ServoRecord]) -> ServoStart:
    """Return the start of least squares whose commands pass a filter."""
    starts = [find_start(records, command_filter) for command_filter in _FILTERS]
    return min(starts, key=lambda start: start.cost)


def find_start(records: Sequence[ServoRecord], command_filter: float = 0.0) -> ServoStart:
    """Return the ratios and the latency of least squares; raise FitError if nothing moves."""
    moving = find_moving_rows(records)
    if sum(int(rows.sum()) for rows in moving) < _LEAST_ROWS:
        raise FitError(
            f"joint '{records[0].joint}' moves in fewer than {_LEAST_ROWS} rows; log more motion"
        )
    columns = np.concatenate(
        [_columns(record)[rows] for record, rows in zip(records, moving, strict=True)]
    )
    best_cost = np.inf
    best: tuple[Array, float] | None = None
    for latency in np.arange(0.0, MAX_LATENCY, _LATENCY_STEP):
        errors = np.concatenate(
            [
                (delay_commands(record, latency, command_filter) - record.q)[rows]
                for record, rows in zip(records, moving, strict=True)
            ]
        )
        ratios, cost = non_negative_least_squares(columns, errors, non_negative=len(columns.T))
        if cost < best_cost:
            best_cost = cost
            best = ratios, float(latency)
    assert best is not None
    (body, armature, viscous, coulomb), latency = best[0].tolist(), best[1]
    return ServoStart(
        body=body,
        armature=armature,
        viscous=viscous,
        coulomb=coulomb,
        latency=latency,
        command_filter=command_filter,
        cost=best_cost,
    )


def _columns(record: ServoRecord) -> Array:
    return np.column_stack([record.tau_load, record.ddq, record.dq, np.sign(record.dq)])


def separate_friction(records: Sequence[ServoRecord], start: ServoStart) -> list[FrictionRecord]:
    """Return what the servo's error leaves for friction on moving rows, for starts of laws."""
    friction_records = []
    for record, rows in zip(records, find_moving_rows(records), strict=True):
        load = start.body * record.tau_load
        commands = delay_commands(record, start.latency, start.command_filter)
        tau = commands - record.q - load - start.armature * record.ddq
        friction_record = FrictionRecord(
            log=record.log,
            joint=record.joint,
            t=record.t,
            dq=record.dq,
            q=record.q,
            tau_load=load,
            tau=tau,
            sliding=record.sliding,
        )
        if np.any(rows):
            friction_records.append(friction_record.rows(rows))
    return friction_records
