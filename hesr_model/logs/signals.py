"""The smooth motion of a log, and its moving, resting and reversing rows."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hesr_model.equations.low_pass import low_pass_signals
from hesr_model.errors import LogError
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.logs.robot_log import Log, collect_parts
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Integers, Mask, select_rows

REVERSAL_WINDOW = 0.1  # half width [s] of the window around a reversal
_MIN_SETTLED_DURATION = 1.0  # [s] of a record whose ends are left out


def moving(dq: Array, resting_speed: float | Array) -> Mask:
    """Return the rows of a velocity (N,) [rad/s] that are faster than a resting joint."""
    return np.asarray(np.abs(dq) > resting_speed)


def reversals(dq: Array, resting_speed: float) -> Integers:
    """Return the rows of smallest |dq| at each change of sign, between moving rows."""
    rows = np.flatnonzero(moving(dq, resting_speed))
    sign_changes = np.flatnonzero(np.diff(np.sign(dq[rows])))
    reversal_rows = [
        rows[k] + np.argmin(np.abs(dq[rows[k] : rows[k + 1] + 1])) for k in sign_changes
    ]
    return np.array(reversal_rows, dtype=np.intp)


def find_settled_rows(t: Array) -> slice:
    """Return the rows of times (N,) [s] that a low pass did not have to guess at an end.

    It continues a motion beyond its first and last rows, and may reverse there what never did.
    Short records are judged whole.
    """
    if t[-1] - t[0] < _MIN_SETTLED_DURATION:
        return slice(None)
    first = int(np.searchsorted(t, t[0] + REVERSAL_WINDOW))
    last = int(np.searchsorted(t, t[-1] - REVERSAL_WINDOW, side="right"))
    return slice(first, last)


def near_reversals(t: Array, dq: Array, resting_speed: float) -> Mask:
    """Return the rows within `REVERSAL_WINDOW` of a reversal."""
    is_near = np.zeros(len(t), dtype=bool)
    for instant in t[reversals(dq, resting_speed)]:
        is_near |= np.abs(t - instant) <= REVERSAL_WINDOW
    return is_near


def resting_speeds(motions: Sequence["Motion"]) -> Array:
    """Return the speeds (n,) [rad/s] at or below which joints rest in all of some motions."""
    return find_resting_speeds(
        [motion.t for motion in motions],
        [motion.q_raw for motion in motions],
        [motion.dq for motion in motions],
    )


_FILTER_ORDER = 2
_HIGHEST_SHARE_OF_NYQUIST = 0.8
_PADDING_PERIODS = 3.0  # mirrored ends in periods of the cut-off


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """The smoothed motion of a log, at its own time stamps.

    q, dq, ddq (N, n) [rad, rad/s, rad/s2] are low-passed without lag, dq_causal [rad/s] with it, as
    users of FMUs have it. tau [N.m], q_raw [rad], load [N] and temperature [degC] are raw. The
    links behind elastic gears have q_link, dq_link and ddq_link (N, n), if logged.
    """

    name: str
    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    q_raw: Array
    load: Array | None = None
    temperature: Array | None = None
    dq_causal: Array | None = None
    q_link: Array | None = None
    dq_link: Array | None = None
    ddq_link: Array | None = None

    def rows(self, rows: slice | Mask) -> "Motion":
        """Return the motion of some rows, a slice or a mask (N,)."""
        return select_rows(self, rows)

    @property
    def states(self) -> tuple[Array, ...]:
        """Arguments of `Robot.regressor`."""
        if self.q_link is None or self.dq_link is None or self.ddq_link is None:
            return self.q, self.dq, self.ddq
        return self.q_link, self.dq_link, self.ddq_link, self.ddq


def smooth(log: Log, cutoff: float = 15.0) -> Motion:
    """Filter q and dq by a zero-phase Butterworth low pass, and differentiate; raises LogError.

    15 Hz is best on the measured arm: 8 Hz flattens reversals, 25 Hz lets noise of ddq through.
    """
    if len(log.gaps):
        raise LogError(
            f"{log.where}: rows are missing for {np.max(np.diff(log.t)):.4g} s before row "
            f"{log.gaps[0] + 1} of its data; its 'parts()' can be used one by one.",
            code="log.gap",
            where=log.where,
            key="t",
        )
    grid = Grid.from_times(log.t)
    grid.require_filter(log.where, len(log.t), cutoff)
    return filter_log(log, cutoff, grid)


def filter_log(log: Log, cutoff: float, grid: "Grid") -> Motion:
    """Filter rows of a log without gaps on `grid`, unchecked."""
    q_spline = zero_phase(log.t, log.q, cutoff, grid)
    dq_spline = q_spline.derivative() if log.dq is None else zero_phase(log.t, log.dq, cutoff, grid)
    link_spline = None if log.q_link is None else zero_phase(log.t, log.q_link, cutoff, grid)
    return Motion(
        name=log.name,
        t=log.t,
        q=q_spline(log.t),
        dq=dq_spline(log.t),
        ddq=dq_spline.derivative()(log.t),
        tau=log.tau,
        q_raw=log.q,
        load=log.load,
        temperature=log.temperature,
        dq_causal=low_pass_signals(log.t, measured_velocity(log), cutoff),
        q_link=link_spline and link_spline(log.t),
        dq_link=link_spline and link_spline.derivative()(log.t),
        ddq_link=link_spline and link_spline.derivative(2)(log.t),
    )


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Even time stamps from `start` to `end` [s], about a `period` [s] apart."""

    period: float
    start: float
    end: float

    @classmethod
    def from_times(cls, t: Array) -> "Grid":
        """Return the grid over the time stamps t (N,) [s]."""
        return cls(period=float(np.median(np.diff(t))), start=float(t[0]), end=float(t[-1]))

    @property
    def steps(self) -> int:
        """Number of steps."""
        return max(int(np.ceil((self.end - self.start) / self.period)), 1)

    def select_stamps(self, t: Array) -> Array:
        """Return the stamps [s] from t[0] to t[-1], with the digits of `np.linspace`."""
        length = self.end - self.start
        steps = self.steps
        first, last = (t[[0, -1]] - self.start) / length * steps
        k = np.arange(np.ceil(first), np.floor(last) + 1.0)
        return np.where(k == steps, self.end, k * (length / steps) + self.start)

    def padding(self, cutoff: float) -> int:
        """Return the number of mirrored rows for a low pass [Hz]."""
        return int(np.ceil(_PADDING_PERIODS / (cutoff * self.period)))

    def require_filter(self, where: str, row_count: int, cutoff: float) -> None:
        """Raise LogError unless rows at this rate are enough for a low pass [Hz]."""
        period = self.period
        padding = self.padding(cutoff)
        max_cutoff = _HIGHEST_SHARE_OF_NYQUIST * 0.5 / period
        if cutoff > max_cutoff:
            raise LogError(
                f"{where}: its rows are {period:.3g} s apart ({1 / period:.4g} Hz); at this rate "
                f"filter_cutoff can be at most {max_cutoff:.3g} Hz.",
                code="log.cutoff",
                where=where,
                key="log.filter_cutoff",
            )
        if self.steps <= padding:
            raise LogError(
                f"{where}: has {row_count} rows; a low pass at {cutoff:g} Hz needs more than "
                f"{padding + 1} at this rate.",
                code="log.rows_of_filter",
                where=where,
                key="log.filter_cutoff",
            )


def zero_phase(t: Array, values: Array, cutoff: float, grid: Grid | None = None) -> Any:
    """Return the spline of low-passed values (N, ..) at t (N,) [s], for a `cutoff` [Hz]."""
    from scipy.interpolate import make_interp_spline
    from scipy.signal import butter, sosfiltfilt

    grid = grid or Grid.from_times(t)
    stamps = grid.select_stamps(t)
    padding = grid.padding(cutoff)
    sections = butter(_FILTER_ORDER, cutoff, fs=grid.steps / (grid.end - grid.start), output="sos")
    even_values = make_interp_spline(t, values, k=3)(stamps)
    padded = np.concatenate(
        [
            _mirror_start(even_values, padding),
            even_values,
            _mirror_start(even_values[::-1], padding)[::-1],
        ]
    )
    low_passed = sosfiltfilt(sections, padded, axis=0, padlen=0)[padding:-padding]
    return make_interp_spline(stamps, low_passed, k=5)


def measured_velocity(log: Log) -> Array:
    """Return the logged velocity (N, n) [rad/s], or backward differences of the position."""
    if log.dq is not None:
        return log.dq
    dq = np.diff(log.q, axis=0) / np.diff(log.t)[:, None]
    return np.vstack([dq[:1], dq])


def smooth_logs(logs: Iterable[Log], robot: Robot) -> list[Motion]:
    """Return the smooth motions of all parts of logs."""
    cutoff = robot.description.log.filter_cutoff
    return [smooth(part, cutoff) for part in collect_parts(logs)]


def _mirror_start(values: Array, row_count: int) -> Array:
    """Return the rows (rows, n) before the first, mirrored at the start of a fitted parabola.

    Mirrored at the first value, intervals of a static friction cover the truth in only 60 of 100
    logs.
    """
    fitted_count = round(2.0 * row_count / _PADDING_PERIODS) + 1
    k = np.arange(fitted_count)
    # Weights of a least-squares parabola's value at its first row.
    weights = (
        3.0 * (3 * fitted_count * fitted_count - 3 * fitted_count + 2)
        - 18.0 * (2 * fitted_count - 1) * k
        + 30.0 * k * k
    )
    start_value = (
        weights / (fitted_count * (fitted_count + 1) * (fitted_count + 2)) @ values[:fitted_count]
    )
    return np.asarray(2.0 * start_value - values[row_count:0:-1])
