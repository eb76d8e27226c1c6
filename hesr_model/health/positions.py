"""Time stamps and positions: gaps, lost rows, jumps, limits, duplicate columns."""

from collections.abc import Iterator

import numpy as np

from hesr_model.findings import Finding, build_joint_finding
from hesr_model.health.evidence import Motionwise, Torques
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
        declared = float(description.log.units.factors("t", 1)[0])
        units = [
            u for u, f in COMMON_UNITS["t"].items() if shortest <= period / declared * f <= longest
        ]
        # Of several possible units, prefer the one with a rate closest to 200 Hz.
        units.sort(key=lambda u: abs(np.log(period / declared * COMMON_UNITS["t"][u] * 200.0)))
        observation = f"its rows are {period:.3g} s apart"
        unit_remedy = "the unit of time is wrong; see [log.units] t"
        if units:
            unit_remedy = f"time is in {units[0]}; set [log.units] t = '{units[0]}'"
        changes = {"log.units.t": units[0]} if units else {}
        yield build_joint_finding("time-unit", "", observation, unit_remedy, changes=changes)
        return
    if len(log.gaps):
        yield report_gaps(len(log.gaps), float(np.max(steps)), len(log.parts()))
    if loses_rows(log):
        share = share_of_long_steps(log)
        loss = f"{100 * share:.0f} % of its steps are longer than 1.8 periods of {period:.4g} s"
        remedy = "rows are missing, which blurs reversals"
        yield build_joint_finding("missing-rows", "", loss, remedy, "warning")
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
        leaps = np.where(is_near, np.diff(log.q[:, j]), 0.0)
        full_turns = np.flatnonzero(np.abs(np.abs(leaps) - _TURN) < 0.1 * _TURN)
        usual_leap = np.median(np.abs(leaps[leaps != 0.0])) if np.any(leaps) else 0.0
        if len(full_turns) and usual_leap < 0.05 * _TURN:
            observation = (
                f"its position jumps by a full turn at t = {log.t[full_turns[0] + 1]:.4g} s"
            )
            remedy = "the log wraps angles; unwrap them first (numpy.unwrap)"
            yield build_joint_finding("wrap", joint, observation, remedy)
            continue
        bends = np.abs(leaps[1:] - leaps[:-1])
        level = (
            max(_MIN_SPIKE_TO_USUAL * float(np.quantile(bends, 0.99)), _MIN_SPIKE)
            if len(bends)
            else 0.0
        )
        if len(bends) and float(bends.max()) > level:
            k = int(np.argmax(bends)) + 1
            outlier = f"its position is {float(bends.max()):.3g} off at t = {log.t[k]:.4g} s"
            yield build_joint_finding(
                "spikes", joint, outlier, "a row is wrong, or rows were lost; leave it out"
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


def check_limits(motion: Motionwise, robot: Robot) -> Iterator[Finding]:
    """Check positions against the model's limits."""
    description = robot.description
    lower, upper, _ = robot.limits
    lowest = motion.q.min(axis=0)
    highest = motion.q.max(axis=0)
    excess = np.maximum(lower - lowest, highest - upper)
    width = upper - lower
    is_rotary = ~np.array(robot.slides)
    radians_per_degree = np.pi / 180.0
    in_degrees = bool(np.any(is_rotary & (excess > 3.0 * width))) and bool(
        np.all(
            np.maximum(lower - lowest * radians_per_degree, highest * radians_per_degree - upper)[
                is_rotary
            ]
            < MAX_EXCESS + 0.1
        )
    )
    names = column_names(description.log.columns.q, description.joints)
    for j, joint in enumerate(description.joints):
        if excess[j] <= MAX_EXCESS:
            continue
        of_motor = excess[j] > width[j] and description.logged is None and is_of_motor(names[j])
        suggests_degrees = in_degrees and is_rotary[j] and not of_motor
        is_impossible = excess[j] > width[j]
        extreme = highest[j] if highest[j] - upper[j] > lower[j] - lowest[j] else lowest[j]
        limit = upper[j] if highest[j] - upper[j] > lower[j] - lowest[j] else lower[j]
        declared = description.log.units.expand_per_joint("q", robot.n)
        degrees = tuple("deg" if t else u for u, t in zip(declared, is_rotary, strict=True))
        unit: str | tuple[object, ...] = "deg" if len(set(degrees)) == 1 else degrees
        yield Finding(
            check="limits",
            severity="error" if is_impossible else "warning",
            joints=(joint,),
            found=f"its position reaches {extreme:.4g}, the model's limit is {limit:.4g}",
            remedy=f"columns such as '{names[0]}' are named like motors'; give the turns of each "
            "motor per turn of each joint as 'matrix' in [transmission], with logs = 'motor'"
            if of_motor
            else "q is in degrees; set [log.units] q = 'deg'"
            if suggests_degrees
            else "its unit, its zero or its column is wrong, or the model's limits are"
            if is_impossible
            else "the log's zero differs from the model's, or the model's limits are narrow",
            changes={"log.units.q": unit} if suggests_degrees else {},
        )


def check_sliding(motion: Motionwise, robot: Robot) -> Iterator[Finding]:
    """Check that no sliding joint moves as only millimetres can."""
    units = robot.description.log.units
    travel = np.ptp(motion.q, axis=0)
    speed = np.max(np.abs(motion.v), axis=0)
    for j in np.flatnonzero(
        np.array(robot.slides) & ((travel > _MAX_SLIDING_TRAVEL) | (speed > _MAX_SLIDING_SPEED))
    ):
        alone = all(robot.slides) and units.expand_per_joint("q", robot.n)[j] in ("m", "rad")
        changes = {"log.units.q": "mm"} if alone else {}
        if changes and motion.dq is not None:
            changes["log.units.dq"] = "mm/s"
        observation = f"it slides by {travel[j]:.3g} m at up to {speed[j]:.3g} m/s"
        remedy = "q is in mm; set [log.units] q = 'mm'" if alone else "see the units of q"
        yield build_joint_finding(
            "sliding-unit", robot.joints[j], observation, remedy, changes=changes
        )


def check_columns(motion: Motionwise, description: RobotDescription) -> Iterator[Finding]:
    """Check that no column is a copy, constant, or clipped."""
    joints = [int(j) for j in np.flatnonzero(motion.moves)]
    for kind, values in (("position", motion.q), ("velocity", motion.dq), ("torque", motion.tau)):
        if values is None:
            continue
        for a in joints:
            for b in range(a):
                if np.std(values[:, a]) > 0 and np.array_equal(values[:, a], values[:, b]):
                    observation = (
                        f"its {kind} equals that of joint '{description.joints[b]}' in every row"
                    )
                    remedy = "one column is used for both; see [log.columns]"
                    yield build_joint_finding(
                        "same-column", description.joints[a], observation, remedy
                    )
    for j in joints:
        tau = motion.log.tau[:, j]
        if np.ptp(tau) == 0.0:
            observation = f"it moves while its torque stays at {tau[0]:.4g}"
            remedy = "its torque is not logged, or another column is"
            yield build_joint_finding("torque-constant", description.joints[j], observation, remedy)
        elif (share := _share_at_limit(tau)) > _MAX_SATURATED_SHARE:
            largest = f"{np.max(np.abs(tau)):.4g}"
            observation = f"{100 * share:.1f} % of its rows are at the largest torque, {largest}"
            remedy = "the drive or the log clips the torque; friction beyond is not learned"
            yield build_joint_finding(
                "saturation", description.joints[j], observation, remedy, "warning"
            )


def _share_at_limit(tau: Array) -> float:
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


def share_of_long_steps(log: Log) -> float:
    """Return the share of steps above 1.8 median periods, without gaps."""
    steps = np.diff(log.t)
    return float(np.mean(steps[steps <= log.longest_step] > 1.8 * log.period))


def loses_rows(log: Log) -> bool:
    """Return whether rows are missing throughout a log, whose stamps else keep to a grid."""
    if share_of_long_steps(log) <= _MAX_SKIPPED_SHARE:
        return False
    steps = np.diff(log.t)
    periods = steps / np.median(steps[steps <= 1.5 * np.quantile(steps, 0.1)])
    return (
        float(np.mean(np.abs(periods - np.rint(periods)) > _GRID_TOLERANCE)) < _MIN_IRREGULAR_SHARE
    )


def check_loss(motion: Motionwise, torques: Torques, robot: Robot) -> Iterator[Finding]:
    """Check that the remaining rows determine each joint's sliding torque.

    The difference of estimates from random halves has four times the variance of the estimate from
    all rows.
    """
    if not loses_rows(motion.log):
        return
    for j in np.flatnonzero(motion.moves & (np.ptp(motion.tau, axis=0) > 0.0)):
        speeds, torque, deviation = _estimate_sliding_torque(motion, torques, int(j))
        uncertain = 2.0 * deviation / np.maximum(np.abs(torque), 1e-300)
        worst = int(np.argmax(uncertain))
        if uncertain[worst] <= _MAX_UNCERTAINTY:
            continue
        unit = "m/s" if robot.slides[j] else "rad/s"
        observation = (
            f"many rows are missing; its sliding torque at {speeds[worst]:.2g} {unit} is uncertain "
            f"by {100 * min(uncertain[worst], 9.99):.2g} %"
        )
        remedy = (
            f"friction needs {100 * _MAX_UNCERTAINTY:g} %; record without losses, or for longer"
        )
        yield build_joint_finding("missing-rows", robot.joints[j], observation, remedy)


def _estimate_sliding_torque(
    motion: Motionwise, torques: Torques, j: int
) -> tuple[Array, Array, Array]:
    """Return speeds (K,), sliding torques and their deviation."""
    v = motion.v[:, j]
    tau = motion.tau[:, j]
    speeds = float(np.max(np.abs(v))) * _SPEED_SHARES
    hats = np.stack(
        [np.interp(np.abs(v), speeds, corner_values) for corner_values in np.eye(len(speeds))],
        axis=1,
    )
    direction = np.tanh(v / (_REVERSAL_SHARE * speeds[1]))
    columns = np.column_stack(
        [direction[:, None] * hats, torques.gravity[:, j], torques.inertial[:, j], np.ones_like(v)]
    )

    def estimate(rows: Integers) -> Array:
        return np.asarray(np.linalg.lstsq(columns[rows], tau[rows], rcond=None)[0])

    rng = np.random.default_rng(0)
    middle = len(v) // 2
    differences = []
    for _ in range(_SPLIT_COUNT):
        order = rng.permutation(len(v))
        differences.append(estimate(order[:middle]) - estimate(order[middle:]))
    steps = np.diff(motion.log.t)
    steps = steps[steps <= motion.log.longest_step]
    lost_share = 1.0 - float(np.quantile(steps, 0.1) / np.mean(steps))
    row_share = len(v) / len(motion.log.t)
    deviation = np.std(differences, axis=0) * 0.5 * np.sqrt(lost_share * row_share)
    judged_speeds = np.flatnonzero(
        (_JUDGED_SHARES[0] <= _SPEED_SHARES) & (_JUDGED_SHARES[1] >= _SPEED_SHARES)
    )
    return (
        speeds[judged_speeds],
        estimate(np.arange(len(v)))[judged_speeds],
        deviation[judged_speeds],
    )
