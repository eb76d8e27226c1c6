"""Motions from tables in memory: data frames, mappings, or arrays."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hesr_model.errors import TableError
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array

_EXPECTED_COLUMNS = "expected t, q, dq, load, or t, q1.., dq1.., load1.. of several joints"
_COLUMN_NAME = re.compile(r"(q|dq|load|tau_load)(\d*)")


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionTable:
    """Motion of some joints: `t` (N,) [s]; `q` [rad], `dq` [rad/s], `load` [N.m], (N, n) each."""

    t: Array
    q: Array
    dq: Array
    load: Array

    def to_records(self, friction: Array, robot_joints: Sequence[str] = ()) -> list[FrictionRecord]:
        """Return the records of all joints for measured friction (N, n) [N.m]."""
        n = self.dq.shape[1]
        if friction.shape[1] != n:
            raise TableError(
                f"y has {friction.shape[1]} columns, but X is the motion of {n} joints; expected "
                "one column for each joint."
            )
        joints = robot_joints or [f"joint{number}" for number in range(1, n + 1)]
        return [
            FrictionRecord(
                log="table",
                joint=joint,
                t=self.t,
                dq=np.ascontiguousarray(self.dq[:, j]),
                q=np.ascontiguousarray(self.q[:, j]),
                tau_load=np.ascontiguousarray(self.load[:, j]),
                tau=np.ascontiguousarray(friction[:, j]),
            )
            for j, joint in enumerate(joints)
        ]


def read_numbers(table: Any, name: str = "X") -> tuple[Array, tuple[str, ...]]:
    """Return the finite numbers (N, P) and column names of a table; raise TableError otherwise."""
    if hasattr(table, "tocsr"):
        raise TableError(f"{name} is a sparse matrix; expected a dense table.")
    names: tuple[str, ...] = ()
    if isinstance(table, Mapping):
        names = tuple(map(str, table))
        values = _stack_columns(table, name)
    else:
        columns = getattr(table, "columns", ())
        if all(isinstance(column, str) for column in columns):
            names = tuple(columns)
        values = np.asarray(table)
    if np.iscomplexobj(values):
        raise TableError(f"Complex data not supported: {name} must hold real numbers.")
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise TableError(f"{name} must hold numbers ({error}).") from error
    if array.ndim != 2:
        raise TableError(
            f"{name} has {array.ndim} dimensions; expected a table of rows and columns. Reshape "
            "your data: X.reshape(-1, 1) has one column, X.reshape(1, -1) one row."
        )
    if array.shape[1] < 1:
        raise TableError(
            f"{name} has 0 feature(s) (shape={array.shape}) while a minimum of 1 is required."
        )
    if len(array) < 1:
        raise TableError(f"{name} has 0 sample(s) (shape={array.shape}); rows are needed.")
    if not np.all(np.isfinite(array)):
        raise TableError(f"{name} contains NaN or infinity; expected finite numbers.")
    return array, names


def read_torques(y: Any, rows: int) -> Array:
    """Return torques as (N, n), from (N,) for one joint; raise TableError if they do not match."""
    if y is None:
        raise TableError(
            "a table of motion requires y to be passed, but the target y is None; pass the "
            "measured torque."
        )
    torques = y
    if not hasattr(y, "tocsr"):
        torques = np.asarray(y)
    if torques.ndim == 1:
        torques = torques.reshape(-1, 1)
    tau, _ = read_numbers(torques, "y")
    if len(tau) != rows:
        raise TableError(f"X has {rows} rows and y {len(tau)}; the numbers must be equal.")
    return tau


def read_motion(values: Array, names: Sequence[str] = ()) -> MotionTable:
    """Return the motion in the columns (N, P) of a table [s, rad, rad/s, N.m].

    Names are t, dq and optionally q and load, numbered from 1 for several joints. Columns without
    names are t, then q, dq and load of all joints.
    """
    columns = _split_by_name(values, names) if names else _split_by_order(values)
    t = columns["t"][:, 0]
    dq = columns["dq"]
    if len(t) < 2:
        raise TableError("X has 1 sample; a motion needs at least 2.")
    if np.any(np.diff(t) <= 0.0):
        row = int(np.argmax(np.diff(t) <= 0.0)) + 1
        raise TableError(
            f"time must increase in X, but t is {t[row]:g} s in row {row + 1}, after "
            f"{t[row - 1]:g} s."
        )
    zeros = np.zeros_like(dq)
    signals = {name: columns.get(name, zeros) for name in ("q", "load")}
    for name, signal in signals.items():
        if signal.shape != dq.shape:
            raise TableError(
                f"X has {signal.shape[1]} columns of {name}, but {dq.shape[1]} of dq; "
                f"{_EXPECTED_COLUMNS}."
            )
    return MotionTable(t=t, dq=dq, **signals)


def _stack_columns(table: Mapping[str, Any], name: str) -> NDArray[Any]:
    lengths = {np.shape(column) for column in table.values()}
    if len(lengths) != 1 or len(next(iter(lengths))) != 1:
        raise TableError(f"{name} has columns of unequal lengths; expected a table.")
    return np.column_stack([np.asarray(column) for column in table.values()])


def _split_by_name(values: Array, names: Sequence[str]) -> dict[str, Array]:
    missing = {"t", "dq"} - {name.rstrip("0123456789") for name in names}
    if missing:
        raise TableError(
            f"X has no column '{sorted(missing)[0]}', only {', '.join(names)}; {_EXPECTED_COLUMNS}."
        )
    columns: dict[str, dict[int, Array]] = {}
    for name, column in zip(names, values.T, strict=True):
        if name == "t":
            columns["t"] = {1: column}
            continue
        match = _COLUMN_NAME.fullmatch(name)
        if not match:
            raise TableError(f"X has the unknown column '{name}'; {_EXPECTED_COLUMNS}.")
        kind = match[1].removeprefix("tau_")
        number = int(match[2] or 1)
        columns.setdefault(kind, {})[number] = column
    tables = {}
    for kind, joint_columns in columns.items():
        in_order = [joint_columns[number] for number in sorted(joint_columns)]
        tables[kind] = np.column_stack(in_order)
    return tables


def _split_by_order(values: Array) -> dict[str, Array]:
    joints, remainder = divmod(values.shape[1] - 1, 3)
    if remainder or not joints:
        raise TableError(
            f"X has {values.shape[1]} columns without names; expected t, and q, dq and load of "
            "each joint."
        )
    parts = np.split(values[:, 1:], 3, axis=1)
    return {"t": values[:, :1], **dict(zip(("q", "dq", "load"), parts, strict=True))}
