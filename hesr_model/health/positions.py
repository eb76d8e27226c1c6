"""Time stamps and positions: gaps, lost rows, jumps, limits, duplicate columns."""

from collections.abc import Iterator

import numpy as np

from hesr_model.findings import Finding, of_joint
from hesr_model.health.evidence import Motionwise, Torques
from hesr_model.logs.guess import is_of_motor
from hesr_model.logs.log_format import column_names
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Integers
from hesr_model.units import OTHERS

_PERIODS = 5e-5, 0.9  # plausible sample periods [s]; 1 s may be 1 ms
_TURN = 2.0 * np.pi
_SPIKE = 40.0  # relative distance of a spike
_LEAST_SPIKE = 0.02  # [rad or m]
BEYOND = 0.05  # allowed excess over a limit [rad or m]
_COARSE = 8e-4
_FEW = 20  # reported step [rad or m], steps needed
_FAR = 100.0
_QUICK = 20.0  # [m], [m/s] of a sliding joint in other units
_SATURATED = 0.01  # share of rows at a limit of the drive
_LEVELS = 200  # distinct values of a finely quantised torque
_LONG_RUN = 5


def check_time(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check the time stamps of a log."""
    period = log.period
    steps = np.diff(log.t)
    low, high = _PERIODS
    if not low <= period <= high:
        declared = float(description.log.units.factors("t", 1)[0])
        units = [u for u, f in OTHERS["t"].items() if low <= period / declared * f <= high]
        # Of several possible units, prefer the one with a rate closest to 200 Hz.
        units.sort(key=lambda u: abs(np.log(period / declared * OTHERS["t"][u] * 200.0)))
        found = f"its rows are {period:.3g} s apart"
        mend = "the unit of time is wrong; see [log.units] t"
        if units:
            mend = f"time is in {units[0]}; set [log.units] t = '{units[0]}'"
        changes = {"log.units.t": units[0]} if units else {}
        yield of_joint("time-unit", "", found, mend, changes=changes)
        return
    if len(log.gaps):
        yield of_gaps(len(log.gaps), float(np.max(steps)), len(log.parts()))
    if loses_rows(log):
        share = share_of_long_steps(log)
        said = f"{100 * share:.0f} % of its steps are longer than 1.8 periods of {period:.4g} s"
        remedy = "rows are missing, which blurs reversals"
        yield of_joint("missing-rows", "", said, remedy, "warning")
    if log.dropped:
        found = f"{log.dropped} rows lack a number or repeat the time stamp of the row before"
        remedy = "they were left out ([log] missing = 'drop')"
        yield of_joint("dropped-rows", "", found, remedy, "warning")


def of_gaps(count: int, longest: float, parts: int) -> Finding:
    """Return the finding of gaps up to `longest` [s] between usable parts."""
    what = f"{count} gap{'s' * (count > 1)}, the longest of {longest:.3g} s"
    remedy = "rows are missing; " + (
        f"its {parts} parts are filtered and fitted separately"
        if parts > 1
        else "only one of its parts is long enough to use"
    )
    return of_joint("gaps", "", what, remedy, "warning")


def check_jumps(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check raw positions for lost turns and single outliers."""
    near = np.diff(log.t) <= 3.0 * log.period
    for j, joint in enumerate(description.joints):
        leaps = np.where(near, np.diff(log.q[:, j]), 0.0)
        turned = np.flatnonzero(np.abs(np.abs(leaps) - _TURN) < 0.1 * _TURN)
        usual = np.median(np.abs(leaps[leaps != 0.0])) if np.any(leaps) else 0.0
        if len(turned) and usual < 0.05 * _TURN:
            found = f"its position jumps by a full turn at t = {log.t[turned[0] + 1]:.4g} s"
            remedy = "the log wraps angles; unwrap them first (numpy.unwrap)"
            yield of_joint("wrap", joint, found, remedy)
            continue
        bends = np.abs(leaps[1:] - leaps[:-1])
        level = max(_SPIKE * float(np.quantile(bends, 0.99)), _LEAST_SPIKE) if len(bends) else 0.0
        if len(bends) and float(bends.max()) > level:
            k = int(np.argmax(bends)) + 1
            what = f"its position is {float(bends.max()):.3g} off at t = {log.t[k]:.4g} s"
            yield of_joint("spikes", joint, what, "a row is wrong, or rows were lost; leave it out")


def check_steps(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check that positions are finely quantised."""
    for j, joint in enumerate(description.joints):
        values = np.unique(log.q[:, j])
        if len(values) < _FEW or np.ptp(values) < _FEW * _COARSE:
            continue
        if np.array_equal(values, np.rint(values)):
            found = "its positions are whole numbers, as counts of an encoder are"
            remedy = "give the size of a count in rad or m as [log.units] q, or log more digits"
            yield of_joint("coarse", joint, found, remedy)
            continue
        step = float(np.median(np.diff(values)))
        # Distances of values are random with a fine encoder, equal with a coarse one.
        alike = np.mean(np.abs(np.diff(values) / step - 1.0) < 0.01)
        if step > _COARSE and alike > 0.5:
            found = f"its position comes in steps of {step:.2g}"
            remedy = (
                "it was rounded, or the encoder is coarse; log more digits to get sharper "
                "velocities"
            )
            yield of_joint("coarse", joint, found, remedy, "warning")


def check_limits(motion: Motionwise, model: Robot) -> Iterator[Finding]:
    """Check positions against the model's limits."""
    description = model.description
    lower, upper, _ = model.limits
    low = motion.q.min(axis=0)
    high = motion.q.max(axis=0)
    beyond = np.maximum(lower - low, high - upper)
    width = upper - lower
    turning = ~np.array(model.slides)
    factor = np.pi / 180.0
    in_degrees = bool(np.any(turning & (beyond > 3.0 * width))) and bool(
        np.all(np.maximum(lower - low * factor, high * factor - upper)[turning] < BEYOND + 0.1)
    )
    names = column_names(description.log.columns.q, description.joints)
    for j, joint in enumerate(description.joints):
        if beyond[j] <= BEYOND:
            continue
        of_motor = beyond[j] > width[j] and description.logged is None and is_of_motor(names[j])
        mends = in_degrees and turning[j] and not of_motor
        wrong = beyond[j] > width[j]
        far = high[j] if high[j] - upper[j] > lower[j] - low[j] else low[j]
        limit = upper[j] if high[j] - upper[j] > lower[j] - low[j] else lower[j]
        declared = description.log.units.each("q", model.n)
        degrees = tuple("deg" if t else u for u, t in zip(declared, turning, strict=True))
        unit: str | tuple[object, ...] = "deg" if len(set(degrees)) == 1 else degrees
        yield Finding(
            check="limits",
            severity="error" if wrong else "warning",
            joints=(joint,),
            found=f"its position reaches {far:.4g}, the model's limit is {limit:.4g}",
            remedy=f"columns such as '{names[0]}' are named like motors'; give the turns of each "
            "motor per turn of each joint as 'matrix' in [transmission], with logs = 'motor'"
            if of_motor
            else "q is in degrees; set [log.units] q = 'deg'"
            if mends
            else "its unit, its zero or its column is wrong, or the model's limits are"
            if wrong
            else "the log's zero differs from the model's, or the model's limits are narrow",
            changes={"log.units.q": unit} if mends else {},
        )


def check_sliding(motion: Motionwise, robot: Robot) -> Iterator[Finding]:
    """Check that no sliding joint moves as only millimetres can."""
    units = robot.description.log.units
    travel = np.ptp(motion.q, axis=0)
    speed = np.max(np.abs(motion.v), axis=0)
    for j in np.flatnonzero(np.array(robot.slides) & ((travel > _FAR) | (speed > _QUICK))):
        alone = all(robot.slides) and units.each("q", robot.n)[j] in ("m", "rad")
        changes = {"log.units.q": "mm"} if alone else {}
        if changes and motion.dq is not None:
            changes["log.units.dq"] = "mm/s"
        found = f"it slides by {travel[j]:.3g} m at up to {speed[j]:.3g} m/s"
        remedy = "q is in mm; set [log.units] q = 'mm'" if alone else "see the units of q"
        yield of_joint("sliding-unit", robot.joints[j], found, remedy, changes=changes)


def check_columns(motion: Motionwise, description: RobotDescription) -> Iterator[Finding]:
    """Check that no column is a copy, constant, or clipped."""
    joints = [int(j) for j in np.flatnonzero(motion.moves)]
    for kind, values in (("position", motion.q), ("velocity", motion.dq), ("torque", motion.tau)):
        if values is None:
            continue
        for a in joints:
            for b in range(a):
                if np.std(values[:, a]) > 0 and np.array_equal(values[:, a], values[:, b]):
                    found = (
                        f"its {kind} equals that of joint '{description.joints[b]}' in every row"
                    )
                    remedy = "one column is used for both; see [log.columns]"
                    yield of_joint("same-column", description.joints[a], found, remedy)
    for j in joints:
        tau = motion.log.tau[:, j]
        if np.ptp(tau) == 0.0:
            found = f"it moves while its torque stays at {tau[0]:.4g}"
            remedy = "its torque is not logged, or another column is"
            yield of_joint("torque-constant", description.joints[j], found, remedy)
        elif (share := _share_at_limit(tau)) > _SATURATED:
            largest = f"{np.max(np.abs(tau)):.4g}"
            found = f"{100 * share:.1f} % of its rows are at the largest torque, {largest}"
            remedy = "the drive or the log clips the torque; friction beyond is not learned"
            yield of_joint("saturation", description.joints[j], found, remedy, "warning")


def _share_at_limit(tau: Array) -> float:
    top = np.abs(tau) >= np.max(np.abs(tau))
    run = np.convolve(top, np.ones(_LONG_RUN), mode="same")
    fine = len(np.unique(tau)) > _LEVELS
    return float(np.mean(top)) if fine and run.max(initial=0.0) >= _LONG_RUN else 0.0


_SKIPPED = 0.05  # allowed share of steps longer than 1.8 periods
_OFF_GRID = 0.2  # periods
_IRREGULAR = 0.2  # share of steps off the grid, above which stamps are irregular
_UNCERTAIN = 0.03  # allowed relative uncertainty, two standard deviations
_SPEEDS = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])  # shares of the peak speed
_JUDGED = (0.1, 0.7)  # shares where the joint slides
_SPLITS = 16
_HALF_WAY = 0.2  # reversal, as share of the slowest interval


def share_of_long_steps(log: Log) -> float:
    """Return the share of steps above 1.8 median periods, without gaps."""
    steps = np.diff(log.t)
    return float(np.mean(steps[steps <= log.longest_step] > 1.8 * log.period))


def loses_rows(log: Log) -> bool:
    """Return whether rows are missing throughout a log, whose stamps else keep to a grid."""
    if share_of_long_steps(log) <= _SKIPPED:
        return False
    steps = np.diff(log.t)
    periods = steps / np.median(steps[steps <= 1.5 * np.quantile(steps, 0.1)])
    return float(np.mean(np.abs(periods - np.rint(periods)) > _OFF_GRID)) < _IRREGULAR


def check_loss(motion: Motionwise, torques: Torques, robot: Robot) -> Iterator[Finding]:
    """Check that the remaining rows determine each joint's sliding torque.

    The difference of estimates from random halves has four times the variance of the estimate from
    all rows.
    """
    if not loses_rows(motion.log):
        return
    for j in np.flatnonzero(motion.moves & (np.ptp(motion.tau, axis=0) > 0.0)):
        speeds, torque, deviation = _sliding(motion, torques, int(j))
        uncertain = 2.0 * deviation / np.maximum(np.abs(torque), 1e-300)
        worst = int(np.argmax(uncertain))
        if uncertain[worst] <= _UNCERTAIN:
            continue
        unit = "m/s" if robot.slides[j] else "rad/s"
        found = (
            f"many rows are missing; its sliding torque at {speeds[worst]:.2g} {unit} is uncertain "
            f"by {100 * min(uncertain[worst], 9.99):.2g} %"
        )
        remedy = f"friction needs {100 * _UNCERTAIN:g} %; record without losses, or for longer"
        yield of_joint("missing-rows", robot.joints[j], found, remedy)


def _sliding(motion: Motionwise, torques: Torques, j: int) -> tuple[Array, Array, Array]:
    """Return speeds (K,), sliding torques and their deviation."""
    v = motion.v[:, j]
    tau = motion.tau[:, j]
    speeds = float(np.max(np.abs(v))) * _SPEEDS
    hats = np.stack([np.interp(np.abs(v), speeds, one) for one in np.eye(len(speeds))], axis=1)
    way = np.tanh(v / (_HALF_WAY * speeds[1]))
    columns = np.column_stack(
        [way[:, None] * hats, torques.gravity[:, j], torques.inertial[:, j], np.ones_like(v)]
    )

    def estimate(rows: Integers) -> Array:
        return np.asarray(np.linalg.lstsq(columns[rows], tau[rows], rcond=None)[0])

    rng = np.random.default_rng(0)
    middle = len(v) // 2
    differences = []
    for _ in range(_SPLITS):
        order = rng.permutation(len(v))
        differences.append(estimate(order[:middle]) - estimate(order[middle:]))
    steps = np.diff(motion.log.t)
    steps = steps[steps <= motion.log.longest_step]
    lost = 1.0 - float(np.quantile(steps, 0.1) / np.mean(steps))
    rows = len(v) / len(motion.log.t)
    deviation = np.std(differences, axis=0) * 0.5 * np.sqrt(lost * rows)
    judged = np.flatnonzero((_JUDGED[0] <= _SPEEDS) & (_JUDGED[1] >= _SPEEDS))
    return speeds[judged], estimate(np.arange(len(v)))[judged], deviation[judged]
