"""Robot logs, converted to SI and checked."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.bursts import find_short_steps, has_bursts
from hesr_model.logs.log_arrays import MAX_NUMBER, SIGNALS, read_log_arrays
from hesr_model.logs.readers.formats import find_format
from hesr_model.logs.readers.samples import LogSamples
from hesr_model.logs.rest import find_travelling
from hesr_model.logs.tables import number_columns, write_table
from hesr_model.robots.robot import RobotDescription, RobotLike, to_description
from hesr_model.support import frames, plugins
from hesr_model.support.arrays import Array, Integers, Mask, get_arrays, select_rows
from hesr_model.support.files import PathArg, sha256, to_path, written_whole

MIN_GAP_STEPS = 10.0  # gap in usual steps; friction states are unknown after it
USUAL_SHARE = 0.95  # share of the shortest steps, whose mean is usual
SHORTEST_PART = 1.0  # minimum duration of a part [s]
_RATE_MARGIN = 1.25
_COUNTER_SIZES = (2.0**8, 1e3, 2.0**16, 1e6, 2.0**24, 1e9, 2.0**31, 2.0**32)  # of time stamps
_CLOCK_SIZES = (60.0, 3600.0, 43_200.0, 86_400.0)  # [s] after which a clock shows the same time
_SPREAD_REMEDY = "[log] duplicates = 'spread' spreads such rows evenly"
_EPISODES = "episode_index"  # column of a data set whose stamps begin again with each episode
_MIN_CHANGED_SHARE = 0.5  # of rows with a repeated stamp, if they are samples of their own
_MIN_TWIST = 1e-12
_MAX_TWIST = 0.1  # of a gear [rad], and over the joint's motion
_USUAL_TWIST = 5e-3  # [rad] of a gear whose joint hardly moves
_UNITS = {"q": "rad", "dq": "rad/s", "tau": "N.m", "temperature": "degC"}
_UNITS |= {"q_link": "rad", "q_cmd": "rad", "dq_cmd": "rad/s", "current_size": "A"}


class _LogRobot:
    """Field of a log that takes its robot in any form and gives its description."""

    def __get__(self, log: "Log | None", kind: type) -> RobotDescription | None:
        """Return the description; of the class, the default None."""
        return None if log is None else log.__dict__["robot"]

    def __set__(self, log: "Log", robot: RobotLike | None) -> None:
        """Read the description of a robot."""
        log.__dict__["robot"] = None if robot is None else to_description(robot)


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """The record of one motion of a robot.

    Arrays are checked as files are: `hesr.Log(t=t, q=q, dq=dq, tau=tau)` raises
    LogError, with the name of the parameter, for other shapes, missing numbers,
    or time that goes back. Lists and integers become arrays of floating-point
    numbers; (N,) is (N, 1).

    Attributes
    ----------
    name : by default that of the file without suffix.
    t : (N,) [s], increasing.
    q : (N, n) [rad; m for prismatic joints].
    dq : (N, n) [rad/s; m/s]; None if not logged.
    tau : (N, n) [N.m; N]; (N, 0) if not logged, which needs `q_cmd`.
    load : (N, n) [N], load of the friction in cylinders; None if it is that of
        the bodies.
    temperature : (N, n) [degC]; None if not logged.
    q_link : (N, n) [rad; m] behind elastic gears, `q` being that of the motors;
        None if not logged.
    q_cmd, dq_cmd : commanded position and velocity (N, n) [rad, rad/s; m, m/s];
        None if not logged.
    current_size : (N, n) [A], currents without a sign; None if not logged.
    path, sha256 : file of the log, and its hash.
    dropped : number of rows left out, by `LogFormat.missing`.
    left_out : these rows by cause.
    left_over : names in the file that are not used.
    robot : description, also made of a robot file, URDF, MJCF, `Robot`, or the
        name of a shipped robot; None if it is unknown.
    is_checked : True if the arrays fulfil these rules already, as those of
        readers do.
    """

    name: str = "log"
    t: Array
    q: Array
    dq: Array | None = None
    tau: Array = field(default_factory=lambda: np.empty((0, 0)))
    load: Array | None = None
    temperature: Array | None = None
    q_link: Array | None = None
    q_cmd: Array | None = None
    dq_cmd: Array | None = None
    current_size: Array | None = None
    path: Path | None = None
    sha256: str = ""
    dropped: int = 0
    left_out: Mapping[str, int] = field(default_factory=dict)
    left_over: tuple[str, ...] = ()
    robot: _LogRobot = _LogRobot()
    is_checked: bool = field(default=False, repr=False)

    def __post_init__(self) -> None:
        if self.is_checked:
            return
        arrays = {name: getattr(self, name) for name in ("t", *SIGNALS)}
        if np.size(self.tau) == 0:
            arrays["tau"] = None
        for name, values in read_log_arrays(self.where, arrays).items():
            object.__setattr__(self, name, values)
        if arrays["tau"] is None:
            if self.q_cmd is None:
                raise LogError(
                    f"{self.where}: has neither 'tau' nor 'q_cmd'; give torques, or commanded "
                    "positions.",
                    code="log.array.no_torque",
                    where=self.where,
                    key="tau",
                )
            object.__setattr__(self, "tau", np.empty((len(self.t), 0)))
        if self.robot is not None and len(self.robot.joints) != self.q.shape[1]:
            raise LogError(
                f"{self.where}: 'q' has {self.q.shape[1]} joints (columns), but 'robot' has "
                f"{len(self.robot.joints)}.",
                code="log.array.joints",
                where=self.where,
                key="q",
            )
        object.__setattr__(self, "is_checked", True)

    def __repr__(self) -> str:
        return f"Log('{self.name}', {self.q.shape[1]} joints, {self._size})"

    def _repr_html_(self) -> str:
        joints = self.joints
        columns = {"travel of q": np.ptp(self.q, axis=0)}
        if self.has_torque:
            columns["largest |tau|"] = np.abs(self.tau).max(0)
        if self.dq is not None:
            columns["largest |dq|"] = np.abs(self.dq).max(0)
        rows = zip(joints, *(map(float, column) for column in columns.values()), strict=True)
        return frames.html_table(f"Log '{self.name}': {self._size}", ("joint", *columns), rows)

    @property
    def _size(self) -> str:
        return f"{len(self.t)} rows, {np.ptp(self.t):.4g} s at {self.rate:.4g} Hz"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints; numbered if the robot is unknown."""
        if self.robot is not None:
            return self.robot.joints
        return tuple(f"joint{k}" for k in range(1, self.q.shape[1] + 1))

    @property
    def has_torque(self) -> bool:
        """Whether torques were logged; otherwise friction follows from commands."""
        return bool(self.tau.shape[1])

    @property
    def where(self) -> str:
        """File or name of the log, for messages."""
        return str(self.path) if self.path else f"log '{self.name}'"

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def longest_step(self) -> float:
        """Step [s] above which there is a gap: ten usual steps."""
        steps = np.diff(self.t)
        usual_steps = steps[steps <= np.quantile(steps, USUAL_SHARE, method="lower")]
        return MIN_GAP_STEPS * max(self.period, float(np.mean(usual_steps)))

    @property
    def rate(self) -> float:
        """Mean rate between gaps [Hz]."""
        return float(1.0 / np.mean(self._steps))

    @property
    def jitter(self) -> float:
        """Relative standard deviation of the steps between gaps."""
        return float(np.std(self._steps) / np.mean(self._steps))

    @property
    def _steps(self) -> Array:
        steps = np.diff(self.t)
        return np.asarray(steps[steps <= self.longest_step])

    @property
    def gaps(self) -> Integers:
        """Rows (K,) after a gap."""
        return np.flatnonzero(np.diff(self.t) > self.longest_step) + 1

    def rows(self, rows: slice | Integers) -> "Log":
        """Return the log of some rows, a slice or (K,) indices."""
        return select_rows(self, rows)

    def split(self, longest: float) -> "list[Log]":
        """Return the logs between steps above `longest` [s]."""
        ends = [0, *(np.flatnonzero(np.diff(self.t) > longest) + 1).tolist(), len(self.t)]
        return [self.rows(slice(first, last)) for first, last in pairwise(ends)]

    def parts(self) -> "tuple[Log, ...]":
        """Return the parts between gaps that last at least 1 s; raises LogError if none does."""
        parts = self.split(self.longest_step)
        if len(parts) == 1:
            return (self,)
        long_parts = tuple(part for part in parts if np.ptp(part.t) >= SHORTEST_PART)
        if not long_parts:
            raise no_parts_error(self.where, len(parts) - 1, self.longest_step)
        return long_parts

    @classmethod
    def read(cls, path: PathArg, robot: RobotLike) -> "Log":
        """Read and check a log as the robot file describes it.

        The suffix gives the format: CSV, maybe packed (``.gz``, ``.bz2``,
        ``.xz``), Parquet, Feather, Excel, HDF5, NumPy, MATLAB or a ROS bag (a
        folder, ``.db3``, ``.mcap``, ``.bag``). Messages count rows from 1, with
        the header of a CSV.

        Parameters
        ----------
        path : file, or folder of a ROS bag.
        robot : robot, its description, or the path of its file.

        Raises
        ------
        LogError
            If the file cannot be read, a column or topic is missing, the number
            of joints is wrong, a cell is not a finite number, time does not
            increase or has another rate than the robot file, or currents lack
            torque constants.
        RobotError
            If a list of the robot file has not one entry per joint.
        """
        path, robot = to_path(path, "a log"), to_description(robot)
        robot.require_one_per_joint()
        file_samples = find_format(path).read(path, robot).continue_time(robot.log)
        samples = file_samples.sort_samples(robot.log)
        log = replace(convert_samples(path, samples, robot), sha256=sha256(path))
        require_rows(log.where, len(log.t), log.left_out)
        require_increase(log, samples)
        require_rate(f"{log.where}: {samples.time}", log.period, 1.0 / log.rate, robot)
        return log

    @property
    def _signals(self) -> dict[str, Array]:
        return {name: values for name, values in get_arrays(self).items() if name in _UNITS}

    @property
    def _columns(self) -> dict[str, Array]:
        return {"t": self.t} | number_columns(**self._signals)

    def plot(self) -> Any:
        """Draw position, velocity and torque over time; return matplotlib axes (n, 3)."""
        return plugins.find("hesr.objects", "plot-log")(self)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` of ``q1.., dq1.., tau1..`` (SI) over ``t`` [s].

        Raises ConfigError if pandas is not installed.
        """
        return frames.pandas_frame(self._columns, index="t")

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` over time [s] and joint; ConfigError if xarray is missing."""
        signals = self._signals.items()
        return frames.import_library("xarray").Dataset(
            {name: (("t", "joint"), values, {"units": _UNITS[name]}) for name, values in signals},
            coords={"t": ("t", self.t, {"units": "s"}), "joint": list(self.joints)},
            attrs={"name": self.name},
        )

    def write(self, path: PathArg) -> None:
        """Write the log as CSV or, with suffix ``.parquet``, as Parquet, with all digits.

        The columns ``t, q1.., dq1.., tau1.., temperature1..`` are the defaults
        of a robot file. Raises ArtifactError if the file cannot be written.
        """
        with written_whole(to_path(path, "a log")) as temporary:
            write_table(temporary, self._columns)


def convert_samples(path: Path, samples: LogSamples, description: RobotDescription) -> Log:
    """Convert samples of a file to SI; errors as `Log.read`, but for time stamps."""
    units = description.log.units
    n = len(description.joints)
    _require_usable_numbers(path, samples, description.joints)

    def convert_signal(quantity: str, values: Array | None) -> Any:
        if values is None:
            return None
        zero = (quantity == "q" and description.log.zero) or 0.0
        return _to_joints(values * units.factors(quantity, n), description) + zero

    load = None
    temperature = samples.temperature
    if description.log.cylinder is None:
        tau = _convert_torque(path, samples, description)
    else:
        tau, load = description.log.cylinder.forces(samples.effort)
    if temperature is not None:
        temperature = temperature - units.zero_of_temperature
    dq = convert_signal("dq", samples.dq)
    q = convert_signal("q", samples.q)
    if q is None:
        q = integrate_velocity(samples.t, dq)
    return Log(
        name=path.stem,
        t=samples.t,
        q=q,
        dq=dq,
        q_cmd=convert_signal("q", samples.q_cmd),
        dq_cmd=convert_signal("dq", samples.dq_cmd),
        current_size=_convert_current_size(samples, description),
        tau=tau,
        load=load,
        temperature=temperature,
        q_link=_convert_q_link(path, samples, q, description),
        path=path,
        dropped=sum(samples.left_out.values()),
        left_out=samples.left_out,
        left_over=samples.left_over,
        robot=description,
        is_checked=True,  # with places in the file
    )


def _convert_current_size(samples: LogSamples, description: RobotDescription) -> Array | None:
    """Return the currents (N, n) [A] whose sign was not logged."""
    if samples.current_size is None:
        return None
    factors = description.log.units.factors("current", len(description.joints))
    return np.abs(samples.current_size * factors)


def integrate_velocity(t: Array, dq: Array) -> Array:
    """Return positions (N, n) from 0 by the trapezoidal rule, of `dq` (N, n) at `t` (N,) [s]."""
    changes = 0.5 * (dq[1:] + dq[:-1]) * np.diff(t)[:, None]
    return np.concatenate([np.zeros((1, dq.shape[1])), np.cumsum(changes, axis=0)])[: len(dq)]


def collect_parts(logs: Iterable[Log]) -> list[Log]:
    """Return the parts of all logs; see `Log.parts`."""
    return [part for log in logs for part in log.parts()]


def no_parts_error(where: str, gaps: int, longest: float) -> LogError:
    """Return the error of a log whose gaps of more than `longest` [s] leave nothing."""
    return LogError(
        f"{where}: its {gaps} gaps of more than {longest:.4g} s, {MIN_GAP_STEPS:g} usual steps, "
        f"leave no part of {SHORTEST_PART:g} s.",
        code="log.gaps",
        where=where,
        key="t",
    )


def require_different(logs: Sequence[Log]) -> None:
    """Raise LogError if a log is given twice, as it would count double."""
    logs_by_key: dict[tuple[str, float, float], Log] = {}
    for log in logs:
        key = (log.sha256, float(log.t[0]), float(log.t[-1]))  # parts of a file differ in time
        if log.sha256 and key in logs_by_key:
            raise LogError(
                f"{log.where}: has the same content as {logs_by_key[key].where}; leave one of "
                "them out.",
                code="log.same",
                where=log.where,
            )
        logs_by_key[key] = log


def require_moving(logs: Sequence[Log], joints: Sequence[str]) -> None:
    """Raise LogError if a joint moves in no log."""
    q = [log.q for log in logs]
    travel: Array = np.array([np.ptp(log_q, axis=0) for log_q in q]).max(axis=0)
    require_travel(", ".join(log.where for log in logs), travel, joints, find_travelling(q))


def require_travel(where: str, travel: Array, joints: Sequence[str], is_travelling: Mask) -> None:
    """Raise LogError if the `travel` (n,) [rad, m] of a joint is not `is_travelling` (n,)."""
    for joint, joint_travel, travels in zip(joints, travel, is_travelling, strict=True):
        if not travels:
            raise LogError(
                f"{where}: the position of joint '{joint}' is "
                f"constant (it moves by {joint_travel:.2g} rad); at least one log must move it.",
                code="log.still",
                where=where,
                key=joint,
            )


def _to_joints(motion: Array, description: RobotDescription) -> Array:
    if description.transmission is None or description.transmission.logs == "joint":
        return motion
    return np.asarray(np.linalg.solve(np.array(description.transmission.matrix), motion.T).T)


def _convert_torque(path: Path, samples: LogSamples, description: RobotDescription) -> Array:
    if samples.effort.shape[1] == 0:
        return samples.effort
    gains = description.log.torque_per_ampere
    unit = "current" if samples.is_current else "tau"
    torque: Array = samples.effort * description.log.units.factors(unit, len(description.joints))
    if samples.is_current:
        if gains is None:
            raise LogError(
                f"{path}: the efforts are currents (log.bag.effort); add log.torque_per_ampere to "
                "the robot file.",
                code="log.torque_per_ampere",
                where=path,
                key="log.torque_per_ampere",
            )
        torque = torque * gains
    if description.transmission is None or description.transmission.logs == "joint":
        return torque
    return np.asarray(torque @ np.array(description.transmission.matrix))


def _convert_q_link(
    path: Path, samples: LogSamples, q: Array, description: RobotDescription
) -> Array | None:
    if not description.log.columns.q_link:
        return None
    if samples.q_link is None:
        raise LogError(
            f"{path}: this format has no link encoders; remove 'log.columns.q_link' from the robot "
            "file, or write the log as a table.",
            code="log.q_link",
            where=path,
            key="log.columns.q_link",
        )
    factors = description.log.units.factors("q_link", len(description.joints))
    q_link: Array = samples.q_link * factors + (description.log.zero or 0.0)
    for joint, twist, q_std in zip(
        description.joints, np.std(q - q_link, 0), np.std(q, 0), strict=True
    ):
        if not _MIN_TWIST < twist < max(_MAX_TWIST * q_std, _USUAL_TWIST):
            raise LogError(
                f"{path}: the link encoder of joint '{joint}' does not show the twist of a gear "
                f"(difference to the motor {twist:.2g} rad RMS, motion {q_std:.2g}); check columns "
                "and units.",
                code="log.twist",
                where=path,
                key="log.columns.q_link",
            )
    return q_link


def _require_usable_numbers(path: Path, samples: LogSamples, joints: Sequence[str]) -> None:
    for quantity in ("q", "dq", "effort", "temperature", "q_link", "current_size"):
        values = getattr(samples, quantity)
        if values is not None and not np.all(is_usable := np.abs(values) <= MAX_NUMBER):
            k, column = np.argwhere(~is_usable)[0]
            raise LogError(
                f"{path}: {samples.place(k)}: {quantity} of joint "
                f"'{joints[column * len(joints) // values.shape[1]]}' is "
                f"{values[k, column]:g}; numbers up to {MAX_NUMBER:g} can be used.",
                code="log.too_large_number",
                where=path,
                key=quantity,
            )
    if not np.all(is_usable := np.abs(samples.t) <= MAX_NUMBER):
        k = int(np.argmin(is_usable))
        raise LogError(
            f"{path}: {samples.time}, {samples.place(k)}: the time is {samples.t[k]:g}; numbers up "
            f"to {MAX_NUMBER:g} can be used.",
            code="log.too_large_number",
            where=path,
            key=samples.time,
        )


def require_rows(where: str, row_count: int, left_out: Mapping[str, int]) -> None:
    """Raise LogError for fewer than two rows; others were `left_out`, by cause."""
    if row_count < 2:
        reasons = "".join(f"; {count} rows {cause}" for cause, count in left_out.items())
        raise LogError(
            f"{where}: has {row_count} rows of data; at least 2 are needed{reasons}.",
            code="log.rows",
            where=where,
        )


def require_increase(log: Log, samples: LogSamples, rows_before: int = 0) -> None:
    """Raise LogError if time does not increase in `samples` and the rows `rows_before` them."""
    steps = np.diff(log.t)
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0)) + 1
        raise LogError(
            f"{log.where}: {samples.time}, {samples.place(k - rows_before)}: time must increase, "
            f"but {log.t[k]:.10g} s follows {log.t[k - 1]:.10g} s; {_find_time_remedy(log, k)}.",
            code="log.order",
            where=log.where,
            key="log.columns.t",
        )
    if has_bursts(log.t):
        share = float(np.mean(find_short_steps(log.t)))
        raise LogError(
            f"{log.where}: {samples.time}: {100 * share:.0f} % of its steps are shorter than a "
            f"tenth of the usual one, as stamps of rows that arrive in bursts; {_SPREAD_REMEDY}.",
            code="log.bursts",
            where=log.where,
            key="log.duplicates",
        )


def _find_time_remedy(log: Log, k: int) -> str:
    """Return the line of a robot file that lets time increase at row `k`, in words."""
    step_back = float(log.t[k - 1] - log.t[k])
    if step_back == 0.0:
        if has_bursts(log.t) and _changes_at_repeats(log):
            return _SPREAD_REMEDY
        return "[log] duplicates = 'first' leaves out rows that repeat a time stamp"
    wrap = _find_wrap(log)
    if wrap is not None:
        return f"[log] wrap = {wrap:.10g} lets a counter of that size go on"
    if step_back > 0.5 * float(log.t[k - 1] - log.t[0]):
        return "[log] restart = 'gap' takes the rows from there on as another part"
    return "[log] sort = true sorts rows by time"


def _changes_at_repeats(log: Log) -> bool:
    """Return whether most rows that repeat a stamp have another position than the row before."""
    repeats = np.flatnonzero(np.diff(log.t) == 0.0)
    changes = np.any(log.q[repeats + 1] != log.q[repeats], axis=1)
    return bool(np.mean(changes) > _MIN_CHANGED_SHARE)


def _find_wrap(log: Log) -> float | None:
    """Return the size of a counter, in the unit of its stamps, that explains where time falls."""
    if log.robot is None or _EPISODES in log.left_over:
        return None
    unit = abs(float(log.robot.log.units.factors("t", 1)[0]))
    stamps = log.t / unit
    steps = np.diff(stamps)
    falls = -steps[steps < 0.0]
    usual_step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    for size in (*_COUNTER_SIZES, *(seconds / unit for seconds in _CLOCK_SIZES)):
        missing_steps = size - falls
        goes_on = np.all((missing_steps > 0.0) & (missing_steps < MIN_GAP_STEPS * usual_step))
        # A shorter counter would find a step like the others after any fall.
        is_long = size > 2.0 * MIN_GAP_STEPS * usual_step
        if goes_on and is_long and np.ptp(stamps) < size:
            return float(size)
    return None


def require_rate(
    where: str, median_period: float, mean_period: float, description: RobotDescription
) -> None:
    """Raise LogError if the time between rows [s] is not that of the robot file."""
    nominal = description.log.sample_rate or description.log.rate
    # The mean is robust against jitter, the median against missing rows.
    ratios = [nominal * period for period in (median_period, mean_period) if nominal]
    if nominal and not any(1 / _RATE_MARGIN <= ratio <= _RATE_MARGIN for ratio in ratios):
        raise LogError(
            f"{where}: rows are {median_period:.4g} s apart, but the robot file's "
            f"sample_rate of {nominal:g} Hz means {1 / nominal:.4g} s; give the unit of time, "
            "'log.units.t'."
        )
