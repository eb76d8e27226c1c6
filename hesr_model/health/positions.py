"""Time stamps and positions: gaps, lost rows, jumps, limits, duplicate columns."""

from collections.abc import Iterator

import numpy as np

from hesr_model.findings import Severity
from hesr_model.health.evidence import (
    ModelTorques,
    SmoothPart,
    compute_speed_noise,
    smooth_parts,
)
from hesr_model.health.referee import Estimate, Hypothesis, Statistic
from hesr_model.logs.column_names import is_of_motor
from hesr_model.logs.log_format import column_names
from hesr_model.logs.rest import MOVING_SHARE, find_travelling
from hesr_model.logs.robot_log import SHORTEST_PART, Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Integers
from hesr_model.support.text import count_noun
from hesr_model.units import COMMON_UNITS, unit_of_joint

_PLAUSIBLE_PERIODS = 5e-5, 0.9  # plausible sample periods [s]; 1 s may be 1 ms
_TURN = 2.0 * np.pi
_MIN_SPIKE_TO_USUAL = 40.0  # distance of a spike over the usual change from step to step
_MIN_SPIKE_SHARE = 0.01  # of the range of the other rows
MAX_EXCESS_SHARE = 0.02  # allowed excess over a limit, as a share of the width of the limits
_MIN_STEPS = 20  # of different size or place that tell a resolution
_SINGLE_STEP_QUANTILE = 0.05  # of distances between positions in steps, which is a single step
_MIN_COARSE_NOISE = 0.1  # noise over the step of a rounded position, which is 0.29 in theory
_MAX_SPEED_NOISE = 0.01  # noise of a velocity that rounding leaves, over the peak of the velocity
_RIPPLE_QUANTILE = 0.8  # of the size of third differences
_RIPPLE_ERRORS = 1.2816  # its size in standard deviations, of normal noise
_MAX_SLIDING_TRAVEL = 100.0  # [m] of a joint whose limits and speed do not tell its unit
_MAX_LIMIT_WIDTHS = 10.0  # of travel of a sliding joint; that in mm is 1000 times too long
# Travel over which gravity would accelerate to the peak speed, over the joint's own travel. Drives
# of sliding joints reach 1 or 2; in mm it is 1000 times as large.
_MAX_FALL_TO_TRAVEL = 5.0
_EARTH_GRAVITY = 9.81
_MAX_SATURATED_SHARE = 0.01  # share of rows at a limit of the drive
_FINE_LEVELS = 200  # distinct values of a finely quantised torque
_MIN_SATURATED_RUN = 5


def is_plausible_period(period: float) -> bool:
    """Return whether drives and loggers write rows `period` [s] apart."""
    shortest, longest = _PLAUSIBLE_PERIODS
    return shortest <= period <= longest


def check_time(log: Log, description: RobotDescription) -> Iterator[Hypothesis]:
    """Doubt the time stamps of a log."""
    period = log.period
    steps = np.diff(log.t)
    if not is_plausible_period(period):
        yield _doubt_unit_of_time(period, description)
        return
    if len(log.gaps):
        parts = log.parts()
        short_rows = len(log.t) - sum(len(part.t) for part in parts)
        yield report_gaps(len(log.gaps), float(np.max(steps)), len(parts), short_rows)
    if loses_rows(log):
        share = compute_share_of_long_steps(log)
        yield Hypothesis(
            check="missing-rows",
            joint="",
            observation=f"{100 * share:.0f} % of its steps are longer than 1.8 periods of "
            f"{period:.4g} s",
            remedy="rows are missing, which blurs reversals",
            severity="warning",
        )
    if log.dropped:
        yield Hypothesis(
            check="dropped-rows",
            joint="",
            observation=", ".join(f"{count} rows {cause}" for cause, count in log.left_out.items()),
            remedy="they were left out, as the robot file says",
            severity="warning",
        )


def _doubt_unit_of_time(period: float, description: RobotDescription) -> Hypothesis:
    declared_factor = float(description.log.units.factors("t", 1)[0])
    plausible_units = [
        unit
        for unit, factor in COMMON_UNITS["t"].items()
        if is_plausible_period(period / declared_factor * factor)
    ]

    def measure_distance(unit: str) -> float:
        return abs(float(np.log(period / declared_factor * COMMON_UNITS["t"][unit] * 200.0)))

    # Of several possible units, prefer the one with a rate closest to 200 Hz.
    plausible_units.sort(key=measure_distance)
    remedy = "the unit of time is wrong; see [log.units] t"
    changes: dict[str, object] = {}
    if plausible_units:
        remedy = f"time is in {plausible_units[0]}"
        changes = {"log.units.t": plausible_units[0]}
    return Hypothesis(
        check="time-unit",
        joint="",
        observation=f"its rows are {period:.3g} s apart",
        remedy=remedy,
        changes=changes,
    )


def report_gaps(count: int, longest: float, parts: int, short_rows: int) -> Hypothesis:
    """Return the observation of gaps up to `longest` [s] between usable parts.

    `short_rows` is the number of rows of the other parts, which are left out.
    """
    observation = f"{count_noun(count, 'gap')}, the longest of {longest:.3g} s"
    if short_rows:
        observation += f", {short_rows} rows in parts shorter than {SHORTEST_PART:g} s are left out"
    consequence = "only one of its parts is long enough to use"
    if parts > 1:
        consequence = f"its {parts} parts are filtered and fitted separately"
    return Hypothesis(
        check="gaps",
        joint="",
        observation=observation,
        remedy=f"rows are missing; {consequence}",
        severity="warning",
    )


def check_jumps(log: Log, description: RobotDescription) -> Iterator[Hypothesis]:
    """Doubt raw positions with lost turns and single outliers."""
    is_near = np.diff(log.t) <= 3.0 * log.period
    is_travelling = find_travelling([log.q])
    # The counts of a resting encoder are no spikes, as they are tiny next to the travel of others.
    travel = np.ptp(log.q, axis=0)
    largest_travel = np.max(travel[is_travelling], initial=0.0)
    is_judged = is_travelling | ((travel > _MIN_SPIKE_SHARE * largest_travel) & is_travelling.any())
    for j, joint in enumerate(description.joints):
        steps = np.where(is_near, np.diff(log.q[:, j]), 0.0)
        turn_rows = np.flatnonzero(np.abs(np.abs(steps) - _TURN) < 0.1 * _TURN)
        usual_step = 0.0
        if np.any(steps):
            usual_step = float(np.median(np.abs(steps[steps != 0.0])))
        if len(turn_rows) and usual_step < 0.05 * _TURN:
            yield Hypothesis(
                check="wrap",
                joint=joint,
                observation="its position jumps by a full turn at t = "
                f"{log.t[turn_rows[0] + 1]:.4g} s",
                remedy="the log wraps angles; unwrap them first (numpy.unwrap)",
            )
        elif len(steps) > 2 and is_judged[j]:
            yield from _doubt_single_row(log, j, joint, steps)


def _doubt_single_row(log: Log, j: int, joint: str, steps: Array) -> Iterator[Hypothesis]:
    """Doubt the row after the step that least fits between its neighbours.

    A step within the range of the steps before and after it is a change of speed, however sudden;
    one beyond both is a jump.
    """
    padded_steps = np.concatenate([steps[1:2], steps, steps[-2:-1]])
    lower = np.minimum(padded_steps[:-2], padded_steps[2:])
    upper = np.maximum(padded_steps[:-2], padded_steps[2:])
    excess = np.maximum(np.maximum(lower - steps, steps - upper), 0.0)
    lowest, highest = np.quantile(log.q[:, j], [0.01, 0.99])
    threshold = max(
        _MIN_SPIKE_TO_USUAL * float(np.quantile(np.abs(np.diff(steps)), 0.99)),
        _MIN_SPIKE_SHARE * float(highest - lowest),
    )
    largest = float(excess.max())
    if largest > threshold:
        row = int(np.argmax(excess)) + 1
        yield Hypothesis(
            check="spikes",
            joint=joint,
            observation=f"its position is {largest:.3g} off at t = {log.t[row]:.4g} s",
            remedy="a row is wrong, or rows were lost; leave it out",
        )


def check_steps(log: Log, description: RobotDescription) -> Iterator[Hypothesis]:
    """Doubt that positions are finely quantised."""
    for j, joint in enumerate(description.joints):
        values = np.unique(log.q[:, j])
        if len(values) < _MIN_STEPS:
            continue
        if np.array_equal(values, np.rint(values)):
            yield Hypothesis(
                check="coarse",
                joint=joint,
                observation="its positions are whole numbers, as counts of an encoder are",
                remedy="give the size of a count in rad or m as 'q' of [log.units], or log more "
                "digits",
            )
            continue
        # All distances are whole steps, of which some are single.
        step = float(np.quantile(np.diff(values), _SINGLE_STEP_QUANTILE))
        # Distances of values are random with a fine encoder, equal with a coarse one.
        alike_share = np.mean(np.abs(np.diff(values) / step - 1.0) < 0.01)
        if not alike_share > 0.5 or len(values) == len(log.q):
            continue
        yield _doubt_resolution(log, j, joint, step, description.log.filter_cutoff)


def _doubt_resolution(log: Log, j: int, joint: str, step: float, cutoff: float) -> Hypothesis:
    """Doubt that a position in equal steps is fine enough for a low pass [Hz].

    At a constant speed the positions of any encoder have equal distances. Only rounding leaves an
    error of nearly a third of a step, which looks like noise.
    """
    measured_noise, speed_noise = compute_speed_noise(log, j, step / np.sqrt(12.0), cutoff)
    # Single steps of a rounded position are faster than it moves, means over some rows are not.
    window = min(max(1, round(1.0 / (cutoff * log.period))), len(log.t) - 1)
    speeds = (log.q[window:, j] - log.q[:-window, j]) / (log.t[window:] - log.t[:-window])
    peak = max(float(np.max(np.abs(speeds))), 1e-300)
    # Slow motion leaves rows without a change instead of noise.
    moving_steps = np.diff(log.q[: len(speeds) + 1, j])[np.abs(speeds) > MOVING_SHARE * peak]
    repeated_share = 0.0
    if len(moving_steps):
        repeated_share = float(np.mean(moving_steps == 0.0))
    noise_or_repetition = max(measured_noise / step, repeated_share)
    trials = [
        Statistic(
            name="the noise of its position over a step, or its share of repeated rows",
            estimate=Estimate(value=noise_or_repetition, error=0.0),
            high=_MIN_COARSE_NOISE,
        ),
        Statistic(
            name="the noise of its velocity over its peak",
            estimate=Estimate(value=speed_noise / peak, error=0.0),
            high=_MAX_SPEED_NOISE,
        ),
    ]
    if all(trial.outcome == "won" for trial in trials):
        # White noise would pass the low pass, but steps of a ramp may repeat too fast for it. The
        # log is smoothed again, which is slow, so that this trial is the last one.
        ripple = _measure_ripple(log, j, cutoff)
        trials.append(
            Statistic(
                name="the ripple of its velocity over its peak",
                estimate=Estimate(value=ripple / peak, error=0.0),
                high=_MAX_SPEED_NOISE,
            )
        )
    return Hypothesis(
        check="coarse",
        joint=joint,
        observation=f"its position comes in steps of {step:.2g}",
        remedy="it was rounded, or the encoder is coarse; log more digits to get sharper "
        "velocities",
        severity="warning",
        trials=tuple(trials),
    )


def _measure_ripple(log: Log, j: int, cutoff: float) -> float:
    """Return the ripple of a low-passed velocity [rad/s, m/s], as the deviation of white noise.

    Third differences over half a period of the cut-off [Hz] hold little of a slow motion, and
    their quantile little of its reversals.
    """
    ripples = []
    for part in smooth_parts(log, cutoff):
        distance = max(1, round(0.5 / (cutoff * part.period)))
        v = part.v[part.is_measured, j]
        first, second, third, last = (
            v[k * distance : len(v) - (3 - k) * distance] for k in range(4)
        )
        ripples.append(np.abs(last - 3.0 * third + 3.0 * second - first))
    ripple = np.concatenate([np.zeros(0), *ripples])
    if not len(ripple):
        return np.inf
    usual_ripple = float(np.quantile(ripple, _RIPPLE_QUANTILE))
    return usual_ripple / (_RIPPLE_ERRORS * float(np.sqrt(20.0)))


def check_limits(part: SmoothPart, robot: Robot) -> Iterator[Hypothesis]:
    """Doubt positions beyond the model's limits."""
    description = robot.description
    lower, upper, _ = robot.limits
    lowest = part.q.min(axis=0)
    highest = part.q.max(axis=0)
    excess = np.maximum(lower - lowest, highest - upper)
    width = upper - lower
    is_rotary = ~np.array(robot.slides)
    in_degrees = _looks_like_degrees(lowest, highest, robot)
    columns = column_names(description.log.columns.q, description.joints)
    for j, joint in enumerate(description.joints):
        if not excess[j] > MAX_EXCESS_SHARE * width[j]:
            continue
        is_impossible = bool(excess[j] > width[j])
        severity: Severity = "warning"
        if is_impossible:
            severity = "error"
        extreme = lowest[j]
        limit = lower[j]
        if highest[j] - upper[j] > lower[j] - lowest[j]:
            extreme = highest[j]
            limit = upper[j]
        changes: dict[str, object] = {}
        if is_impossible and description.logged is None and is_of_motor(columns[j]):
            remedy = (
                f"columns such as '{columns[0]}' are named like motors; give the turns of each "
                "motor per turn of each joint as 'matrix' in [transmission], with logs = 'motor'"
            )
        elif in_degrees and is_rotary[j]:
            remedy = "q is in degrees"
            changes = {"log.units.q": _correct_degrees(description, is_rotary)}
        elif is_impossible:
            remedy = "its unit, its zero or its column is wrong, or the model is of another robot"
        else:
            remedy = (
                "the log's zero differs from the model's, the model's limits are narrow, or the "
                "model is of another robot"
            )
        yield Hypothesis(
            check="limits",
            joint=joint,
            observation=f"its position reaches {extreme:.4g}, the model's limit is {limit:.4g}",
            remedy=remedy,
            severity=severity,
            changes=changes,
        )


def _looks_like_degrees(lowest: Array, highest: Array, robot: Robot) -> bool:
    """Return whether rotary joints leave their limits by far, and all keep them in degrees.

    Parameters
    ----------
    lowest, highest : extreme positions (n,) as logged.
    robot : with limits in rad and m.
    """
    lower, upper, _ = robot.limits
    width = upper - lower
    is_rotary = ~np.array(robot.slides)
    excess = np.maximum(lower - lowest, highest - upper)
    radians_per_degree = np.pi / 180.0
    excess_in_degrees = np.maximum(
        lower - lowest * radians_per_degree, highest * radians_per_degree - upper
    )
    is_far_beyond = is_rotary & (excess > 3.0 * width)
    is_within = excess_in_degrees < 2.0 * MAX_EXCESS_SHARE * width
    return bool(np.any(is_far_beyond) and np.all(is_within[is_rotary]))


def is_mirrored(q: Array, robot: Robot, j: int) -> bool:
    """Return whether positions (N,) [rad, m] keep the limits of a joint only with the other sign.

    They are those of the joint, not of a motor; their zero stays.
    """
    description = robot.description
    if description.logged is not None:
        return False
    zero = 0.0
    if description.log.zero is not None:
        zero = float(description.log.zero[j])
    lower = float(robot.limits[0][j])
    upper = float(robot.limits[1][j])
    allowed_excess = MAX_EXCESS_SHARE * (upper - lower)
    if not np.isfinite(allowed_excess):
        return False

    def exceeds_limits(positions: Array) -> bool:
        excess = max(lower - float(positions.min()), float(positions.max()) - upper)
        return excess > allowed_excess

    return exceeds_limits(q) and not exceeds_limits(2.0 * zero - q)


def _correct_degrees(description: RobotDescription, is_rotary: Array) -> str | tuple[object, ...]:
    """Return the units of positions with degrees of rotary joints: one name if all have it."""
    corrected_units = description.log.units.replace_units("q", is_rotary.tolist(), "deg")
    if len(set(corrected_units)) == 1:
        return "deg"
    return corrected_units


def check_sliding(part: SmoothPart, robot: Robot) -> Iterator[Hypothesis]:
    """Doubt sliding joints that move as only millimetres can.

    They travel by many widths of their limits, reach speeds that a fall of many times their travel
    would give, or travel further than any robot: only a length contradicts a unit of length.
    """
    units = robot.description.log.units
    lower, upper, _ = robot.limits
    travel = np.ptp(part.q, axis=0)
    speed = np.max(np.abs(part.v), axis=0)
    fall = speed**2 / (2.0 * _EARTH_GRAVITY)
    is_beyond = (
        (travel > _MAX_LIMIT_WIDTHS * (upper - lower))
        | (fall > _MAX_FALL_TO_TRAVEL * travel)
        | (travel > _MAX_SLIDING_TRAVEL)
    )
    for j in np.flatnonzero(np.array(robot.slides) & is_beyond):
        is_only_unit = all(robot.slides) and units.expand_per_joint("q", robot.n)[j] in ("m", "rad")
        remedy = "see the units of q"
        changes: dict[str, str] = {}
        if is_only_unit:
            remedy = "q is in mm"
            changes["log.units.q"] = "mm"
            if part.dq is not None:
                changes["log.units.dq"] = "mm/s"
        yield Hypothesis(
            check="sliding-unit",
            joint=robot.joints[j],
            observation=f"it slides by {travel[j]:.3g} m at up to {speed[j]:.3g} m/s",
            remedy=remedy,
            changes=changes,
        )


def check_columns(part: SmoothPart, description: RobotDescription) -> Iterator[Hypothesis]:
    """Doubt columns that are copies, constant, or clipped."""
    joints = [int(j) for j in np.flatnonzero(part.is_moving)]
    for quantity, values in (("position", part.q), ("velocity", part.dq), ("torque", part.tau)):
        if values is None:
            continue
        for j in joints:
            for other_j in range(j):
                if np.std(values[:, j]) > 0 and np.array_equal(values[:, j], values[:, other_j]):
                    yield Hypothesis(
                        check="same-column",
                        joint=description.joints[j],
                        observation=f"its {quantity} equals that of joint "
                        f"'{description.joints[other_j]}' in every row",
                        remedy="one column is used for both; see [log.columns]",
                    )
    for j in joints:
        tau = part.log.tau[:, j]
        if np.ptp(tau) == 0.0:
            yield Hypothesis(
                check="torque-constant",
                joint=description.joints[j],
                observation=f"it moves while its torque stays at {tau[0]:.4g}",
                remedy="its torque is not logged, or another column is",
            )
            continue
        share = _compute_share_at_limit(tau)
        if share > _MAX_SATURATED_SHARE:
            yield Hypothesis(
                check="saturation",
                joint=description.joints[j],
                observation=f"{100 * share:.1f} % of its rows are at the largest torque, "
                f"{np.max(np.abs(tau)):.4g}",
                remedy="the drive or the log clips the torque; friction beyond is not learned",
                severity="warning",
            )


def _compute_share_at_limit(tau: Array) -> float:
    is_at_limit = np.abs(tau) >= np.max(np.abs(tau))
    run_lengths = np.convolve(is_at_limit, np.ones(_MIN_SATURATED_RUN), mode="same")
    is_fine = len(np.unique(tau)) > _FINE_LEVELS
    if is_fine and run_lengths.max(initial=0.0) >= _MIN_SATURATED_RUN:
        return float(np.mean(is_at_limit))
    return 0.0


_MAX_SKIPPED_SHARE = 0.05  # allowed share of steps longer than 1.8 periods
_GRID_TOLERANCE = 0.2  # periods
# Share of steps off the grid, above which stamps are irregular; without a grid 0.6 are.
_MIN_IRREGULAR_SHARE = 0.3
_MAX_UNCERTAINTY = 0.03  # allowed relative uncertainty, two standard deviations
_SPEED_SHARES = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])  # shares of the peak speed
_JUDGED_SHARES = (0.1, 0.7)  # shares where the joint slides
_SPLIT_COUNT = 16
_REVERSAL_SHARE = 0.2  # reversal, as share of the slowest interval


def compute_share_of_long_steps(log: Log) -> float:
    """Return the share of steps above 1.8 median periods, without gaps."""
    steps = np.diff(log.t)
    return float(np.mean(steps[steps <= log.longest_step] > 1.8 * log.period))


def loses_rows(log: Log) -> bool:
    """Return whether rows are missing throughout a log, whose stamps else keep to a grid."""
    if compute_share_of_long_steps(log) <= _MAX_SKIPPED_SHARE:
        return False
    steps = np.diff(log.t)
    periods = steps / np.median(steps[steps <= 1.5 * np.quantile(steps, 0.1)])
    is_off_grid = np.abs(periods - np.rint(periods)) > _GRID_TOLERANCE
    return float(np.mean(is_off_grid)) < _MIN_IRREGULAR_SHARE


def check_loss(part: SmoothPart, torques: ModelTorques, robot: Robot) -> Iterator[Hypothesis]:
    """Doubt that the remaining rows determine each joint's sliding torque.

    The difference of estimates from random halves has four times the variance of the estimate from
    all rows.
    """
    if not loses_rows(part.log):
        return
    for j in np.flatnonzero(part.is_moving & (np.ptp(part.tau, axis=0) > 0.0)):
        speeds, sliding_torque, deviation = _estimate_sliding_torque(part, torques, int(j))
        relative_uncertainty = 2.0 * deviation / np.maximum(np.abs(sliding_torque), 1e-300)
        worst = int(np.argmax(relative_uncertainty))
        if relative_uncertainty[worst] <= _MAX_UNCERTAINTY:
            continue
        unit = unit_of_joint("rad/s", is_prismatic=robot.slides[j])
        yield Hypothesis(
            check="missing-rows",
            joint=robot.joints[j],
            observation=f"many rows are missing; its sliding torque at {speeds[worst]:.2g} {unit} "
            f"is uncertain by {100 * min(relative_uncertainty[worst], 9.99):.2g} %",
            remedy=f"friction needs {100 * _MAX_UNCERTAINTY:g} %; record without losses, or for "
            "longer",
        )


def _estimate_sliding_torque(
    part: SmoothPart, torques: ModelTorques, j: int
) -> tuple[Array, Array, Array]:
    """Return speeds (K,), sliding torques and their deviation."""
    v = part.v[:, j]
    tau = part.tau[:, j]
    speeds = float(np.max(np.abs(v))) * _SPEED_SHARES
    # Friction is linear between nodes of speed, so that its value at each node is a coefficient.
    hat_functions = np.stack(
        [np.interp(np.abs(v), speeds, node_values) for node_values in np.eye(len(speeds))],
        axis=1,
    )
    direction = np.tanh(v / (_REVERSAL_SHARE * speeds[1]))
    columns = np.column_stack(
        [
            direction[:, None] * hat_functions,
            torques.gravity[:, j],
            torques.inertial[:, j],
            np.ones_like(v),
        ]
    )

    def estimate(rows: Integers) -> Array:
        return np.asarray(np.linalg.lstsq(columns[rows], tau[rows], rcond=None)[0])

    rng = np.random.default_rng(0)
    half_count = len(v) // 2
    differences = []
    for _ in range(_SPLIT_COUNT):
        order = rng.permutation(len(v))
        differences.append(estimate(order[:half_count]) - estimate(order[half_count:]))
    steps = np.diff(part.log.t)
    steps = steps[steps <= part.log.longest_step]
    lost_share = 1.0 - float(np.quantile(steps, 0.1) / np.mean(steps))
    row_share = len(v) / len(part.log.t)
    deviation = np.std(differences, axis=0) * 0.5 * np.sqrt(lost_share * row_share)
    judged_speeds = np.flatnonzero(
        (_JUDGED_SHARES[0] <= _SPEED_SHARES) & (_JUDGED_SHARES[1] >= _SPEED_SHARES)
    )
    return (
        speeds[judged_speeds],
        estimate(np.arange(len(v)))[judged_speeds],
        deviation[judged_speeds],
    )
