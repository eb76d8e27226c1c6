"""Robot logs: read from CSV or Parquet, checked, written."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hesr_model.errors import LogError
from hesr_model.files import sha256, written_whole
from hesr_model.log_format import Columns
from hesr_model.robot import RobotDescription
from hesr_model.tables import Table, read_table, write_table

Array = NDArray[np.float64]

_LONGEST_GAP = 10.0
"""In sample periods: across a longer gap, velocity and hysteresis states are guesswork."""

_RATE_MARGIN = 2.0

_LEAST_TRAVEL = 5e-3
"""[rad or m] Encoders flicker by less; a joint that is used travels further."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotLog:
    """What a robot recorded during one motion.

    Attributes
    ----------
    name
        Of the motion; the file's name without its suffix where the log was read.
    t
        (N,) [s], increasing.
    q
        (N, n) [rad; m for prismatic joints].
    dq
        (N, n) [rad/s; m/s], or None where the robot does not log its velocity.
    tau
        (N, n) [N.m; N], currents already converted.
    path, sha256
        Where the log was read from, and the hash of that file.
    """

    name: str
    t: Array
    q: Array
    dq: Array | None
    tau: Array
    path: Path | None = None
    sha256: str = ""

    @property
    def where(self) -> str:
        """How an error names this log: by its file, or by its name."""
        return str(self.path) if self.path else f"log '{self.name}'"

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.t)))

    @classmethod
    def read(cls, path: Path, robot: RobotDescription) -> "RobotLog":
        """Read a CSV (with a header) or a Parquet file and check it.

        Rows in messages are counted as an editor shows them: the header of a CSV is row 1, the
        first row of its data row 2. A Parquet file has no header: its first row is row 1.

        Raises
        ------
        LogError
            If the file is missing, empty or not a table; if a column is missing; if joints are
            more or fewer than the robot's; if a cell is empty, not a number, NaN or infinite; if
            time does not increase, leaps, or runs at another rate than the robot's.
        RobotError
            If the robot file has not one current gain per joint.
        """
        robot.require_one_per_joint()
        table = read_table(path)
        columns, n = robot.log.columns, len(robot.joints)
        t = table.numbers([columns.t])[:, 0]
        q = _joints(table, columns.q, n)
        dq = _joints(table, columns.dq, n) if columns.dq else None
        tau = _torque(table, robot)
        log = cls(name=path.stem, t=t, q=q, dq=dq, tau=tau, path=path, sha256=sha256(path))
        _require_steady_time(log, table, robot)
        return log

    def write(self, path: Path) -> None:
        """Write as CSV or, by the suffix ``.parquet``, as Parquet; numbers survive unchanged.

        The columns are ``t, q1.., dq1.., tau1..``, the defaults of a robot file.

        Raises
        ------
        ArtifactError
            If the file cannot be written.
        """
        columns = {"t": self.t}
        for name, values in (("q", self.q), ("dq", self.dq), ("tau", self.tau)):
            if values is not None:
                columns |= {f"{name}{k}": column for k, column in enumerate(values.T, start=1)}
        with written_whole(path) as temporary:
            write_table(temporary, columns)


def require_moving(logs: Sequence[RobotLog], joints: Sequence[str]) -> None:
    """Check that every joint moves in at least one of the logs.

    Raises
    ------
    LogError
        Naming the joint and the logs.
    """
    travel = np.max([np.ptp(log.q, axis=0) for log in logs], axis=0)
    for joint, moved in zip(joints, travel, strict=True):
        if moved < _LEAST_TRAVEL:
            raise LogError(
                f"{', '.join(log.where for log in logs)}: the position of joint '{joint}' is "
                f"constant (it moves by {moved:.2g} rad); at least one log must move it."
            )


def _names(columns: Columns, n: int) -> list[str]:
    if isinstance(columns, str):
        return [columns.format(k) for k in range(1, n + 1)]
    return list(columns)


def _joints(table: Table, columns: Columns, n: int) -> Array:
    """One quantity of all joints, (N, n); as many columns as joints."""
    if isinstance(columns, str):
        _require_joint_count(table, columns, n)
    return table.numbers(_names(columns, n))


def _require_joint_count(table: Table, pattern: str, n: int) -> None:
    found = 0
    while pattern.format(found + 1) in table.names:
        found += 1
    if found > n:
        raise LogError(
            f"{table.path}: has column '{pattern.format(n + 1)}', but the robot has {n} joints; "
            "name the columns one by one under 'log.columns' of the robot file to use some."
        )
    rest = [name for name in table.names if name == pattern.format(n)]
    if 0 < found < n and not rest:
        raise LogError(
            f"{table.path}: column '{pattern.format(found + 1)}' is missing; it has {found} "
            f"joints, but the robot has {n}."
        )


def _torque(table: Table, robot: RobotDescription) -> Array:
    """Torque as logged, or from currents where the robot file gives gains for them."""
    columns, gains, n = robot.log.columns, robot.log.torque_per_ampere, len(robot.joints)
    torque, current = _names(columns.tau, n), _names(columns.current, n)
    if gains is not None and current[0] in table.names:
        factors: Array = np.array(gains)
        return _joints(table, columns.current, n) * factors
    if torque[0] in table.names:
        return _joints(table, columns.tau, n)
    if current[0] in table.names:
        raise LogError(
            f"{table.path}: column '{torque[0]}' is missing; to use the currents in "
            f"'{current[0]}', give 'log.torque_per_ampere' in the robot file."
        )
    raise LogError(
        f"{table.path}: column '{torque[0]}' (torque) or '{current[0]}' (current) is missing; "
        f"it has {', '.join(table.names)}."
    )


def _require_steady_time(log: RobotLog, table: Table, robot: RobotDescription) -> None:
    column = robot.log.columns.t
    if len(log.t) < 2:
        raise LogError(f"{log.where}: has {len(log.t)} rows of data; at least 2 are needed.")
    steps = np.diff(log.t)
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0)) + 1
        raise LogError(
            f"{log.where}: column '{column}', row {table.row(k)}: time must increase, but "
            f"{log.t[k]:.10g} s follows {log.t[k - 1]:.10g} s."
        )
    if np.any(steps > _LONGEST_GAP * log.period):
        k = int(np.argmax(steps > _LONGEST_GAP * log.period)) + 1
        raise LogError(
            f"{log.where}: column '{column}', row {table.row(k)}: a gap of {steps[k - 1]:.4g} s; "
            f"at most {_LONGEST_GAP:g} sample periods of {log.period:.4g} s may be missing."
        )
    nominal = robot.log.sample_rate
    if nominal and not 1 / _RATE_MARGIN <= nominal * log.period <= _RATE_MARGIN:
        raise LogError(
            f"{log.where}: column '{column}': rows are {log.period:.4g} s apart, but the robot "
            f"file's sample_rate of {nominal:g} Hz means {1 / nominal:.4g} s; time must be in s."
        )
