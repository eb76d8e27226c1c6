"""Samples from tables with named columns."""

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_format import TEMPERATURES, Columns, column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.readers.samples import LogSamples
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array


def samples_of(table: LogTable, robot: RobotDescription) -> LogSamples:
    """Read the columns of the robot file; errors as `Log.read`."""
    log, columns = robot.log, robot.log.columns
    drop = log.missing == "drop"
    if log.rate and columns.t not in table.names:
        t, time = np.arange(table.rows) / log.rate, f"rate {log.rate:g} Hz"
    else:
        t = table.times(columns.t, float(log.units.factors("t", 1)[0]), missing=drop)
        time = f"column '{columns.t}'"
    q = _joints(table, columns.q, robot)
    dq = _joints(table, columns.dq, robot) if columns.dq else None
    effort, is_current = _effort(table, robot)
    return LogSamples(
        t=t,
        q=q,
        dq=dq,
        effort=effort,
        is_current=is_current,
        time=time,
        place=lambda k: f"row {table.row(k)}",
        temperature=_temperature(table, robot),
    )


def _joints(table: LogTable, columns: Columns, robot: RobotDescription) -> Array:
    if isinstance(columns, str) and "{name}" not in columns:
        _require_joint_count(table, columns, len(robot.joints))
    return table.numbers(column_names(columns, robot.joints), missing=robot.log.missing == "drop")


def _temperature(table: LogTable, robot: RobotDescription) -> Array | None:
    columns = robot.log.columns.temperature
    there = set(column_names(columns, robot.joints)) & set(table.names)
    return None if columns == TEMPERATURES and not there else _joints(table, columns, robot)


def _require_joint_count(table: LogTable, pattern: str, n: int) -> None:
    # One joint more than the file can have, numbered.
    names = column_names(pattern, [""] * (len(table.names) + n + 1))
    there = set(table.names)
    found = next(k for k, name in enumerate(names) if name not in there)
    if found > n:
        raise LogError(
            f"{table.path}: has column '{names[n]}', but the robot has {n} joints; name the "
            "columns to use under 'log.columns' of the robot file."
        )
    if 0 < found < n and names[n - 1] not in table.names:
        raise LogError(
            f"{table.path}: column '{names[found]}' is missing; it has {found} "
            f"joints, but the robot has {n}."
        )


def _effort(table: LogTable, robot: RobotDescription) -> tuple[Array, bool]:
    columns, gains = robot.log.columns, robot.log.torque_per_ampere
    torque = column_names(columns.tau, robot.joints)[0]
    current = column_names(columns.current, robot.joints)[0]
    if gains is not None and current in table.names:
        return _joints(table, columns.current, robot), True
    if torque in table.names:
        return _joints(table, columns.tau, robot), False
    if current in table.names:
        raise LogError(
            f"{table.path}: column '{torque}' is missing; for the currents in '{current}' add "
            "'log.torque_per_ampere' to the robot file."
        )
    raise LogError(
        f"{table.path}: column '{torque}' (torque) or '{current}' (current) is missing; "
        f"it has {table.listing}."
    )
