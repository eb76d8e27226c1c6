"""Timing checks: torque lag and wrong time-stamp rate.

Friction after a reversal looks like a lag, and unknown rotor inertias look like a wrong rate. So
both tests fit a body with free parameters in addition to friction with memory.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import sympy

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Stop
from hesr_model.health.evidence import SmoothPart, friction_shape
from hesr_model.health.referee import Estimate, Hypothesis, LeftOutRows, Race, Statistic
from hesr_model.inference.covariance import correlation_length
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import transform_motion
from hesr_model.support.arrays import Array, Mask

_FREE_COLUMN_COUNT = 3  # last shapes of friction, whose weights may be negative
_MEMORYLESS_COLUMN_COUNT = 2  # shapes before them, of friction that depends on velocity only
_MAX_DELAY = 0.25  # largest delay searched [s]
_SEARCH_STEP = 0.005  # [s]
_ZERO_SHIFT = round(_MAX_DELAY / _SEARCH_STEP)
_SHIFTS = np.array(_SEARCH_STEP * np.arange(-_ZERO_SHIFT, _ZERO_SHIFT + 1), dtype=float)  # [s]
_RIVAL_STRIDE = 3  # every third shift races against a richer memory
# Squares that a lag explains over those that friction without memory leaves. A memory that no sum
# of stops has leaves up to 0.007; a lag of 0.15 s adds 0.03 and more.
_MIN_SHARE_OF_MEMORY = 0.02
_AVERAGING_WINDOW = 0.1  # [s]
_AVERAGE_SPACING = 0.02  # time between averages [s]
_BODY_SPACING = 5e-3  # time between evaluations of the bodies [s]
_MAX_ROWS = 40_000  # rows of a log, its middle ones
# Error of a joint's lag by memory of other shapes, over what memory explains.
_SYSTEMATIC_SHARE = 0.04
_NARROW_HALF_INTERVAL = 0.01  # half an interval within which a small lag is reported [s]
_MIN_REPORTED_LAG = 0.06  # lag that is reported with a wider interval [s]
# Factors of inertial torque: squared stamp rates.
_INERTIA_SCALES = np.geomspace(1.0 / 16.0, 16.0, 33)
_MIN_REPORTED_RATE = 1.4  # reported factor of a wrong time-stamp rate
# What the right rate leaves of most joints' unexplained squares; a wrong zero leaves 0.6.
_MAX_REMAINING_SQUARES = 0.5
_INTERVAL_ERRORS = 3.0  # standard errors of a stated interval
_MIN_DURATION_TO_DELAY = 8.0  # duration of a log over the largest delay


class Memory(NamedTuple):
    """Shapes of friction that remembers reversals.

    Attributes
    ----------
    widths : (W,) deflections after which friction slides, as shares of the travel.
    slow_shares : (S,) speeds over which friction falls, as shares of the peak speed.
    """

    widths: Array
    slow_shares: tuple[float, ...]


_MEMORY = Memory(np.array(2.5e-4 * 2.0 ** np.arange(9), dtype=float), (0.5,))
# What the lag of a single joint must beat: memory may be shorter or longer, and fall faster.
_RIVAL_MEMORY = Memory(np.geomspace(1.6e-5, 0.128, 8), (0.07, 0.3))


@dataclass(frozen=True, kw_only=True, eq=False)
class LagRows:
    """Shifted torques (N, S, n), regressors (N, n, P) at rest and in motion, friction (N, K).

    One filter averages all of them, so that they keep their phases.
    """

    torques: Array
    static: Array
    inertial: Array
    friction_shapes: tuple[Array, ...]
    is_known: Mask  # (N, n) rows whose friction does not depend on what was before the log

    @classmethod
    def from_log(
        cls, log: Log, robot: Robot, base: Sequence[int], memory: Memory = _MEMORY
    ) -> "LagRows":
        """Evaluate the columns `base` of the regressor, and friction, along a log."""
        from scipy.interpolate import make_interp_spline

        first_row = max(len(log.t) - _MAX_ROWS, 0) // 2
        log = replace(log.rows(slice(first_row, first_row + _MAX_ROWS)), dq=None)
        motion = smooth(log, robot.description.log.filter_cutoff)
        logged_coupling = robot.description.logged
        times = np.arange(
            log.t[0] + _MAX_DELAY, log.t[-1] - _MAX_DELAY, max(_AVERAGE_SPACING, log.period)
        )
        body_rows = slice(None, None, max(1, round(_BODY_SPACING / log.period)))
        q = motion.q[body_rows]
        zeros = np.zeros_like(q)
        static_regressor = robot.regressor(q, zeros, zeros)[:, :, list(base)]
        total_regressor = robot.regressor(q, motion.dq[body_rows], motion.ddq[body_rows])
        total_regressor = total_regressor[:, :, list(base)]
        tau = log.tau
        if logged_coupling is not None:
            static_regressor = logged_coupling.torque(static_regressor)
            total_regressor = logged_coupling.torque(total_regressor)
            tau = logged_coupling.torque(tau)
        u = transform_motion(logged_coupling, log.q)
        v = transform_motion(logged_coupling, motion.dq)
        distance = np.maximum.accumulate(np.abs(u - u[0]), axis=0)
        travel = np.maximum(np.ptp(u, axis=0), 1e-300)
        averages = _build_averages(log.t, times, log.period)
        body_averages = _build_averages(log.t[body_rows], times, log.period)
        even_times = np.arange(log.t[0], log.t[-1], log.period)
        torque_spline = make_interp_spline(
            even_times, _build_averages(log.t, even_times, log.period) @ tau, k=1
        )
        # Friction remembers what was before the log until a joint has passed all deflections.
        has_forgotten = distance > 2.0 * memory.widths[-1] * travel
        return cls(
            torques=torque_spline(times[:, None] + _SHIFTS),
            static=_average_rows(body_averages, static_regressor),
            inertial=_average_rows(body_averages, total_regressor - static_regressor),
            friction_shapes=tuple(
                averages @ _compute_friction_shapes(u[:, j], v[:, j], memory)
                for j in range(robot.n)
            ),
            is_known=averages @ (1.0 * has_forgotten) > 1.0 - 1e-9,
        )


def _average_rows(averages: Any, values: Array) -> Array:
    return np.asarray(averages @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def _build_averages(t: Array, times: Array, period: float) -> Any:
    """Return the sparse weights (M, N) of averages around `times` (M,) of values between rows."""
    from scipy.sparse import csr_array

    half_width = round(max(_AVERAGING_WINDOW, 3.0 * period) / period)
    kernel = np.convolve(np.ones(half_width), np.ones(half_width))[:, None] / half_width**2
    window_times = np.clip(
        times[:, None] + period * np.arange(1 - half_width, half_width), t[0], t[-1]
    )
    rows = np.clip(np.searchsorted(t, window_times) - 1, 0, len(t) - 2)
    fractions = (window_times - t[rows]) / (t[rows + 1] - t[rows])
    weights = np.stack([1.0 - fractions, fractions], axis=-1) * kernel
    indices = np.stack([rows, rows + 1], axis=-1)
    starts = np.arange(len(times) + 1) * 2 * len(kernel)
    return csr_array((weights.ravel(), indices.ravel(), starts), shape=(len(times), len(t)))


def _compute_friction_shapes(u: Array, v: Array, memory: Memory = _MEMORY) -> Array:
    """Return friction of several shapes (N, K) along a position u (N,).

    Those with memory come first, then `_MEMORYLESS_COLUMN_COUNT` of velocity only, then
    `_FREE_COLUMN_COUNT` of velocity that may have negative weights.
    """
    travel = max(float(np.ptp(u)), 1e-300)
    kernel = _build_stops(tuple(memory.widths.tolist()))
    stops = KernelRun(kernel, [np.diff(u, prepend=u[0]) / travel], np.ones_like(u))
    initial_state = np.full(len(memory.widths), np.sign(v[0]))
    stop_shapes = stops.evaluate(np.zeros(0), initial_state, settled=True)
    peak = np.max(np.abs(v), initial=1e-300)
    falling_shapes = [
        stop_shapes * np.exp(-np.abs(v) / (share * peak))[:, None] for share in memory.slow_shares
    ]
    velocity_shapes = np.sign(v), friction_shape(v), v, v * np.abs(v), np.ones_like(v)
    return np.column_stack([stop_shapes, *falling_shapes, *velocity_shapes])


@cache
def _build_stops(widths: tuple[float, ...]) -> Kernel:
    displacement = sympy.Symbol("displacement", real=True)
    stops = [
        Stop(name=f"stop_{k}", unit="1", velocity=displacement, deflection=width, bound=1)
        for k, width in enumerate(widths)
    ]
    return Kernel(stops, (), (displacement,), [stop.state for stop in stops], once=True)


def check_clocks(
    part: SmoothPart, joints: Sequence[int], robot: Robot
) -> tuple[list[Hypothesis], Collection[int]]:
    """Doubt the rate of the stamps and the lag of torques of `joints`.

    Returns hypotheses, and joints whose torque lags; none for short logs and those slower than the
    averages.
    """
    is_slow = np.median(np.diff(part.t)) > _AVERAGING_WINDOW
    if is_slow or np.ptp(part.t) < _MIN_DURATION_TO_DELAY * _MAX_DELAY or not joints:
        return [], ()
    base = base_columns(robot)
    rows = LagRows.from_log(part.log, robot, base)
    joint_lags = find_lags(rows, joints)
    # Joints with one lag confirm each other; that of a single joint may be memory of its friction.
    is_common = len(joint_lags) > 1 and len(set(joint_lags.values())) == 1
    rival_rows = rows
    if joint_lags and not is_common:
        rival_rows = LagRows.from_log(part.log, robot, base, _RIVAL_MEMORY)
    hypotheses: list[Hypothesis] = []
    late_joints: set[int] = set()
    for j, lag in joint_lags.items():
        if is_common:
            trials: tuple[Race | Statistic, ...] = (_race_lag(rows, j, lag),)
        else:
            trials = _try_memory(rival_rows, j, lag)
        hypothesis = _doubt_lag(j, lag, robot, trials)
        hypotheses.append(hypothesis)
        if hypothesis.outcome == "won":
            late_joints.add(j)
    rate, certainty = estimate_stamp_rate(rows, joints)
    if max(rate, 1.0 / rate) > _MIN_REPORTED_RATE:
        hypotheses.append(_doubt_rate(rate, certainty))
    return hypotheses, late_joints


def _doubt_lag(
    j: int, lag: Estimate, robot: Robot, trials: tuple[Race | Statistic, ...]
) -> Hypothesis:
    direction = "late" if lag.value > 0 else "early"
    half_interval = 1e3 * _INTERVAL_ERRORS * lag.error
    return Hypothesis(
        check="torque-lag",
        joint=robot.joints[j],
        observation=f"its torque is about {1e3 * abs(lag.value):.0f} ms {direction} relative to "
        f"the motion (+- {half_interval:.0f} ms)",
        remedy="torques were filtered or come from another clock; shift their columns in time",
        severity="warning",
        trials=trials,
        record="faster motion with more reversals",
    )


# Of a joint with too few rows: its lag is neither stated nor denied.
_UNKNOWN_LAG = Statistic(name="its lag", estimate=Estimate(value=1.0, error=np.inf), high=0.0)


def _race_lag(rows: LagRows, j: int, lag: Estimate) -> Race | Statistic:
    """Return the race of a lag against none, by residuals of friction with memory."""
    projected = _project_lag_rows(rows, j)
    if projected is None:
        return _UNKNOWN_LAG
    shapes, torques, _ = projected
    return _race_shifts(_compute_residuals(shapes, torques), _SHIFTS, lag)


def _race_shifts(residuals: Array, shifts: Array, lag: Estimate) -> Race:
    """Return the race of a lag against none, by residuals (N, S) of shifted torques.

    The lag that left-out rows judge is the best of the other rows on the same side of 0.
    """
    squares_by_shift = residuals**2
    zero = int(np.flatnonzero(shifts == 0.0)[0])
    same_side = np.flatnonzero(shifts * np.sign(lag.value) > 0.0)
    # Averages are evenly spaced.
    times = np.arange(len(residuals), dtype=float)
    left_out = LeftOutRows.split([""], [times])
    squares = squares_by_shift[:, zero].copy()
    for judged, trained in zip(left_out.judged, left_out.trained, strict=True):
        totals = squares_by_shift[trained][:, same_side].sum(axis=0)
        squares[judged] = squares_by_shift[judged, same_side[int(np.argmin(totals))]]
    return Race(rival="no lag", rival_squares=squares_by_shift[:, zero], squares=squares)


def _try_memory(rows: LagRows, j: int, lag: Estimate) -> tuple[Race | Statistic, ...]:
    """Return the trials of the lag of one joint against friction with memory of any length.

    In slow motion friction builds up for as long as a clock may be wrong, and what few stops cannot
    follow looks like a lag.
    """
    projected = _project_lag_rows(rows, j)
    if projected is None:
        return (_UNKNOWN_LAG,)
    shapes, torques, _ = projected
    shifts = np.arange(_ZERO_SHIFT % _RIVAL_STRIDE, len(_SHIFTS), _RIVAL_STRIDE)
    race = _race_shifts(_compute_residuals(shapes, torques[:, shifts]), _SHIFTS[shifts], lag)
    memoryless_shapes = shapes[:, -_MEMORYLESS_COLUMN_COUNT:]
    memoryless_residual = _compute_residuals(memoryless_shapes, torques[:, [_ZERO_SHIFT]])
    memoryless_total = max(float(np.sum(memoryless_residual**2)), 1e-300)
    # The gain is a share of what friction with memory leaves; a little of little is no lag.
    remaining_share = float(np.sum(race.rival_squares)) / memoryless_total
    explained_share = Estimate(
        value=race.gain.value * remaining_share, error=race.gain.error * remaining_share
    )
    statistic = Statistic(
        name="what the lag explains, over what friction without memory leaves",
        estimate=explained_share,
        high=_MIN_SHARE_OF_MEMORY,
        errors=_INTERVAL_ERRORS,
    )
    return race, statistic


def _doubt_rate(rate: float, certainty: float) -> Hypothesis:
    speed_text = f"{rate:.2g} times slower"
    if rate <= 1:
        speed_text = f"{1 / rate:.2g} times faster"
    distance = abs(float(np.log(rate)))
    return Hypothesis(
        check="time-scale",
        joint="",
        observation="compared with gravity, its inertial torques are those of a motion that is "
        f"{speed_text}",
        remedy="the time stamps come from a wrong sample rate, or their unit is wrong; see "
        "[log.units] t",
        severity="warning",
        trials=(
            Statistic(
                name="the logarithm of the rate of the stamps",
                # The certainty is twice the log-likelihood ratio: squared standard errors.
                estimate=Estimate(value=distance, error=distance / np.sqrt(max(certainty, 1e-300))),
                high=0.0,
            ),
        ),
        record="faster motion",
    )


def find_lags(rows: LagRows, joints: Sequence[int]) -> dict[int, Estimate]:
    """Return the lags [s] whose intervals exclude 0, by joint.

    Memory of friction absorbs a lag, and friction without it looks like one: the lag of a joint is
    between those of fits with and without it. Friction with memory comes close to the lag of most
    joints together.
    """
    lags_with_memory: dict[int, Estimate] = {}
    lags_without_memory: dict[int, Estimate] = {}
    for j in joints:
        lags_with_memory[j], lags_without_memory[j] = estimate_delays(rows, j)
    systematic_errors = [
        _SYSTEMATIC_SHARE * abs(lags_without_memory[j].value - lags_with_memory[j].value)
        for j in joints
    ]
    common_lag = estimate_common_delay(list(lags_with_memory.values()), systematic_errors)
    memoryless_lag = estimate_common_delay(list(lags_without_memory.values()), systematic_errors)
    if _is_common_lag(common_lag, memoryless_lag):
        return dict.fromkeys(joints, common_lag)
    reported_lags = {}
    for j in joints:
        lag = _enclose_lag(lags_with_memory[j], lags_without_memory[j])
        lowest = _MIN_REPORTED_LAG + _INTERVAL_ERRORS * lag.error
        # Close to the end of the search range a lag may be any longer one.
        if lowest < lag.value < _MAX_DELAY - 2.0 * _SEARCH_STEP:
            reported_lags[j] = lag
    return reported_lags


def _is_common_lag(with_memory: Estimate, without_memory: Estimate) -> bool:
    """Return whether all joints surely lag, or lead even by the later one of both estimates."""
    if with_memory.value > 0.0:
        return _is_reportable(with_memory)
    latest_lag = max(with_memory, without_memory, key=lambda lag: lag.value)
    return latest_lag.value < 0.0 and _is_reportable(latest_lag)


def _enclose_lag(with_memory: Estimate, without_memory: Estimate) -> Estimate:
    """Return the middle of two lags, with an error that encloses both and their errors."""
    middle = 0.5 * (with_memory.value + without_memory.value)
    half_difference = 0.5 * abs(with_memory.value - without_memory.value)
    error = half_difference / _INTERVAL_ERRORS + max(with_memory.error, without_memory.error)
    return Estimate(value=middle, error=error)


def _is_reportable(lag: Estimate) -> bool:
    """Return whether a lag is surely not 0, and known well or large."""
    half_interval = _INTERVAL_ERRORS * lag.error
    if half_interval < _NARROW_HALF_INTERVAL:
        return abs(lag.value) > half_interval
    return abs(lag.value) > half_interval + _MIN_REPORTED_LAG


def estimate_common_delay(lags: Sequence[Estimate], systematic_errors: Sequence[float]) -> Estimate:
    """Return the weighted median of lags with `systematic_errors` [s] in addition to their own.

    Its standard error includes their spread; it is infinite for fewer than three lags, whose spread
    is unknown.
    """
    finite_lags = []
    for lag, systematic_error in zip(lags, systematic_errors, strict=True):
        if np.isfinite(lag.error):
            finite_lags.append((lag.value, np.hypot(lag.error, systematic_error)))
    if len(finite_lags) < 3:
        return Estimate(value=0.0, error=np.inf)
    values, errors = np.array(finite_lags).T
    order = np.argsort(values)
    values = values[order]
    weights = errors[order] ** -2.0 / np.sum(errors**-2.0)
    median = float(np.interp(0.5, np.cumsum(weights) - 0.5 * weights, values))
    spread = weights @ (values - median) ** 2 / (len(finite_lags) - 1)
    return Estimate(value=median, error=float(np.sqrt(spread + 1.0 / np.sum(errors**-2.0))))


def estimate_delays(rows: LagRows, j: int) -> tuple[Estimate, Estimate]:
    """Return the lag of a torque [s] with memory of friction, and with friction of velocity only.

    The error is infinite at an end of the search range.
    """
    projected = _project_lag_rows(rows, j)
    if projected is None:
        return (Estimate(value=0.0, error=np.inf),) * 2
    shapes, torques, unknown_count = projected
    memoryless_shapes = shapes[:, -_MEMORYLESS_COLUMN_COUNT:]
    return _fit_delay(shapes, torques, unknown_count), _fit_delay(
        memoryless_shapes, torques, unknown_count
    )


def _project_lag_rows(rows: LagRows, j: int) -> tuple[Array, Array, int] | None:
    """Return friction (N, K) and torques (N, S) without what a free body explains of either.

    The third item is the number of unknowns of the body; None if there are too few rows.
    """
    shape_count = rows.friction_shapes[j].shape[1] - _FREE_COLUMN_COUNT
    is_known = rows.is_known[:, j]
    shapes, other_columns = np.split(rows.friction_shapes[j][is_known], [shape_count], axis=1)
    other_columns = np.hstack([(rows.static + rows.inertial)[is_known, j], other_columns])
    if len(other_columns) <= other_columns.shape[1] + shape_count:
        return None
    projected = _project_out(other_columns, np.hstack([shapes, rows.torques[is_known, :, j]]))
    shapes, torques = np.split(projected, [shape_count], axis=1)
    return shapes, torques, other_columns.shape[1]


def _compute_residuals(shapes: Array, torques: Array) -> Array:
    """Return torques (N, S) without friction (N, K) of non-negative weights."""
    from scipy.optimize import nnls

    # Friction of negative weight would imitate a lag.
    basis, triangle = np.linalg.qr(shapes)
    fits = np.array([nnls(triangle, column, maxiter=1000)[0] for column in (basis.T @ torques).T]).T
    return np.asarray(torques - shapes @ fits)


def _fit_delay(shapes: Array, torques: Array, fitted_count: int) -> Estimate:
    """Return the lag that best fits friction (N, K) to torques (N, S).

    Other unknowns, `fitted_count` of them, were eliminated before.
    """
    residuals = _compute_residuals(shapes, torques)
    squares = np.sum(residuals**2, axis=0)
    k = int(np.argmin(squares))
    if k in (0, len(squares) - 1):
        return Estimate(value=float(_SHIFTS[k]), error=np.inf)
    degrees_of_freedom = max(len(residuals) - fitted_count - shapes.shape[1], 1)
    independent_rows = degrees_of_freedom / correlation_length(residuals[:, k])
    before, at, after = 0.5 * independent_rows * np.log(np.maximum(squares[k - 1 : k + 2], 1e-300))
    curvature = max(before - 2.0 * at + after, 1e-12)
    vertex = _SHIFTS[k] + 0.5 * _SEARCH_STEP * (before - after) / curvature
    return Estimate(value=float(vertex), error=float(_SEARCH_STEP / np.sqrt(curvature)))


def estimate_stamp_rate(rows: LagRows, joints: Sequence[int]) -> tuple[float, float]:
    """Return the ratio of a motion's duration to that of its stamps, and its certainty.

    With stamps r times too short, inertial torques are 1 / r^2 times as large. The result is (1, 0)
    at an end of the search range, and if no rate explains the torques of most joints.
    """
    joint_tables = []
    column_count = rows.static.shape[2]
    for j in joints:
        joint_torque = rows.torques[:, _ZERO_SHIFT, [j]]
        residuals = _project_out(
            rows.friction_shapes[j],
            np.hstack([joint_torque, rows.static[:, j], rows.inertial[:, j]]),
        )
        body_columns = residuals[:, 1 : 1 + column_count] + residuals[:, 1 + column_count :]
        joint_tables.append(
            residuals / max(float(np.std(_project_out(body_columns, residuals[:, :1]))), 1e-300)
        )
    table = np.concatenate(joint_tables)
    # The triangular factor suffices.
    triangle = np.asarray(np.linalg.qr(table, mode="r"))
    residuals = np.stack(
        [
            table[:, 0] - _combine_regressors(table, scale) @ _fit_body(triangle, scale)
            for scale in _INERTIA_SCALES
        ],
        axis=1,
    )
    best_scale = int(np.argmin(np.sum(residuals**2, axis=0)))
    if best_scale in (0, len(_INERTIA_SCALES) - 1):
        return 1.0, 0.0
    residuals_by_joint = residuals.reshape(len(joints), -1, len(_INERTIA_SCALES))
    squares = np.sum(residuals_by_joint**2, axis=1)
    independent_rows = np.array(
        [
            len(joint_residuals) / correlation_length(joint_residuals[:, best_scale])
            for joint_residuals in residuals_by_joint
        ]
    )
    unit_scale = int(np.argmin(np.abs(np.log(_INERTIA_SCALES))))
    if np.median(squares[:, best_scale] / squares[:, unit_scale]) > _MAX_REMAINING_SQUARES:
        return 1.0, 0.0
    certainty = independent_rows @ np.log(squares[:, unit_scale] / squares[:, best_scale])
    return float(1.0 / np.sqrt(_INERTIA_SCALES[best_scale])), float(certainty)


def _combine_regressors(table: Array, scale: float) -> Array:
    """Return regressors (N, P) from a table of torque, static and inertial regressor."""
    static_regressor, inertial_regressor = np.split(table[:, 1:], 2, axis=1)
    return np.asarray(static_regressor + scale * inertial_regressor)


def _fit_body(table: Array, scale: float) -> Array:
    columns = _combine_regressors(table, scale)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-150)
    return np.asarray(np.linalg.lstsq(columns / size, table[:, 0], rcond=1e-6)[0] / size)


def _project_out(columns: Array, targets: Array) -> Array:
    """Project `targets` (N, K) onto the orthogonal complement of `columns` (N, P)."""
    # Columns of round-off, alone or beside others that explain them, have no direction of their
    # own: noise would be projected out with them.
    sizes = np.linalg.norm(columns, axis=0)
    nonzero_columns = columns[:, sizes > 1e-9 * sizes.max(initial=0.0)]
    basis, singular_values, _ = np.linalg.svd(
        nonzero_columns / np.linalg.norm(nonzero_columns, axis=0), full_matrices=False
    )
    basis = basis[:, singular_values > 1e-6 * singular_values.max(initial=0.0)]
    return np.asarray(targets - basis @ (basis.T @ targets))
