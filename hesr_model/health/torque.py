"""Torque checks: raw signal, and signs and scales against motion and model."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from hesr_model.equations.recurrence import recurrence
from hesr_model.findings import Finding, build_joint_finding
from hesr_model.health.evidence import ModelTorques, SmoothPart, TorqueFit, fit_joint_torque
from hesr_model.health.velocity import join_units
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Mask
from hesr_model.units import reverse_unit, unit_of_joint

_MIN_SIGNIFICANCE = 5.0  # significance threshold in standard errors
_MAX_SCALE = 3.0  # plausible factor of gravity; real arms have 0.6 to 1.5
_MIN_R2 = 0.8  # minimum R^2 for a scale estimate
NO_SIGNAL_R2 = 0.35  # R^2 below which nothing is explained
_DEFLECTION_SHARES = (0.03, 0.1, 0.3)  # of the travel, after which friction slides
_MAX_COMPUTED_RESIDUAL = 0.1  # residual share of computed torques
_MIN_GRAVITY_TO_RESIDUAL = 0.5  # gravity over the residual to judge its sign
_MAX_WEIGHTLESS_SHARE = 0.1  # share of the model's gravity in weightless torques
_MAX_PEAK_TO_LIMIT = 10.0
_MIN_RATIO_TO_OTHERS = 30.0  # peak over the model's limit, others over own
TorqueFits = Mapping[int, TorqueFit]  # by index of the joint


def fit_joint_torques(part: SmoothPart, torques: ModelTorques) -> TorqueFits:
    """Regress the torque of every moving joint."""
    signals = (part.tau, torques.gravity, torques.inertial, part.v)
    moving_joints = np.flatnonzero(part.is_moving & (np.ptp(part.tau, axis=0) > 0.0))
    return {int(j): fit_joint_torque(*(signal[:, j] for signal in signals)) for j in moving_joints}


def _explain_by_hysteresis(part: SmoothPart, j: int) -> float:
    """Return the share of a torque's variance that sliding after a deflection explains, R^2.

    Friction that builds up over most of a short stroke hardly depends on the velocity.
    """
    v = part.v[:, j]
    tau = part.tau[:, j]
    travel = float(np.ptp(part.q[:, j]))
    distances = np.abs(v) * np.diff(part.t, prepend=part.t[0])
    best_r2 = 0.0
    for share in _DEFLECTION_SHARES:
        # x' = v / w - |v| x / w, exactly for speeds held over a step.
        decay = np.exp(-distances / (share * travel))
        deflection = recurrence(decay, (1.0 - decay) * np.sign(v), 0.0)
        columns = np.column_stack([deflection, v, np.ones_like(v)])
        residual = tau - columns @ np.linalg.lstsq(columns, tau, rcond=None)[0]
        best_r2 = max(best_r2, 1.0 - float(np.var(residual) / np.var(tau)))
    return best_r2


def check_torque(
    part: SmoothPart, fits: TorqueFits, robot: Robot, blurred_joints: Collection[int] = ()
) -> Iterator[Finding]:
    """Check torques, but not the scale of `blurred_joints` joints."""
    for j, fit in fits.items():
        if fit.r2 < NO_SIGNAL_R2 and _explain_by_hysteresis(part, j) < NO_SIGNAL_R2:
            level_count = len(np.unique(part.tau[:, j]))
            observation = (
                f"model and friction explain {100 * max(fit.r2, 0):.0f} % of its torque, "
                f"which takes {level_count} values"
            )
            remedy = "it contains almost no signal, or belongs to another joint"
            yield build_joint_finding(
                "torque-signal", robot.description.joints[j], observation, remedy, "warning"
            )
            continue
        yield from _check_sign(fit, j, robot)
        if j not in blurred_joints:
            yield from _check_scale(fit, j, fits, robot)
        if (
            fit.gravity.t < -_MIN_SIGNIFICANCE
            and fit.gravity_size > _MIN_GRAVITY_TO_RESIDUAL * fit.residual
        ):
            yield Finding(
                check="gravity-sign",
                joints=(robot.description.joints[j],),
                found="its gravity torque has the opposite sign of the model's "
                f"({fit.gravity.value:.2g} times, {abs(fit.gravity.t):.0f} standard errors)",
                remedy="the mounting differs from 'gravity', its zero is off by half a turn, or "
                "torque or position has the wrong sign",
            )
    yield from _check_friction(fits, robot)
    yield from _check_limits(part, fits, robot)


def _check_sign(fit: TorqueFit, j: int, robot: Robot) -> Iterator[Finding]:
    if fit.friction.t > -_MIN_SIGNIFICANCE or fit.friction_size < 0.3 * fit.residual:
        return
    description = robot.description
    follows_gravity = fit.bears_gravity and fit.gravity.t > _MIN_SIGNIFICANCE
    subject = "position and velocity count" if follows_gravity else "torque counts"
    key, changes = find_sign_change(description, j, position=follows_gravity)
    unit = unit_of_joint("N.m", is_prismatic=robot.slides[j])
    alternative = "" if fit.bears_gravity else ", or its position and velocity do"
    observation = (
        "its torque drives the motion where friction should brake it "
        f"({fit.friction.value:.3g} {unit} along the velocity, {abs(fit.friction.t):.0f} "
        "standard errors)"
    )
    remedy = f"its {subject} backwards{alternative}; set {key}"
    yield build_joint_finding(
        "torque-sign", description.joints[j], observation, remedy, changes=changes
    )


def find_sign_change(
    description: RobotDescription, j: int | None, *, position: bool
) -> tuple[str, dict[str, object]]:
    """Return the change that reverses a torque or position; `j` None means all."""
    n = len(description.joints)

    def reverse_units(key: str) -> tuple[str | float, ...]:
        units = description.log.units.expand_per_joint(key, n)
        return tuple(reverse_unit(unit) if j in (k, None) else unit for k, unit in enumerate(units))

    example_joint = j or 0
    qualifier = "" if j is None else " of it"
    if position:
        changes: dict[str, object] = {f"log.units.{k}": reverse_units(k) for k in ("q", "dq")}
        return (
            f"[log.units] q and dq{qualifier} with a '-', as {reverse_units('q')[example_joint]!r}",
            changes,
        )
    gains = description.log.torque_per_ampere
    if gains is None:
        units = reverse_units("tau")
        return f"[log.units] tau{qualifier} to {units[example_joint]!r}", {"log.units.tau": units}
    reversed_gains = tuple(-gain if j in (k, None) else gain for k, gain in enumerate(gains))
    gain_text = (
        f"{reversed_gains[j]:g}"
        if j is not None
        else f"[{', '.join(f'{gain:g}' for gain in reversed_gains)}]"
    )
    possessive = "its " if j is not None else ""
    return f"{possessive}torque_per_ampere to {gain_text}", {
        "log.torque_per_ampere": reversed_gains
    }


def _check_scale(fit: TorqueFit, j: int, fits: TorqueFits, robot: Robot) -> Iterator[Finding]:
    if fit.r2 < _MIN_R2:
        return
    is_weightless = (
        fit.bears_gravity
        and fit.gravity.value + _MIN_SIGNIFICANCE * fit.gravity.error < 1.0 / _MAX_SCALE
    )
    is_huge = (
        fit.gravity_size > 1e-3 and fit.gravity.value - _MIN_SIGNIFICANCE * fit.gravity.error > 10.0
    )
    if is_weightless or (abs(fit.gravity.t) > _MIN_SIGNIFICANCE and (fit.bears_gravity or is_huge)):
        scale = abs(fit.gravity.value)
        margin = _MIN_SIGNIFICANCE * fit.gravity.error
        torque_kind = "gravity"
    else:
        scale = fit.inertia.value
        margin = _MIN_SIGNIFICANCE * fit.inertia.error
        torque_kind = "inertial"
    is_too_small = scale + margin < 1.0 / _MAX_SCALE
    is_too_large = torque_kind == "gravity" and scale - margin > _MAX_SCALE
    # A rotor may exceed the links many times, but never reduces the inertia.
    if not (is_too_small or is_too_large) or not np.isfinite(margin):
        return
    description = robot.description
    gravity_scales = [
        abs(other_fit.gravity.value) for other_fit in fits.values() if other_fit.bears_gravity
    ]
    is_everywhere = len(gravity_scales) > 1 and all(
        not 1 / _MAX_SCALE <= gravity_scale <= _MAX_SCALE for gravity_scale in gravity_scales
    )
    remedy, changes = _explain_scale(description, j, scale, is_everywhere=is_everywhere)
    if (
        scale <= _MAX_WEIGHTLESS_SHARE
        and is_weightless
        and abs(fit.inertia.value) >= 1.0 / _MAX_SCALE
    ):
        remedy = "gravity was removed from it, a spring or counterweight carries the "
        changes = {}
        remedy += "arm, or the file declares another gravity"
    factor_text = f"{max(scale, 0.0):.2g} (+- {margin:.1g}) times"
    observation = f"its torque is {factor_text} the {torque_kind} torque of the model"
    yield build_joint_finding(
        "torque-scale", description.joints[j], observation, remedy, changes=changes
    )


def _explain_scale(
    description: RobotDescription, j: int, scale: float, *, is_everywhere: bool
) -> tuple[str, dict[str, object]]:
    if description.log.torque_per_ampere is not None:
        if scale <= 0:
            return "its torque_per_ampere is far too small, or the column holds another signal", {}
        deviation_factor = max(scale, 1.0 / scale)
        rounded_factor = round(deviation_factor, 1 - len(str(int(deviation_factor))))
        direction = "small" if scale < 1 else "large"
        return f"its torque_per_ampere is about {rounded_factor:g} times too {direction}", {}
    if scale > 100:
        return "torque is in mN.m; set [log.units] tau = 'mN.m'", {"log.units.tau": "mN.m"}
    gear_ratios = description.gear_ratio
    if gear_ratios and 1 / _MAX_SCALE < scale * gear_ratios[j] < _MAX_SCALE:
        cause = "it is the motor torque before the gear"
        return f"{cause}; set [log.units] tau = {join_units(gear_ratios)}", {
            "log.units.tau": gear_ratios
        }
    if is_everywhere and scale < 1:
        remedy = "the column contains currents [A] or motor torques; name it under [log.columns] "
        return f"{remedy}current and give torque_per_ampere", {}
    remedy = (
        "the unit of torque or position is wrong, or the column holds a current; see [log.units]"
    )
    return remedy, {}


def _check_friction(fits: TorqueFits, robot: Robot) -> Iterator[Finding]:
    explained_fits = {j: fit for j, fit in fits.items() if fit.r2 > _MIN_R2}
    shows_friction = [
        abs(fit.friction.t) > _MIN_SIGNIFICANCE
        or fit.residual > _MAX_COMPUTED_RESIDUAL * fit.deviation
        for fit in explained_fits.values()
    ]
    if not explained_fits or any(shows_friction):
        return
    yield Finding(
        check="no-friction",
        severity="warning",
        joints=tuple(robot.description.joints[j] for j in explained_fits),
        found="the model's rigid body explains their torques completely, and no part follows the "
        "velocity",
        remedy="they were computed or commanded instead of measured, or friction was removed",
    )


def _check_limits(part: SmoothPart, fits: TorqueFits, robot: Robot) -> Iterator[Finding]:
    torque_limits = np.where(np.isfinite(robot.torque_limits), robot.torque_limits, 0.0)
    peaks = np.quantile(np.abs(part.tau), 0.99, axis=0)
    shares = {
        j: float(peaks[j] / torque_limits[j])
        for j in fits
        if torque_limits[j] > 0 and not robot.slides[j]
    }
    for j, share in shares.items():
        joint = robot.description.joints[j]
        if share > _MAX_PEAK_TO_LIMIT:
            observation = f"its torque reaches {peaks[j]:.3g}, {share:.2g} times the model's limit"
            yield build_joint_finding(
                "torque-limit", joint, observation, "its unit or its torque_per_ampere is wrong"
            )
        other_shares = [other_share for k, other_share in shares.items() if k != j]
        usual_share = np.median(other_shares) if len(other_shares) > 1 else 0.0
        if share * _MIN_RATIO_TO_OTHERS < usual_share and fits[j].r2 > _MIN_R2:
            observation = (
                f"its torque reaches {100 * share:.2g} % of the model's limit, the other joints' "
                f"{100 * usual_share:.2g} %"
            )
            remedy = "its unit or its torque_per_ampere may be wrong"
            yield build_joint_finding("torque-small", joint, observation, remedy, "warning")


_SPEED_WINDOW = 0.1  # averaging window of a speed [s]
_MIN_MOVING_SPEED = 0.05  # speed of a moving joint [rad/s; m/s]
_MIN_MOVING_TO_RESTING = 2.5  # and of a slow joint, over the speed at which it rests
_FINE_LEVELS = 200  # distinct values of a finely quantised signal
_MAX_HELD_SHARE = 0.3  # share of repeated rows
_MIN_STUCK_TIME = 0.3
_MIN_STUCK_ROWS = 15  # duration [s] and rows of a stuck signal
_MIN_STUCK_TO_USUAL = 10.0
_MIN_MOVING_SHARE = 0.25  # stuck run over others, its share in motion
_MIN_SPIKE_TO_RANGE = 3.0  # torque spike over the range of other rows
_MAX_SPEED_TO_LIMIT = 1.3  # speed over the limit; drives exceed it slightly


def check_raw_signals(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check raw signals for held, stuck and outlying values."""
    if len(log.t) < 2 * _MIN_STUCK_ROWS:
        return
    speeds = _compute_speeds(log)
    resting_speeds = find_resting_speeds([log.t], [log.q], [speeds])
    min_speeds = np.minimum(_MIN_MOVING_SPEED, _MIN_MOVING_TO_RESTING * resting_speeds)
    is_moving = np.abs(speeds) > min_speeds
    is_fine = np.array([len(np.unique(column)) > _FINE_LEVELS for column in log.tau.T])
    yield from _check_repeated_rows(log, is_moving, is_fine)
    for j, joint in enumerate(description.joints):
        if log.dq is not None:
            row = _find_constant_run(log, log.q[:, j], np.abs(log.dq[:, j]) > min_speeds[j])
            if row is not None:
                yield _report_stuck(log, joint, "position", row, "its velocity is not zero")
        tau = log.tau[:, j]
        row = _find_constant_run(log, tau, is_moving[:, j]) if is_fine[j] else None
        if row is not None and abs(tau[row]) < np.max(np.abs(tau)):
            yield _report_stuck(log, joint, "torque", row, "it moves")
        lowest, highest = np.quantile(log.tau[:, j], [0.01, 0.99])
        neighbour_mean = 0.5 * (log.tau[:-2, j] + log.tau[2:, j])
        excursion = np.abs(log.tau[1:-1, j] - neighbour_mean)
        is_single = np.abs(log.tau[2:, j] - log.tau[:-2, j]) < 0.2 * excursion
        k = int(np.argmax(np.where(is_single, excursion, 0.0)))
        if is_single[k] and excursion[k] > _MIN_SPIKE_TO_RANGE * (highest - lowest) > 0.0:
            observation = (
                f"its torque is {excursion[k]:.3g} off in a single row, at t = {log.t[k + 1]:.4g} s"
            )
            yield build_joint_finding(
                "torque-spikes", joint, observation, "that row is wrong; leave it out"
            )


def _compute_speeds(log: Log) -> Array:
    """Return speeds (N, n) of raw positions."""
    half_window = max(1, round(0.5 * _SPEED_WINDOW / log.period))
    rows = np.arange(len(log.t))
    first_rows = np.maximum(rows - half_window, 0)
    last_rows = np.minimum(rows + half_window, len(rows) - 1)
    return np.asarray(
        (log.q[last_rows] - log.q[first_rows]) / (log.t[last_rows] - log.t[first_rows])[:, None]
    )


def _check_repeated_rows(log: Log, is_moving: Mask, is_fine: Mask) -> Iterator[Finding]:
    if not np.any(is_fine):
        return
    is_in_motion = np.any(is_moving[1:], axis=1)
    if is_in_motion.sum() < _MIN_STUCK_ROWS:
        return
    is_repeated = np.all(np.diff(log.tau[:, is_fine], axis=0) == 0.0, axis=1)
    share = float(np.mean(is_repeated[is_in_motion]))
    if share > _MAX_HELD_SHARE:
        observation = (
            f"{100 * share:.0f} % of the rows in motion repeat the torques of the row before"
        )
        remedy = "the log is faster than the robot's data; log at the robot's own rate"
        yield build_joint_finding("held-samples", "", observation, remedy, "warning")


def _find_constant_run(log: Log, signal: Array, is_moving: Mask) -> int | None:
    edges = np.flatnonzero(np.diff(np.r_[False, np.diff(signal) == 0.0, False].astype(int)))
    starts = edges[::2]
    lengths = edges[1::2] - edges[::2]
    if not len(starts):
        return None
    k = int(np.argmax(lengths))
    first = int(starts[k])
    last = int(starts[k] + lengths[k])
    usual_length = float(np.quantile(np.delete(lengths, k), 0.95)) if len(lengths) > 1 else 1.0
    is_long = last - first >= max(_MIN_STUCK_ROWS, _MIN_STUCK_TO_USUAL * usual_length)
    is_lasting = log.t[last] - log.t[first] > _MIN_STUCK_TIME
    return (
        first
        if is_long and is_lasting and np.mean(is_moving[first:last]) > _MIN_MOVING_SHARE
        else None
    )


def _report_stuck(log: Log, joint: str, quantity: str, row: int, contradiction: str) -> Finding:
    observation = f"its {quantity} is constant from t = {log.t[row]:.4g} s, while {contradiction}"
    remedy = "the sensor or its connection failed there; cut these rows out"
    return build_joint_finding("stuck", joint, observation, remedy)


def check_speed(part: SmoothPart, robot: Robot) -> Iterator[Finding]:
    """Check speeds against the model's limits."""
    speed_limits = np.where(np.isfinite(robot.limits[2]), robot.limits[2], 0.0)
    peak_speeds = np.quantile(np.abs(part.v), 0.998, axis=0)
    for j in np.flatnonzero(part.is_moving & (speed_limits > 0.0)):
        if peak_speeds[j] <= _MAX_SPEED_TO_LIMIT * speed_limits[j]:
            continue
        unit = "m/s" if robot.slides[j] else "rad/s"
        ratio_text = f"{peak_speeds[j] / speed_limits[j]:.2g} times the model's limit"
        observation = f"it reaches {peak_speeds[j]:.3g} {unit}, {ratio_text}"
        remedy = "the time stamps come from a wrong sample rate, a unit is wrong, or the model's "
        yield build_joint_finding(
            "speed-limit", robot.joints[j], observation, f"{remedy}limits are", "warning"
        )
