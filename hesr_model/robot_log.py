"""Robot logs: read from files of many kinds, converted to SI, checked, written."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hesr_model.errors import LogError
from hesr_model.files import sha256, written_whole
from hesr_model.log_files.bag import is_bag, read_bag
from hesr_model.log_files.columns import read_columns
from hesr_model.log_files.samples import Samples
from hesr_model.robot import RobotDescription
from hesr_model.tables import write_table

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
        """Read a log and check it, columns and units as the robot file says.

        By the suffix it is a CSV (with a header), Parquet (``.parquet``, ``.pq``), MATLAB
        (``.mat``) or a ROS bag (a folder, ``.db3``, ``.mcap``, ``.bag``).

        Rows in messages are counted as an editor shows them: the header of a CSV is row 1, the
        first row of its data row 2. Other files have no header: their first row is row 1.

        Raises
        ------
        LogError
            If the file is missing, empty or not of its kind, or the package that reads it is not
            installed; if a column or topic is missing; if joints are more or fewer than the
            robot's; if a cell is empty, not a number, NaN or infinite; if time does not increase,
            leaps, or runs at another rate than the robot's; if currents come without gains.
        RobotError
            If a list of the robot file has not one entry per joint.
        """
        robot.require_one_per_joint()
        read = read_bag if is_bag(path) else read_columns
        samples = read(path, robot)
        units, n = robot.log.units, len(robot.joints)
        log = cls(
            name=path.stem,
            t=samples.t,
            q=samples.q * units.factors("q", n),
            dq=None if samples.dq is None else samples.dq * units.factors("dq", n),
            tau=_torque(path, samples, robot),
            path=path,
            sha256=sha256(path),
        )
        _require_steady_time(log, samples, robot)
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


def _torque(path: Path, samples: Samples, robot: RobotDescription) -> Array:
    """Torque (N, n) [N.m], from currents where the file holds these."""
    units, gains, n = robot.log.units, robot.log.torque_per_ampere, len(robot.joints)
    if not samples.is_current:
        return np.asarray(samples.effort * units.factors("tau", n))
    if gains is None:
        raise LogError(
            f"{path}: its efforts are currents by 'log.bag.effort' of the robot file, which needs "
            "'log.torque_per_ampere' for them."
        )
    return np.asarray(samples.effort * units.factors("current", n) * gains)


def _require_steady_time(log: RobotLog, samples: Samples, robot: RobotDescription) -> None:
    if len(log.t) < 2:
        raise LogError(f"{log.where}: has {len(log.t)} rows of data; at least 2 are needed.")
    steps = np.diff(log.t)
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0)) + 1
        raise LogError(
            f"{log.where}: {samples.time}, {samples.place(k)}: time must increase, but "
            f"{log.t[k]:.10g} s follows {log.t[k - 1]:.10g} s."
        )
    if np.any(steps > _LONGEST_GAP * log.period):
        k = int(np.argmax(steps > _LONGEST_GAP * log.period)) + 1
        raise LogError(
            f"{log.where}: {samples.time}, {samples.place(k)}: a gap of {steps[k - 1]:.4g} s; "
            f"at most {_LONGEST_GAP:g} sample periods of {log.period:.4g} s may be missing."
        )
    nominal = robot.log.sample_rate
    if nominal and not 1 / _RATE_MARGIN <= nominal * log.period <= _RATE_MARGIN:
        raise LogError(
            f"{log.where}: {samples.time}: rows are {log.period:.4g} s apart, but the robot "
            f"file's sample_rate of {nominal:g} Hz means {1 / nominal:.4g} s; time must be in s, "
            "or its unit stand under 'log.units.t'."
        )
