"""Time stamps and positions: gaps, lost rows, jumps, limits, duplicate columns."""

from collections.abc import Iterator

import numpy as np

from hesr_model.findings import Finding, build_joint_finding
from hesr_model.health.evidence import ModelTorques, SmoothPart
from hesr_model.logs.guess import is_of_motor
from hesr_model.logs.log_format import column_names
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Integers
from hesr_model.units import COMMON_UNITS

_PLAUSIBLE_PERIODS = 5e-5, 0.9  # plausible sample periods [s]; 1 s may be 1 ms
_TURN = 2.0 * np.pi
_MIN_SPIKE_TO_USUAL = 40.0  # relative distance of a spike
_MIN_SPIKE = 0.02  # [rad or m]
MAX_EXCESS = 0.05  # allowed excess over a limit [rad or m]
_COARSE_STEP = 8e-4
_MIN_STEPS = 20  # reported step [rad or m], steps needed
_MAX_SLIDING_TRAVEL = 100.0
_MAX_SLIDING_SPEED = 20.0  # [m], [m/s] of a sliding joint in other units
_MAX_SATURATED_SHARE = 0.01  # share of rows at a limit of the drive
_FINE_LEVELS = 200  # distinct values of a finely quantised torque
_MIN_SATURATED_RUN = 5


def check_time(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check the time stamps of a log."""
    period = log.period
    steps = np.diff(log.t)
    shortest, longest = _PLAUSIBLE_PERIODS
    if not shortest <= period <= longest:
        declared_factor = float(description.log.units.factors("t", 1)[0])
        plausible_units = [
            unit
            for unit, factor in COMMON_UNITS["t"].items()
            if shortest <= period / declared_factor * factor <= longest
        ]
        # Of several possible units, prefer the one with a rate closest to 200 Hz.
        plausible_units.sort(
            key=lambda unit: abs(np.log(period / declared_factor * COMMON_UNITS["t"][unit] * 200.0))
        )
        observation = f"its rows are {period:.3g} s apart"
        unit_remedy = "the unit of time is wrong; see [log.units] t"
        if plausible_units:
            unit_remedy = (
                f"time is in {plausible_units[0]}; set [log.units] t = '{plausible_units[0]}'"
            )
        changes = {"log.units.t": plausible_units[0]} if plausible_units else {}
        yield build_joint_finding("time-unit", "", observation, unit_remedy, changes=changes)
        return
    if len(log.gaps):
        yield report_gaps(len(log.gaps), float(np.max(steps)), len(log.parts()))
    if loses_rows(log):
        share = compute_share_of_long_steps(log)
        observation = (
            f"{100 * share:.0f} % of its steps are longer than 1.8 periods of {period:.4g} s"
        )
        remedy = "rows are missing, which blurs reversals"
        yield build_joint_finding("missing-rows", "", observation, remedy, "warning")
    if log.dropped:
        observation = f"{log.dropped} rows lack a number or repeat the time stamp of the row before"
        remedy = "they were left out ([log] missing = 'drop')"
        yield build_joint_finding("dropped-rows", "", observation, remedy, "warning")


def report_gaps(count: int, longest: float, parts: int) -> Finding:
    """Return the finding of gaps up to `longest` [s] between usable parts."""
    observation = f"{count} gap{'s' * (count > 1)}, the longest of {longest:.3g} s"
    remedy = "rows are missing; " + (
        f"its {parts} parts are filtered and fitted separately"
        if parts > 1
        else "only one of its parts is long enough to use"
    )
    return build_joint_finding("gaps", "", observation, remedy, "warning")


def check_jumps(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check raw positions for lost turns and single outliers."""
    is_near = np.diff(log.t) <= 3.0 * log.period
    for j, joint in enumerate(description.joints):
        steps = np.where(is_near, np.diff(log.q[:, j]), 0.0)
        turn_rows = np.flatnonzero(np.abs(np.abs(steps) - _TURN) < 0.1 * _TURN)
        usual_step = np.median(np.abs(steps[steps != 0.0])) if np.any(steps) else 0.0
        if len(turn_rows) and usual_step < 0.05 * _TURN:
            observation = (
                f"its position jumps by a full turn at t = {log.t[turn_rows[0] + 1]:.4g} s"
            )
            remedy = "the log wraps angles; unwrap them first (numpy.unwrap)"
            yield build_joint_finding("wrap", joint, observation, remedy)
            continue
        step_changes = np.abs(steps[1:] - steps[:-1])
        threshold = (
            max(_MIN_SPIKE_TO_USUAL * float(np.quantile(step_changes, 0.99)), _MIN_SPIKE)
            if len(step_changes)
            else 0.0
        )
        if len(step_changes) and float(step_changes.max()) > threshold:
            k = int(np.argmax(step_changes)) + 1
            observation = (
                f"its position is {float(step_changes.max()):.3g} off at t = {log.t[k]:.4g} s"
            )
            yield build_joint_finding(
                "spikes", joint, observation, "a row is wrong, or rows were lost; leave it out"
            )


def check_steps(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check that positions are finely quantised."""
    for j, joint in enumerate(description.joints):
        values = np.unique(log.q[:, j])
        if len(values) < _MIN_STEPS or np.ptp(values) < _MIN_STEPS * _COARSE_STEP:
            continue
        if np.array_equal(values, np.rint(values)):
            observation = "its positions are whole numbers, as counts of an encoder are"
            remedy = "give the size of a count in rad or m as [log.units] q, or log more digits"
            yield build_joint_finding("coarse", joint, observation, remedy)
            continue
        step = float(np.median(np.diff(values)))
        # Distances of values are random with a fine encoder, equal with a coarse one.
        alike_share = np.mean(np.abs(np.diff(values) / step - 1.0) < 0.01)
        if step > _COARSE_STEP and alike_share > 0.5:
            observation = f"its position comes in steps of {step:.2g}"
            remedy = (
                "it was rounded, or the encoder is coarse; log more digits to get sharper "
                "velocities"
            )
            yield build_joint_finding("coarse", joint, observation, remedy, "warning")


def check_limits(part: SmoothPart, robot: Robot) -> Iterator[Finding]:
    """Check positions against the model's limits."""
    description = robot.description
    lower, upper, _ = robot.limits
    lowest = part.q.min(axis=0)
    highest = part.q.max(axis=0)
    excess = np.maximum(lower - lowest, highest - upper)
    width = upper - lower
    is_rotary = ~np.array(robot.slides)
    radians_per_degree = np.pi / 180.0
    looks_like_degrees = bool(np.any(is_rotary & (excess > 3.0 * width))) and bool(
        np.all(
            np.maximum(lower - lowest * radians_per_degree, highest * radians_per_degree - upper)[
                is_rotary
            ]
            < MAX_EXCESS + 0.1
        )
    )
    columns = column_names(description.log.columns.q, description.joints)
    for j, joint in enumerate(description.joints):
        if excess[j] <= MAX_EXCESS:
            continue
        is_motor_column = (
            excess[j] > width[j] and description.logged is None and is_of_motor(columns[j])
        )
        suggests_degrees = looks_like_degrees and is_rotary[j] and not is_motor_column
        is_impossible = excess[j] > width[j]
        extreme = highest[j] if highest[j] - upper[j] > lower[j] - lowest[j] else lowest[j]
        limit = upper[j] if highest[j] - upper[j] > lower[j] - lowest[j] else lower[j]
        declared_units = description.log.units.expand_per_joint("q", robot.n)
        corrected_units = tuple(
            "deg" if rotary else name
            for name, rotary in zip(declared_units, is_rotary, strict=True)
        )
        unit: str | tuple[object, ...] = (
            "deg" if len(set(corrected_units)) == 1 else corrected_units
        )
        yield Finding(
            check="limits",
            severity="error" if is_impossible else "warning",
            joints=(joint,),
            found=f"its position reaches {extreme:.4g}, the model's limit is {limit:.4g}",
            remedy=f"columns such as '{columns[0]}' are named like motors'; give the turns of each "
            "motor per turn of each joint as 'matrix' in [transmission], with logs = 'motor'"
            if is_motor_column
            else "q is in degrees; set [log.units] q = 'deg'"
            if suggests_degrees
            else "its unit, its zero or its column is wrong, or the model's limits are"
            if is_impossible
            else "the log's zero differs from the model's, or the model's limits are narrow",
            changes={"log.units.q": unit} if suggests_degrees else {},
        )


def check_sliding(part: SmoothPart, robot: Robot) -> Iterator[Finding]:
    """Check that no sliding joint moves as only millimetres can."""
    units = robot.description.log.units
    travel = np.ptp(part.q, axis=0)
    speed = np.max(np.abs(part.v), axis=0)
    for j in np.flatnonzero(
        np.array(robot.slides) & ((travel > _MAX_SLIDING_TRAVEL) | (speed > _MAX_SLIDING_SPEED))
    ):
        is_only_unit = all(robot.slides) and units.expand_per_joint("q", robot.n)[j] in ("m", "rad")
        changes = {"log.units.q": "mm"} if is_only_unit else {}
        if changes and part.dq is not None:
            changes["log.units.dq"] = "mm/s"
        observation = f"it slides by {travel[j]:.3g} m at up to {speed[j]:.3g} m/s"
        remedy = "q is in mm; set [log.units] q = 'mm'" if is_only_unit else "see the units of q"
        yield build_joint_finding(
            "sliding-unit", robot.joints[j], observation, remedy, changes=changes
        )


def check_columns(part: SmoothPart, description: RobotDescription) -> Iterator[Finding]:
    """Check that no column is a copy, constant, or clipped."""
    joints = [int(j) for j in np.flatnonzero(part.is_moving)]
    for quantity, values in (("position", part.q), ("velocity", part.dq), ("torque", part.tau)):
        if values is None:
            continue
        for j in joints:
            for other_j in range(j):
                if np.std(values[:, j]) > 0 and np.array_equal(values[:, j], values[:, other_j]):
                    other_joint = description.joints[other_j]
                    observation = (
                        f"its {quantity} equals that of joint '{other_joint}' in every row"
                    )
                    remedy = "one column is used for both; see [log.columns]"
                    yield build_joint_finding(
                        "same-column", description.joints[j], observation, remedy
                    )
    for j in joints:
        tau = part.log.tau[:, j]
        if np.ptp(tau) == 0.0:
            observation = f"it moves while its torque stays at {tau[0]:.4g}"
            remedy = "its torque is not logged, or another column is"
            yield build_joint_finding("torque-constant", description.joints[j], observation, remedy)
        elif (share := _compute_share_at_limit(tau)) > _MAX_SATURATED_SHARE:
            largest = f"{np.max(np.abs(tau)):.4g}"
            observation = f"{100 * share:.1f} % of its rows are at the largest torque, {largest}"
            remedy = "the drive or the log clips the torque; friction beyond is not learned"
            yield build_joint_finding(
                "saturation", description.joints[j], observation, remedy, "warning"
            )


def _compute_share_at_limit(tau: Array) -> float:
    is_at_limit = np.abs(tau) >= np.max(np.abs(tau))
    run_lengths = np.convolve(is_at_limit, np.ones(_MIN_SATURATED_RUN), mode="same")
    is_fine = len(np.unique(tau)) > _FINE_LEVELS
    return (
        float(np.mean(is_at_limit))
        if is_fine and run_lengths.max(initial=0.0) >= _MIN_SATURATED_RUN
        else 0.0
    )


_MAX_SKIPPED_SHARE = 0.05  # allowed share of steps longer than 1.8 periods
_GRID_TOLERANCE = 0.2  # periods
_MIN_IRREGULAR_SHARE = 0.2  # share of steps off the grid, above which stamps are irregular
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
    return (
        float(np.mean(np.abs(periods - np.rint(periods)) > _GRID_TOLERANCE)) < _MIN_IRREGULAR_SHARE
    )


def check_loss(part: SmoothPart, torques: ModelTorques, robot: Robot) -> Iterator[Finding]:
    """Check that the remaining rows determine each joint's sliding torque.

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
        unit = "m/s" if robot.slides[j] else "rad/s"
        observation = (
            f"many rows are missing; its sliding torque at {speeds[worst]:.2g} {unit} is uncertain "
            f"by {100 * min(relative_uncertainty[worst], 9.99):.2g} %"
        )
        remedy = (
            f"friction needs {100 * _MAX_UNCERTAINTY:g} %; record without losses, or for longer"
        )
        yield build_joint_finding("missing-rows", robot.joints[j], observation, remedy)


def _estimate_sliding_torque(
    part: SmoothPart, torques: ModelTorques, j: int
) -> tuple[Array, Array, Array]:
    """Return speeds (K,), sliding torques and their deviation."""
    v = part.v[:, j]
    tau = part.tau[:, j]
    speeds = float(np.max(np.abs(v))) * _SPEED_SHARES
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
