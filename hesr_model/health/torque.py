"""Torque checks: raw signal, and signs and scales against motion and model."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from hesr_model.findings import Finding, of_joint
from hesr_model.health.evidence import JointTorque, Motionwise, Torques, explain
from hesr_model.health.velocity import listed
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Mask
from hesr_model.units import backwards, unit_of_joint

_SURE = 5.0  # significance threshold in standard errors
_SCALE = 3.0  # plausible factor of gravity; real arms have 0.6 to 1.5
_EXPLAINED = 0.8  # minimum R^2 for a scale estimate
NO_SIGNAL = 0.35  # R^2 below which nothing is explained
_EXACT = 0.1  # residual share of computed torques
_SEEN = 0.5  # gravity over the residual to judge its sign
_WEIGHTLESS = 0.1  # share of the model's gravity in weightless torques
_ABOVE_LIMIT = 10.0
_BELOW_OTHERS = 30.0  # peak over the model's limit, others over own
Explained = Mapping[int, JointTorque]  # by index of the joint


def explained(motion: Motionwise, torques: Torques) -> Explained:
    """Regress the torque of every moving joint."""
    signals = (motion.tau, torques.gravity, torques.inertial, motion.v)
    moving = np.flatnonzero(motion.moves & (np.ptp(motion.tau, axis=0) > 0.0))
    return {int(j): explain(*(signal[:, j] for signal in signals)) for j in moving}


def check_torque(
    motion: Motionwise, found: Explained, robot: Robot, blurred: Collection[int] = ()
) -> Iterator[Finding]:
    """Check torques, but not the scale of `blurred` joints."""
    for j, fit in found.items():
        if fit.r2 < NO_SIGNAL:
            levels = len(np.unique(motion.tau[:, j]))
            what = (
                f"model and friction explain {100 * max(fit.r2, 0):.0f} % of its torque, "
                f"which takes {levels} values"
            )
            remedy = "it contains almost no signal, or belongs to another joint"
            yield of_joint("torque-signal", robot.description.joints[j], what, remedy, "warning")
            continue
        yield from _sign(fit, j, robot)
        if j not in blurred:
            yield from _scale(fit, j, found, robot)
        if fit.gravity.t < -_SURE and fit.gravity_size > _SEEN * fit.residual:
            yield Finding(
                check="gravity-sign",
                joints=(robot.description.joints[j],),
                found="its gravity torque has the opposite sign of the model's "
                f"({fit.gravity.value:.2g} times, {abs(fit.gravity.t):.0f} standard errors)",
                remedy="the mounting differs from 'gravity', its zero is off by half a turn, or "
                "torque or position has the wrong sign",
            )
    yield from _no_friction(found, robot)
    yield from _against_limits(motion, found, robot)


def _sign(fit: JointTorque, j: int, model: Robot) -> Iterator[Finding]:
    if fit.friction.t > -_SURE or fit.friction_size < 0.3 * fit.residual:
        return
    description = model.description
    follows = fit.bears_gravity and fit.gravity.t > _SURE
    what = "position and velocity count" if follows else "torque counts"
    key, changes = sign_change(description, j, position=follows)
    unit = unit_of_joint("N.m", slides=model.slides[j])
    beside = "" if fit.bears_gravity else ", or its position and velocity do"
    found = (
        "its torque drives the motion where friction should brake it "
        f"({fit.friction.value:.3g} {unit} along the velocity, {abs(fit.friction.t):.0f} "
        "standard errors)"
    )
    remedy = f"its {what} backwards{beside}; set {key}"
    yield of_joint("torque-sign", description.joints[j], found, remedy, changes=changes)


def sign_change(
    description: RobotDescription, j: int | None, *, position: bool
) -> tuple[str, dict[str, object]]:
    """Return the change that reverses a torque or position; `j` None means all."""
    n = len(description.joints)

    def turned(key: str) -> tuple[str | float, ...]:
        units = description.log.units.each(key, n)
        return tuple(backwards(unit) if j in (k, None) else unit for k, unit in enumerate(units))

    first = j or 0
    whose = "" if j is None else " of it"
    if position:
        changes: dict[str, object] = {f"log.units.{k}": turned(k) for k in ("q", "dq")}
        return f"[log.units] q and dq{whose} with a '-', as {turned('q')[first]!r}", changes
    gains = description.log.torque_per_ampere
    if gains is None:
        units = turned("tau")
        return f"[log.units] tau{whose} to {units[first]!r}", {"log.units.tau": units}
    mended = tuple(-gain if j in (k, None) else gain for k, gain in enumerate(gains))
    told = f"{mended[j]:g}" if j is not None else f"[{', '.join(f'{gain:g}' for gain in mended)}]"
    owner = "its " if j is not None else ""
    return f"{owner}torque_per_ampere to {told}", {"log.torque_per_ampere": mended}


def _scale(fit: JointTorque, j: int, found: Explained, model: Robot) -> Iterator[Finding]:
    if fit.r2 < _EXPLAINED:
        return
    weightless = fit.bears_gravity and fit.gravity.value + _SURE * fit.gravity.error < 1.0 / _SCALE
    huge = fit.gravity_size > 1e-3 and fit.gravity.value - _SURE * fit.gravity.error > 10.0
    if weightless or (abs(fit.gravity.t) > _SURE and (fit.bears_gravity or huge)):
        scale = abs(fit.gravity.value)
        margin = _SURE * fit.gravity.error
        of = "gravity"
    else:
        scale = fit.inertia.value
        margin = _SURE * fit.inertia.error
        of = "inertial"
    too_small = scale + margin < 1.0 / _SCALE
    too_large = of == "gravity" and scale - margin > _SCALE
    # A rotor may exceed the links many times, but never reduces the inertia.
    if not (too_small or too_large) or not np.isfinite(margin):
        return
    description = model.description
    bearing = [abs(f.gravity.value) for f in found.values() if f.bears_gravity]
    everywhere = len(bearing) > 1 and all(not 1 / _SCALE <= size <= _SCALE for size in bearing)
    remedy, changes = _explain_scale(description, j, scale, everywhere=everywhere)
    if scale <= _WEIGHTLESS and weightless and abs(fit.inertia.value) >= 1.0 / _SCALE:
        remedy = "gravity was removed from it, a spring or counterweight carries the "
        changes = {}
        remedy += "arm, or the file declares another gravity"
    times = f"{max(scale, 0.0):.2g} (+- {margin:.1g}) times"
    said = f"its torque is {times} the {of} torque of the model"
    yield of_joint("torque-scale", description.joints[j], said, remedy, changes=changes)


def _explain_scale(
    description: RobotDescription, j: int, scale: float, *, everywhere: bool
) -> tuple[str, dict[str, object]]:
    if description.log.torque_per_ampere is not None:
        if scale <= 0:
            return "its torque_per_ampere is far too small, or the column holds another signal", {}
        off = max(scale, 1.0 / scale)
        about = round(off, 1 - len(str(int(off))))
        way = "small" if scale < 1 else "large"
        return f"its torque_per_ampere is about {about:g} times too {way}", {}
    if scale > 100:
        return "torque is in mN.m; set [log.units] tau = 'mN.m'", {"log.units.tau": "mN.m"}
    gears = description.gear_ratio
    if gears and 1 / _SCALE < scale * gears[j] < _SCALE:
        what = "it is the motor torque before the gear"
        return f"{what}; set [log.units] tau = {listed(gears)}", {"log.units.tau": gears}
    if everywhere and scale < 1:
        why = "the column contains currents [A] or motor torques; name it under [log.columns] "
        return f"{why}current and give torque_per_ampere", {}
    why = "the unit of torque or position is wrong, or the column holds a current; see [log.units]"
    return why, {}


def _no_friction(found: Explained, robot: Robot) -> Iterator[Finding]:
    clear = {j: f for j, f in found.items() if f.r2 > _EXPLAINED}
    told = [abs(f.friction.t) > _SURE or f.residual > _EXACT * f.deviation for f in clear.values()]
    if not clear or any(told):
        return
    yield Finding(
        check="no-friction",
        severity="warning",
        joints=tuple(robot.description.joints[j] for j in clear),
        found="the model's rigid body explains their torques completely, and no part follows the "
        "velocity",
        remedy="they were computed or commanded instead of measured, or friction was removed",
    )


def _against_limits(motion: Motionwise, found: Explained, robot: Robot) -> Iterator[Finding]:
    limits = np.where(np.isfinite(robot.torque_limits), robot.torque_limits, 0.0)
    peaks = np.quantile(np.abs(motion.tau), 0.99, axis=0)
    used = {j: float(peaks[j] / limits[j]) for j in found if limits[j] > 0 and not robot.slides[j]}
    for j, share in used.items():
        name = robot.description.joints[j]
        if share > _ABOVE_LIMIT:
            what = f"its torque reaches {peaks[j]:.3g}, {share:.2g} times the model's limit"
            yield of_joint("torque-limit", name, what, "its unit or its torque_per_ampere is wrong")
        others = [s for k, s in used.items() if k != j]
        usual = np.median(others) if len(others) > 1 else 0.0
        if share * _BELOW_OTHERS < usual and found[j].r2 > _EXPLAINED:
            said = (
                f"its torque reaches {100 * share:.2g} % of the model's limit, the other joints' "
                f"{100 * usual:.2g} %"
            )
            remedy = "its unit or its torque_per_ampere may be wrong"
            yield of_joint("torque-small", name, said, remedy, "warning")


_WINDOW = 0.1  # averaging window of a speed [s]
_MOVES = 0.05  # speed of a moving joint [rad/s; m/s]
_LEVELS = 200  # distinct values of a finely quantised signal
_HELD = 0.3  # share of repeated rows
_STUCK = 0.3
_STUCK_ROWS = 15  # duration [s] and rows of a stuck signal
_RARE = 10.0
_MOVING = 0.25  # stuck run over others, its share in motion
_SPIKE = 3.0  # torque spike over the range of other rows
_TOO_FAST = 1.3  # speed over the limit; drives exceed it slightly


def check_raw_signals(log: Log, description: RobotDescription) -> Iterator[Finding]:
    """Check raw signals for held, stuck and outlying values."""
    if len(log.t) < 2 * _STUCK_ROWS:
        return
    moves = np.abs(_speeds(log)) > _MOVES
    fine = np.array([len(np.unique(column)) > _LEVELS for column in log.tau.T])
    yield from _repeated(log, moves, fine)
    for j, joint in enumerate(description.joints):
        if log.dq is not None:
            row = _stands_still(log, log.q[:, j], np.abs(log.dq[:, j]) > _MOVES)
            if row is not None:
                yield _stuck(log, joint, "position", row, "its velocity is not zero")
        tau = log.tau[:, j]
        row = _stands_still(log, tau, moves[:, j]) if fine[j] else None
        if row is not None and abs(tau[row]) < np.max(np.abs(tau)):
            yield _stuck(log, joint, "torque", row, "it moves")
        low, high = np.quantile(log.tau[:, j], [0.01, 0.99])
        beside = 0.5 * (log.tau[:-2, j] + log.tau[2:, j])
        off = np.abs(log.tau[1:-1, j] - beside)
        alone = np.abs(log.tau[2:, j] - log.tau[:-2, j]) < 0.2 * off
        k = int(np.argmax(np.where(alone, off, 0.0)))
        if alone[k] and off[k] > _SPIKE * (high - low) > 0.0:
            found = f"its torque is {off[k]:.3g} off in a single row, at t = {log.t[k + 1]:.4g} s"
            yield of_joint("torque-spikes", joint, found, "that row is wrong; leave it out")


def _speeds(log: Log) -> Array:
    """Return speeds (N, n) of raw positions."""
    around = max(1, round(0.5 * _WINDOW / log.period))
    rows = np.arange(len(log.t))
    before = np.maximum(rows - around, 0)
    after = np.minimum(rows + around, len(rows) - 1)
    return np.asarray((log.q[after] - log.q[before]) / (log.t[after] - log.t[before])[:, None])


def _repeated(log: Log, moves: Mask, fine: Mask) -> Iterator[Finding]:
    if not np.any(fine):
        return
    rows = np.any(moves[1:], axis=1)
    if rows.sum() < _STUCK_ROWS:
        return
    same = np.all(np.diff(log.tau[:, fine], axis=0) == 0.0, axis=1)
    share = float(np.mean(same[rows]))
    if share > _HELD:
        found = f"{100 * share:.0f} % of the rows in motion repeat the torques of the row before"
        remedy = "the log is faster than the robot's data; log at the robot's own rate"
        yield of_joint("held-samples", "", found, remedy, "warning")


def _stands_still(log: Log, values: Array, moves: Mask) -> int | None:
    edges = np.flatnonzero(np.diff(np.r_[False, np.diff(values) == 0.0, False].astype(int)))
    starts = edges[::2]
    lengths = edges[1::2] - edges[::2]
    if not len(starts):
        return None
    k = int(np.argmax(lengths))
    first = int(starts[k])
    last = int(starts[k] + lengths[k])
    usual = float(np.quantile(np.delete(lengths, k), 0.95)) if len(lengths) > 1 else 1.0
    long = last - first >= max(_STUCK_ROWS, _RARE * usual)
    lasts = log.t[last] - log.t[first] > _STUCK
    return first if long and lasts and np.mean(moves[first:last]) > _MOVING else None


def _stuck(log: Log, joint: str, what: str, row: int, while_: str) -> Finding:
    found = f"its {what} is constant from t = {log.t[row]:.4g} s, while {while_}"
    remedy = "the sensor or its connection failed there; cut these rows out"
    return of_joint("stuck", joint, found, remedy)


def check_speed(motion: Motionwise, robot: Robot) -> Iterator[Finding]:
    """Check speeds against the model's limits."""
    limits = np.where(np.isfinite(robot.limits[2]), robot.limits[2], 0.0)
    peaks = np.quantile(np.abs(motion.v), 0.998, axis=0)
    for j in np.flatnonzero(motion.moves & (limits > 0.0)):
        if peaks[j] <= _TOO_FAST * limits[j]:
            continue
        unit = "m/s" if robot.slides[j] else "rad/s"
        times = f"{peaks[j] / limits[j]:.2g} times the model's limit"
        found = f"it reaches {peaks[j]:.3g} {unit}, {times}"
        remedy = "the time stamps come from a wrong sample rate, a unit is wrong, or the model's "
        yield of_joint("speed-limit", robot.joints[j], found, f"{remedy}limits are", "warning")
