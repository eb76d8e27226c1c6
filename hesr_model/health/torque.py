"""Torque against motion and against the model: signs, scales, delay, signal.

All tests are of one joint in one log, by least squares on the model file's gravity and inertial
torque and on friction's shape; standard errors take into account that neighbouring rows are alike.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from hesr_model.health.evidence import JointTorque, Motionwise, Torques, explain, rubbing
from hesr_model.health.findings import Finding
from hesr_model.robots.robot import RobotDescription, RobotModel

Array = NDArray[np.float64]

_SURE = 5.0
"""Standard errors from which on a sign is none of chance."""
_SCALE = 3.0
"""Gravity of real arms is .6 to 1.5 times that of their model files where it is well seen."""
_EXPLAINED = 0.8
"""R^2 from which on a scale is one."""
_NO_SIGNAL = 0.35
"""R^2 below which model and friction together explain next to nothing."""
_LATEST, _LATE = 0.2, 0.06
"""[s] Delays of the torque that are tried, and told; friction's own memory looks like 30 to
50 ms.
"""
_SHARPER = 0.75
"""By which what is unexplained must fall when the torque is moved."""
_ABOVE_LIMIT, _BELOW_OTHERS = 10.0, 30.0
"""Times a model's torque limit, and times less of it than the other joints use."""

Explained = Mapping[int, JointTorque]
"""What explains the torque of each joint that moves, by its index."""


def explained(motion: Motionwise, torques: Torques) -> Explained:
    """Explain the torque of every joint that moves in a part of a log."""
    return {
        int(j): explain(
            motion.tau[:, j], torques.gravity[:, j], torques.inertial[:, j], motion.v[:, j]
        )
        for j in np.flatnonzero(motion.moves & (np.ptp(motion.tau, axis=0) > 0.0))
    }


def check_torque(
    motion: Motionwise, torques: Torques, found: Explained, model: RobotModel
) -> Iterator[Finding]:
    """Check the torques of one part of a log."""
    logs = (motion.log.name,)
    late = list(_late(motion, torques, found, logs))
    yield from late
    for j, fit in found.items():
        yield from _sign(fit, j, model, logs)
        if not late:
            yield from _scale(fit, j, found, model, logs)
        if fit.r2 < _NO_SIGNAL:
            levels = len(np.unique(motion.tau[:, j]))
            yield Finding(
                check="torque-signal", severity="warning", joints=(model.description.joints[j],),
                logs=logs,
                found=f"model and friction explain {100 * max(fit.r2, 0):.0f} % of its torque, "
                "which "
                f"takes {levels} values",
                cause="it holds almost no signal, or is of another joint; what is fitted to it "
                "means "
                "nothing",
            )  # fmt: skip
    yield from _against_limits(motion, found, model, logs)


def _sign(fit: JointTorque, j: int, model: RobotModel, logs: tuple[str, ...]) -> Iterator[Finding]:
    """Check that the joint's torque takes energy out of its motion."""
    if fit.friction.t > -_SURE or fit.friction_size < 0.3 * fit.residual:
        return
    robot = model.description
    follows = fit.bears_gravity and fit.gravity.t > _SURE
    what = "position and velocity count" if follows else "torque counts"
    key, changes = sign_change(robot, j, position=follows)
    beside = "" if fit.bears_gravity else ", or its position and velocity do"
    yield Finding(
        check="torque-sign", severity="refusal", joints=(robot.joints[j],), logs=logs,
        found="its torque drives the motion where friction should brake it "
        f"({fit.friction.value:.3g} {_unit(model, j)} along the velocity, "
        f"{abs(fit.friction.t):.0f} "
        "standard errors)",
        cause=f"its {what} backwards{beside}; set {key}",
        changes=changes,
    )  # fmt: skip


def sign_change(
    robot: RobotDescription, j: int, *, position: bool
) -> tuple[str, dict[str, object]]:
    """Return how a joint's torque, or its position, is turned around: in words, and by key."""
    n = len(robot.joints)

    def turned(key: str) -> tuple[str | float, ...]:
        units = list(robot.log.units.each(key, n))
        unit = units[j]
        minus = unit[1:] if isinstance(unit, str) and unit.startswith("-") else f"-{unit}"
        units[j] = minus if isinstance(unit, str) else -unit
        return tuple(units)

    if position:
        changes: dict[str, object] = {f"log.units.{k}": turned(k) for k in ("q", "dq")}
        return f"[log.units] q and dq of it with a '-', as '{turned('q')[j]}'", changes
    gains = robot.log.torque_per_ampere
    if gains is None:
        return f"[log.units] tau of it to '{turned('tau')[j]}'", {"log.units.tau": turned("tau")}
    mended = tuple(-gain if k == j else gain for k, gain in enumerate(gains))
    return f"its torque_per_ampere to {mended[j]:g}", {"log.torque_per_ampere": mended}


def _scale(
    fit: JointTorque, j: int, found: Explained, model: RobotModel, logs: tuple[str, ...]
) -> Iterator[Finding]:
    """Check the size of the torque against the model's gravity, or inertia on a joint without."""
    if fit.r2 < _EXPLAINED:
        return
    if abs(fit.gravity.t) > _SURE and (fit.bears_gravity or _far_too_large(fit)):
        scale, margin, of = abs(fit.gravity.value), _SURE * fit.gravity.error, "gravity"
    else:
        scale, margin, of = fit.inertia.value, _SURE * fit.inertia.error, "inertia"
    too_small = scale + margin < 1.0 / _SCALE
    too_large = of == "gravity" and scale - margin > _SCALE
    # A rotor may outweigh the links many times, but never makes the inertia less.
    if not (too_small or too_large) or not np.isfinite(margin):
        return
    robot = model.description
    bearing = [f for f in found.values() if f.bears_gravity]
    everywhere = len(bearing) > 1 and all(
        abs(f.gravity.value) < 1 / _SCALE or abs(f.gravity.value) > _SCALE for f in bearing
    )
    yield Finding(
        check="torque-scale", severity="refusal", joints=(robot.joints[j],), logs=logs,
        found=f"its torque is {max(scale, 0.0):.2g} times what the model's {of} takes",
        cause=_why_scaled(robot, scale, everywhere=everywhere),
    )  # fmt: skip


def _far_too_large(fit: JointTorque) -> bool:
    """Whether a gravity that is hardly seen is surely more than any model's error."""
    return fit.gravity_size > 1e-3 and fit.gravity.value - _SURE * fit.gravity.error > 10.0


def _why_scaled(robot: RobotDescription, scale: float, *, everywhere: bool) -> str:
    gains = robot.log.torque_per_ampere
    if gains is not None:
        if scale <= 0:
            return "its torque_per_ampere is far too small, or the column holds another signal"
        off = max(scale, 1.0 / scale)
        about = round(off, 1 - len(str(int(off))))
        way = "small" if scale < 1 else "large"
        return f"its torque_per_ampere is about {about:g} times too {way}"
    if scale > 100:
        return "torque is in mN.m; set [log.units] tau = 'mN.m'"
    gear = robot.gear_ratio and float(np.median(robot.gear_ratio))
    if gear and 1 / _SCALE < scale * gear < _SCALE:
        return f"it is the motor's torque, before the gear; set [log.units] tau = {gear:g}"
    if everywhere and scale < 1:
        return (
            "the column holds currents [A], or torques of the motors; name it under [log.columns] "
            "current and give torque_per_ampere"
        )
    return "the unit of the torque is wrong, or the column holds a current; see [log.units] tau"


def _late(
    motion: Motionwise, torques: Torques, found: Explained, logs: tuple[str, ...]
) -> Iterator[Finding]:
    """Check that all torques together are not sharper explained some time earlier or later."""
    period = float(np.median(np.diff(motion.t)))
    most = int(_LATEST / period)
    step = max(1, int(0.02 / period))
    good = [j for j, fit in found.items() if fit.r2 > _NO_SIGNAL]
    if most < step or not good or len(motion.t) < 8 * most:
        return
    inner = slice(most, -most)
    shifts = list(range(-(most // step) * step, most + 1, step))
    residuals = np.array(
        [
            [
                explain_quickly(
                    motion.tau[most + k : len(motion.t) - most + k, j],
                    torques.gravity[inner, j],
                    torques.inertial[inner, j],
                    motion.v[inner, j],
                )
                for k in shifts
            ]
            for j in good
        ]
    )
    sharpest = np.array(shifts)[np.argmin(residuals, axis=1)] * period
    gain = residuals.min(axis=1) / residuals[:, shifts.index(0)]
    if abs(np.median(sharpest)) < _LATE or np.median(gain) > _SHARPER:
        return
    lag = float(np.median(sharpest))
    yield Finding(
        check="torque-lag", severity="warning", logs=logs,
        found=f"torques are about {abs(lag) * 1e3:.0f} ms {'late' if lag > 0 else 'early'} against "
        "the motion",
        cause="they were filtered or come from another clock; move their columns in time",
    )  # fmt: skip


def explain_quickly(tau: Array, gravity: Array, inertial: Array, v: Array) -> float:
    """Return what `explain` leaves of `tau`: of `gravity`, `inertial`, `v`, (N,) [N.m, rad/s]."""
    columns = np.column_stack([gravity, inertial, rubbing(v), np.ones_like(v)])
    x = np.linalg.lstsq(columns, tau, rcond=None)[0]
    return float(np.std(tau - columns @ x))


def _against_limits(
    motion: Motionwise, found: Explained, model: RobotModel, logs: tuple[str, ...]
) -> Iterator[Finding]:
    """Check peaks against the torque limits of the model file, and these against each other."""
    limits = np.where(np.isfinite(model.torque_limits), model.torque_limits, 0.0)
    peaks = np.quantile(np.abs(motion.tau), 0.99, axis=0)
    used = {
        j: float(peaks[j] / limits[j])
        for j in found
        if limits[j] > 0 and not model.tree[j].prismatic
    }
    for j, share in used.items():
        name = model.description.joints[j]
        if share > _ABOVE_LIMIT:
            yield Finding(
                check="torque-limit", severity="refusal", joints=(name,), logs=logs,
                found=f"its torque reaches {peaks[j]:.3g}, {share:.2g} times the model's limit",
                cause="its unit or its torque_per_ampere is wrong",
            )  # fmt: skip
        others = [s for k, s in used.items() if k != j]
        if (
            len(others) > 1
            and share * _BELOW_OTHERS < np.median(others)
            and found[j].r2 > _EXPLAINED
        ):
            yield Finding(
                check="torque-small", severity="warning", joints=(name,), logs=logs,
                found=f"its torque reaches {100 * share:.2g} % of the model's limit, the other "
                "joints' "
                f"{100 * np.median(others):.2g} %",
                cause="its unit or its torque_per_ampere may be wrong",
            )  # fmt: skip


def _unit(model: RobotModel, j: int) -> str:
    return "N" if model.tree[j].prismatic else "N.m"
