"""Torque checks against motion and model: signs, scales, signal."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from hesr_model.findings import Finding, of_joint
from hesr_model.health.evidence import JointTorque, Motionwise, Torques, explain
from hesr_model.health.velocity import listed
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.units import backwards, unit_of_joint

_SURE = 5.0  # significance threshold in standard errors
_SCALE = 3.0  # plausible factor of gravity; real arms have .6 to 1.5
_EXPLAINED = 0.8  # minimum R^2 for a scale estimate
NO_SIGNAL = 0.35  # R^2 below which nothing is explained
_EXACT = 0.1  # residual share of computed torques
_SEEN = 0.5  # gravity over the residual to judge its sign
_WEIGHTLESS = 0.1  # share of the model's gravity in weightless torques
_ABOVE_LIMIT, _BELOW_OTHERS = 10.0, 30.0  # peak over the model's limit, others over own

Explained = Mapping[int, JointTorque]  # by index of the joint


def explained(motion: Motionwise, torques: Torques) -> Explained:
    """Regress the torque of every moving joint."""
    return {
        int(j): explain(
            motion.tau[:, j], torques.gravity[:, j], torques.inertial[:, j], motion.v[:, j]
        )
        for j in np.flatnonzero(motion.moves & (np.ptp(motion.tau, axis=0) > 0.0))
    }


def check_torque(
    motion: Motionwise, found: Explained, model: Robot, blurred: Collection[int] = ()
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
            yield of_joint("torque-signal", model.description.joints[j], what, remedy, "warning")
            continue
        yield from _sign(fit, j, model)
        if j not in blurred:
            yield from _scale(fit, j, found, model)
        if fit.gravity.t < -_SURE and fit.gravity_size > _SEEN * fit.residual:
            yield Finding(
                check="gravity-sign",
                joints=(model.description.joints[j],),
                found="its gravity torque has the opposite sign of the model's "
                f"({fit.gravity.value:.2g} times, {abs(fit.gravity.t):.0f} standard errors)",
                remedy="the mounting differs from 'gravity', its zero is off by half a turn, or "
                "torque or position has the wrong sign",
            )
    yield from _no_friction(found, model)
    yield from _against_limits(motion, found, model)


def _sign(fit: JointTorque, j: int, model: Robot) -> Iterator[Finding]:
    if fit.friction.t > -_SURE or fit.friction_size < 0.3 * fit.residual:
        return
    robot = model.description
    follows = fit.bears_gravity and fit.gravity.t > _SURE
    what = "position and velocity count" if follows else "torque counts"
    key, changes = sign_change(robot, j, position=follows)
    unit = unit_of_joint("N.m", slides=model.slides[j])
    beside = "" if fit.bears_gravity else ", or its position and velocity do"
    found = (
        "its torque drives the motion where friction should brake it "
        f"({fit.friction.value:.3g} {unit} along the velocity, {abs(fit.friction.t):.0f} "
        "standard errors)"
    )
    remedy = f"its {what} backwards{beside}; set {key}"
    yield of_joint("torque-sign", robot.joints[j], found, remedy, changes=changes)


def sign_change(
    robot: RobotDescription, j: int | None, *, position: bool
) -> tuple[str, dict[str, object]]:
    """Return the change that reverses a torque or position; `j` None means all."""
    n = len(robot.joints)

    def turned(key: str) -> tuple[str | float, ...]:
        units = robot.log.units.each(key, n)
        return tuple(backwards(unit) if j in (k, None) else unit for k, unit in enumerate(units))

    first = j or 0
    whose = "" if j is None else " of it"
    if position:
        changes: dict[str, object] = {f"log.units.{k}": turned(k) for k in ("q", "dq")}
        return f"[log.units] q and dq{whose} with a '-', as {turned('q')[first]!r}", changes
    if (gains := robot.log.torque_per_ampere) is None:
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
    if weightless or (abs(fit.gravity.t) > _SURE and (fit.bears_gravity or _far_too_large(fit))):
        scale, margin, of = abs(fit.gravity.value), _SURE * fit.gravity.error, "gravity"
    else:
        scale, margin, of = fit.inertia.value, _SURE * fit.inertia.error, "inertial"
    too_small = scale + margin < 1.0 / _SCALE
    too_large = of == "gravity" and scale - margin > _SCALE
    # A rotor may exceed the links many times, but never reduces the inertia.
    if not (too_small or too_large) or not np.isfinite(margin):
        return
    robot = model.description
    bearing = [f for f in found.values() if f.bears_gravity]
    everywhere = len(bearing) > 1 and all(
        abs(f.gravity.value) < 1 / _SCALE or abs(f.gravity.value) > _SCALE for f in bearing
    )
    remedy, changes = _why_scaled(robot, j, scale, everywhere=everywhere)
    if scale <= _WEIGHTLESS and weightless and abs(fit.inertia.value) >= 1.0 / _SCALE:
        remedy, changes = "gravity was removed from it, a spring or counterweight carries the ", {}
        remedy += "arm, or the file declares another gravity"
    yield Finding(
        check="torque-scale",
        joints=(robot.joints[j],),
        found=f"its torque is {max(scale, 0.0):.2g} (+- {margin:.1g}) times the {of} torque of the "
        "model",
        remedy=remedy,
        changes=changes,
    )


def _far_too_large(fit: JointTorque) -> bool:
    return fit.gravity_size > 1e-3 and fit.gravity.value - _SURE * fit.gravity.error > 10.0


def _why_scaled(
    robot: RobotDescription, j: int, scale: float, *, everywhere: bool
) -> tuple[str, dict[str, object]]:
    if robot.log.torque_per_ampere is not None:
        if scale <= 0:
            return "its torque_per_ampere is far too small, or the column holds another signal", {}
        off = max(scale, 1.0 / scale)
        about = round(off, 1 - len(str(int(off))))
        way = "small" if scale < 1 else "large"
        return f"its torque_per_ampere is about {about:g} times too {way}", {}
    if scale > 100:
        return "torque is in mN.m; set [log.units] tau = 'mN.m'", {"log.units.tau": "mN.m"}
    if (gears := robot.gear_ratio) and 1 / _SCALE < scale * gears[j] < _SCALE:
        what = "it is the motor torque before the gear"
        return f"{what}; set [log.units] tau = {listed(gears)}", {"log.units.tau": gears}
    if everywhere and scale < 1:
        why = "the column contains currents [A] or motor torques; name it under [log.columns] "
        return f"{why}current and give torque_per_ampere", {}
    return (
        "the unit of torque or position is wrong, or the column holds a current; see [log.units]",
        {},
    )


def _no_friction(found: Explained, model: Robot) -> Iterator[Finding]:
    clear = {j: fit for j, fit in found.items() if fit.r2 > _EXPLAINED}
    if not clear or any(
        abs(fit.friction.t) > _SURE or fit.residual > _EXACT * fit.deviation
        for fit in clear.values()
    ):
        return
    yield Finding(
        check="no-friction",
        severity="warning",
        joints=tuple(model.description.joints[j] for j in clear),
        found="the model's rigid body explains their torques completely, and no part follows the "
        "velocity",
        remedy="they were computed or commanded instead of measured, or friction was removed",
    )


def _against_limits(motion: Motionwise, found: Explained, model: Robot) -> Iterator[Finding]:
    limits = np.where(np.isfinite(model.torque_limits), model.torque_limits, 0.0)
    peaks = np.quantile(np.abs(motion.tau), 0.99, axis=0)
    used = {j: float(peaks[j] / limits[j]) for j in found if limits[j] > 0 and not model.slides[j]}
    for j, share in used.items():
        name = model.description.joints[j]
        if share > _ABOVE_LIMIT:
            what = f"its torque reaches {peaks[j]:.3g}, {share:.2g} times the model's limit"
            yield of_joint("torque-limit", name, what, "its unit or its torque_per_ampere is wrong")
        others = [s for k, s in used.items() if k != j]
        if (
            len(others) > 1
            and share * _BELOW_OTHERS < np.median(others)
            and found[j].r2 > _EXPLAINED
        ):
            said = (
                f"its torque reaches {100 * share:.2g} % of the model's limit, the other "
                f"joints' {100 * np.median(others):.2g} %"
            )
            remedy = "its unit or its torque_per_ampere may be wrong"
            yield of_joint("torque-small", name, said, remedy, "warning")
