"""Mistakes to plant in a correct log, one at a time, and what decides whether it can tell."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.health.evidence import ModelTorques, SmoothPart, friction_shape, smooth_parts
from hesr_model.health.referee import LeftOutRows, Race
from hesr_model.logs.rest import find_travelling
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

Array = np.ndarray
DEGREE = np.pi / 180.0
RPM = np.pi / 30.0
Rows = dict[str, Array]


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """A mistake of one joint, the next one or all.

    Attributes
    ----------
    plant : returns the log with the mistake, for a joint and the next one.
    checks : findings any of which names it.
    reading : which rows tell it: velocity, torque, or none if the rows themselves show it.
    joints : joints that the mistake needs.
    of_columns : whether it is one of the columns of a file: units, gears and zeros stay with their
        places.
    of_angles : whether only rotary joints can have it.
    """

    plant: Callable[[Log, int, int], Log]
    checks: tuple[str, ...]
    reading: str = "rows"
    joints: int = 1
    of_columns: bool = False
    of_angles: bool = False

    def apply(self, log: Log, j: int, robot: Robot) -> Log:
        """Return a log with the mistake at a joint, and at the next one if it needs two."""
        k = min(j + 1, robot.n - 1)
        description = robot.description
        if self.of_columns:
            spoilt = from_columns(self.plant(to_columns(log, description), j, k), description)
        else:
            spoilt = self.plant(log, j, k)
        slides = np.array(robot.slides)
        if not (self.of_angles and slides.any()):
            return spoilt
        dq = spoilt.dq
        return replace(
            spoilt,
            q=np.where(slides, log.q, spoilt.q),
            dq=None if dq is None else np.where(slides, log.dq, dq),
        )


def to_columns(log: Log, description: RobotDescription) -> Log:
    """Return a log with signals as the columns of a file have them."""
    return _convert(log, description, np.linalg.inv)


def from_columns(log: Log, description: RobotDescription) -> Log:
    """Return a log in SI at joints from one with signals as columns."""
    return _convert(log, description, np.asarray)


def _convert(log: Log, description: RobotDescription, turn: Callable[[Array], Array]) -> Log:
    """Convert signals by matrices that read columns, or by what `turn` makes of them."""
    n = len(description.joints)
    units = description.log.units
    transmission = description.transmission
    motors = np.eye(n)
    if transmission is not None and transmission.logs == "motor":
        motors = np.array(transmission.matrix)
    gains = description.log.torque_per_ampere
    torque_units = units.factors("tau" if gains is None else "current", n)
    torque_units = torque_units * (1.0 if gains is None else np.array(gains))
    read_q, read_dq = (
        turn(np.linalg.solve(motors, np.diag(units.factors(quantity, n)))).T
        for quantity in ("q", "dq")
    )
    read_tau = turn(motors.T * torque_units).T
    zero = np.array(description.log.zero or np.zeros(n))
    before, after = (zero, 0.0) if turn is np.linalg.inv else (0.0, zero)
    return replace(
        log,
        q=(log.q - before) @ read_q + after,
        dq=None if log.dq is None else log.dq @ read_dq,
        tau=log.tau @ read_tau,
    )


def scale(values: Array | None, j: int, factor: float) -> Array | None:
    """Return signals (N, n) with one column scaled."""
    if values is None:
        return None
    changed = values.copy()
    changed[:, j] *= factor
    return changed


def swap(values: Array | None, j: int, k: int) -> Array | None:
    """Return signals (N, n) with two columns swapped."""
    if values is None:
        return None
    changed = values.copy()
    changed[:, [j, k]] = changed[:, [k, j]]
    return changed


def multiply(values: Array | None, factor: float) -> Array | None:
    """Return signals (N, n) in another unit."""
    return None if values is None else values * factor


def delay(values: Array | None, seconds: float, t: Array) -> Array | None:
    """Return signals (N, n) that come late [s]."""
    if values is None:
        return None
    return np.column_stack([np.interp(t - seconds, t, column) for column in values.T])


def put(values: Array | None, rows: object, j: object, value: object) -> Array | None:
    """Return signals (N, n) with other values in some rows."""
    if values is None:
        return None
    changed = values.copy()
    changed[rows, j] = value
    return changed


def hold(values: Array | None, j: int) -> Array | None:
    """Return signals (N, n), one of which is stuck for a fifth of the log."""
    if values is None:
        return None
    first = len(values) // 2
    return put(values, slice(first, first + len(values) // 5), j, values[first, j])


def repeat(log: Log, count: int) -> Log:
    """Return a log whose torques come at a lower rate."""
    rows = np.repeat(np.arange(0, len(log.t), count), count)[: len(log.t)]
    return replace(log, tau=log.tau[rows])


def _spoil(**changes: Callable[[Log, int, int], Array | None]) -> Callable[[Log, int, int], Log]:
    def plant(log: Log, j: int, k: int) -> Log:
        return replace(log, **{key: change(log, j, k) for key, change in changes.items()})

    return plant


def _move_middle(values: Array | None, j: int, share: float) -> Array | None:
    """Return signals (N, n), of which one is off in the middle row by a share of its range."""
    if values is None:
        return None
    middle = len(values) // 2
    return put(values, middle, j, values[middle, j] + share * np.ptp(values[:, j]))


VELOCITY = ("velocity-scale", "velocity-match", "velocity-columns", "velocity-sign")
SIGN = ("torque-sign", "position-sign", "gravity-sign", "zero", "gravity")
SCALE = ("torque-scale", "torque-limit", "torque-small")
MISTAKES: dict[str, Mistake] = {
    "q in degrees": Mistake(
        plant=_spoil(q=lambda log, j, k: log.q / DEGREE), checks=("limits", *VELOCITY),
        reading="velocity", of_angles=True, of_columns=True,
    ),
    "q and dq in degrees": Mistake(
        plant=_spoil(
            q=lambda log, j, k: log.q / DEGREE, dq=lambda log, j, k: multiply(log.dq, 1 / DEGREE)
        ),
        checks=("limits", "speed-limit", "wrap", "angle-unit", *SCALE), reading="torque",
        of_angles=True, of_columns=True,
    ),
    "dq in rpm": Mistake(
        plant=_spoil(dq=lambda log, j, k: multiply(log.dq, 1 / RPM)), checks=VELOCITY,
        reading="velocity",
    ),
    "dq of the motor": Mistake(
        plant=_spoil(dq=lambda log, j, k: scale(log.dq, j, 100.0)), checks=VELOCITY,
        reading="velocity",
    ),
    "dq backwards": Mistake(
        plant=_spoil(dq=lambda log, j, k: scale(log.dq, j, -1.0)), checks=VELOCITY,
        reading="velocity",
    ),
    "dq columns swapped": Mistake(
        plant=_spoil(dq=lambda log, j, k: swap(log.dq, j, k)), checks=VELOCITY,
        reading="velocity", joints=2, of_columns=True,
    ),
    "dq late": Mistake(
        plant=_spoil(dq=lambda log, j, k: delay(log.dq, 0.15, log.t)),
        checks=("velocity-lag", "velocity-match"), reading="velocity",
    ),
    "dq of nothing": Mistake(
        plant=_spoil(dq=lambda log, j, k: multiply(log.dq, 0.0)),
        checks=("velocity-constant", "velocity-match"), reading="velocity",
    ),
    "another rate, with dq": Mistake(
        plant=_spoil(t=lambda log, j, k: 2.0 * log.t), checks=VELOCITY, reading="velocity"
    ),
    "another rate, without dq": Mistake(
        plant=lambda log, j, k: replace(log, t=0.5 * log.t, dq=None),
        checks=("time-scale", "speed-limit"), reading="torque",
    ),
    "t in milliseconds": Mistake(
        plant=_spoil(t=lambda log, j, k: 1e3 * log.t), checks=("time-unit", "velocity-scale")
    ),
    "torque backwards": Mistake(
        plant=_spoil(tau=lambda log, j, k: scale(log.tau, j, -1.0)), checks=SIGN,
        reading="torque", of_columns=True,
    ),
    "all torques backwards": Mistake(
        plant=_spoil(tau=lambda log, j, k: -log.tau), checks=SIGN, reading="torque"
    ),
    "joint backwards": Mistake(
        plant=_spoil(
            q=lambda log, j, k: scale(log.q, j, -1.0), dq=lambda log, j, k: scale(log.dq, j, -1.0)
        ),
        checks=(*SIGN, "limits"), reading="torque", of_columns=True,
    ),
    "all of a joint backwards": Mistake(
        plant=_spoil(
            q=lambda log, j, k: scale(log.q, j, -1.0),
            dq=lambda log, j, k: scale(log.dq, j, -1.0),
            tau=lambda log, j, k: scale(log.tau, j, -1.0),
        ),
        checks=(*SIGN, "limits"), reading="torque", of_columns=True,
    ),
    "torque a hundredth": Mistake(
        plant=_spoil(tau=lambda log, j, k: scale(log.tau, j, 0.01)), checks=SCALE,
        reading="scale",
    ),
    "currents as torques": Mistake(
        plant=_spoil(tau=lambda log, j, k: log.tau / 12.0), checks=SCALE, reading="scale"
    ),
    "torque in mN.m": Mistake(
        plant=_spoil(tau=lambda log, j, k: 1e3 * log.tau), checks=SCALE, reading="scale"
    ),
    "torques swapped": Mistake(
        plant=_spoil(tau=lambda log, j, k: swap(log.tau, j, k)),
        checks=("torque-columns", "torque-signal", *SIGN, *SCALE), reading="torque", joints=2,
        of_columns=True,
    ),
    "joints swapped": Mistake(
        plant=_spoil(
            q=lambda log, j, k: swap(log.q, j, k),
            dq=lambda log, j, k: swap(log.dq, j, k),
            tau=lambda log, j, k: swap(log.tau, j, k),
        ),
        checks=("joint-order", "torque-signal", "limits", *SIGN, *SCALE), reading="torque",
        joints=2, of_columns=True,
    ),
    "joints from tip to base": Mistake(
        plant=_spoil(
            q=lambda log, j, k: log.q[:, ::-1],
            dq=lambda log, j, k: None if log.dq is None else log.dq[:, ::-1],
            tau=lambda log, j, k: log.tau[:, ::-1],
        ),
        checks=("joint-order", "torque-signal", "limits", *SIGN, *SCALE), reading="torque",
        joints=2, of_columns=True,
    ),
    "a zero a quarter turn off": Mistake(
        plant=_spoil(q=lambda log, j, k: put(log.q, slice(None), j, log.q[:, j] + np.pi / 2)),
        checks=("zero", "limits", "joint-order", *SIGN, *SCALE), reading="torque",
        of_angles=True,
    ),
    "one torque for two joints": Mistake(
        plant=_spoil(tau=lambda log, j, k: put(log.tau, slice(None), k, log.tau[:, j])),
        checks=("same-column",), joints=2,
    ),
    "a torque that never changes": Mistake(
        plant=_spoil(tau=lambda log, j, k: put(log.tau, slice(None), j, 3.0)),
        checks=("torque-constant",),
    ),
    "angles that wrap": Mistake(
        plant=_spoil(q=lambda log, j, k: np.mod(log.q - np.median(log.q, axis=0), 2 * np.pi)),
        checks=("wrap", "spikes"), of_angles=True,
    ),
    "a row far off": Mistake(
        plant=_spoil(
            q=lambda log, j, k: _move_middle(log.q, j, 0.5)
        ),
        checks=("spikes",),
    ),
    "torque cut off": Mistake(
        plant=_spoil(
            tau=lambda log, j, k: np.clip(log.tau, *np.quantile(log.tau, [0.1, 0.9], axis=0))
        ),
        checks=("saturation",),
    ),
    "torques late": Mistake(
        plant=_spoil(tau=lambda log, j, k: delay(log.tau, 0.15, log.t)), checks=("torque-lag",),
        reading="torque",
    ),
    "a stuck encoder": Mistake(
        plant=_spoil(q=lambda log, j, k: hold(log.q, j)),
        checks=("stuck", "spikes", "velocity-match"),
    ),
    "a stuck torque sensor": Mistake(
        plant=_spoil(tau=lambda log, j, k: hold(log.tau, j)), checks=("stuck",)
    ),
    "torques at another rate": Mistake(
        plant=lambda log, j, k: repeat(log, 5), checks=("held-samples",)
    ),
    "a torque far off": Mistake(
        plant=_spoil(
            tau=lambda log, j, k: _move_middle(log.tau, j, 10.0)
        ),
        checks=("torque-spikes",),
    ),
    "rounded positions": Mistake(
        plant=_spoil(
            q=lambda log, j, k: np.ptp(log.q[:, j]) / 60
            * np.round(log.q * 60 / np.ptp(log.q[:, j]))
        ),
        checks=("coarse",),
    ),
    "missing rows": Mistake(
        plant=lambda log, j, k: log.rows(np.random.default_rng(0).random(len(log.t)) > 0.3),
        checks=("missing-rows",),
    ),
}  # fmt: skip


def _join(parts: list[SmoothPart], key: str) -> Array:
    return np.concatenate([getattr(part, key) for part in parts])


def can_tell(mistake: Mistake, log: Log, spoilt: Log, j: int, robot: Robot) -> bool:
    """Return whether the true reading beats the planted one by three errors on left-out rows.

    It does so at any joint that the mistake concerns, or by the torques of all joints together,
    since gravity and inertia of other joints depend on a position as well.

    Parameters
    ----------
    mistake : that was planted.
    log, spoilt : without and with it.
    j : index of its joint.
    robot : with the model of the bodies.
    """
    joints = range(j, min(j + mistake.joints, robot.n))
    if any(_can_joint_tell(mistake, log, spoilt, number, robot) for number in joints):
        return True
    return mistake.reading in ("torque", "scale") and _can_all_joints_tell(
        mistake, log, spoilt, robot
    )


def _can_all_joints_tell(mistake: Mistake, log: Log, spoilt: Log, robot: Robot) -> bool:
    fixes_scale = mistake.reading == "scale"
    if fixes_scale and robot.description.known is not None:
        return False  # the model's body is a placeholder
    moving_joints = np.flatnonzero(find_travelling([log.q]) & (np.ptp(log.tau, axis=0) > 0.0))
    totals = []
    for each in (log, spoilt):
        parts = smooth_parts(each, robot.description.log.filter_cutoff)
        left_out = LeftOutRows.split([log.name] * len(parts), [part.t for part in parts])
        totals.append(
            sum(
                _predict_torque(parts, robot, int(j), left_out, fixes_scale=fixes_scale)
                for j in moving_joints
            )
        )
    squares, rival_squares = totals
    race = Race(rival="the planted one", rival_squares=rival_squares, squares=squares, min_gain=0.1)
    return race.outcome == "won"


def _can_joint_tell(mistake: Mistake, log: Log, spoilt: Log, j: int, robot: Robot) -> bool:
    if mistake.reading == "rows":
        return True
    if mistake.reading == "scale" and robot.description.known is not None:
        return False  # the model's body is a placeholder
    if _exceeds_limits(spoilt, robot) and not _exceeds_limits(log, robot):
        return True
    cutoff = robot.description.log.filter_cutoff
    true_parts = smooth_parts(log, cutoff)
    spoilt_parts = smooth_parts(spoilt, cutoff)
    left_out = LeftOutRows.split([log.name] * len(true_parts), [part.t for part in true_parts])
    if mistake.reading == "velocity":
        if log.dq is None:
            return False
        squares, rival_squares = (
            (_join(parts, "v")[:, j] - _join(parts, "dq")[:, j]) ** 2
            / np.mean(_join(parts, "v")[:, j] ** 2)
            for parts in (true_parts, spoilt_parts)
        )
    else:
        fixes_scale = mistake.reading == "scale"
        squares, rival_squares = (
            _predict_torque(parts, robot, j, left_out, fixes_scale=fixes_scale)
            for parts in (true_parts, spoilt_parts)
        )
    race = Race(rival="the planted one", rival_squares=rival_squares, squares=squares, min_gain=0.1)
    return race.outcome == "won"


def _exceeds_limits(log: Log, robot: Robot) -> bool:
    """Return whether a position lies beyond the model's limits by more than their width."""
    lower, upper, _ = robot.limits
    excess = np.maximum(lower - log.q.min(axis=0), log.q.max(axis=0) - upper)
    return bool(np.any(excess > upper - lower))


def _predict_torque(
    parts: list[SmoothPart], robot: Robot, j: int, left_out: LeftOutRows, *, fixes_scale: bool
) -> Array:
    """Return squared errors (N,) of a torque over its variance; a scale is that of the model."""
    torques = [ModelTorques.from_motion(robot, part.q, part.v, part.a) for part in parts]
    gravity = np.concatenate([each.gravity[:, j] for each in torques])
    inertial = np.concatenate([each.inertial[:, j] for each in torques])
    v = _join(parts, "v")[:, j]
    target = _join(parts, "tau")[:, j]
    friction = [friction_shape(v), v, np.ones_like(v)]
    if fixes_scale:
        columns = np.column_stack([inertial, *friction])
        errors = left_out.predict(columns, target - gravity - inertial, non_negative=2)
    else:
        columns = np.column_stack([gravity, inertial, *friction])
        errors = left_out.predict(columns, target, non_negative=3)
    return np.asarray(errors**2 / np.var(target))
