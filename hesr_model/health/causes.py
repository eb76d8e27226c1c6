"""Which mistake in a robot file explains the torques better than the file as it is.

A mistake is a hypothesis: logs are taken as they would be without it, and the model file's rigid
body with friction that brakes is fitted to their torques. Only physical signs are allowed (gravity,
inertia and friction of no negative weight), so that wrong signs and swapped columns explain badly.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hesr_model.friction.fitting.samples import non_negative_least_squares
from hesr_model.health.evidence import Motionwise, Torques, rubbing
from hesr_model.health.findings import Finding
from hesr_model.health.torque import sign_change
from hesr_model.logs.log_format import column_names
from hesr_model.robots.robot import RobotModel
from hesr_model.robots.transmission import onto

Array = NDArray[np.float64]

_ROWS = 450
"""Of all logs together that hypotheses are tried on."""
_BETTER = 2.0
"""Factor by which a mistake's mend must lessen what is unexplained on the joint it helps most."""
_NO_WORSE = 1.25
"""Factor by which it may grow on any other."""
_EXPLAINED = 0.6
"""R^2 that the mend must reach where it helps."""
_CLEARLY = 1.05
"""Factor by which a mistake must explain more than a simpler one."""
_MOST = 8
"""Mistakes that are looked for at a time."""
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SNAP = np.radians(12.0)
_TILTED = np.radians(20.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Rows of several logs: q, v, a, tau, (N, n) each [rad, rad/s, rad/s2, N.m], and the gravity.

    Torques are those that were logged, of motors where logs are of these, divided by the gears.

    Attributes
    ----------
    gravity
        (3,) [m/s2].
    """

    q: Array
    v: Array
    a: Array
    tau: Array
    gravity: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Mistake:
    """A hypothesis: what would be wrong, at which joint, and the rows `mended`."""

    check: str
    joint: int
    cause: str
    changes: dict[str, object]
    mended: Rows


def pooled(motions: Sequence[Motionwise], gravity: Sequence[float]) -> Rows:
    """Take rows (N, n) from all logs, as many from each; gravity is in [m/s2]."""
    each = [motion.thinned(max(_ROWS // len(motions), 60)) for motion in motions]
    q, v, a, tau = (
        np.concatenate([getattr(motion, name) for motion in each])
        for name in ("q", "v", "a", "tau")
    )
    return Rows(q=q, v=v, a=a, tau=tau, gravity=np.array(gravity, dtype=float))


def check_causes(motions: Sequence[Motionwise], model: RobotModel) -> list[Finding]:
    """Look for the mistakes that explain all logs together better, the best one first."""
    if not motions:
        return []
    moves = np.any([motion.moves for motion in motions], axis=0)
    moves &= np.any([np.ptp(motion.tau, axis=0) > 0.0 for motion in motions], axis=0)
    rows = pooled(motions, model.description.gravity)
    logged = model.description.logged
    rows = replace(rows, tau=logged.torque(rows.tau)) if logged else rows
    logs = tuple(dict.fromkeys(motion.log.name for motion in motions))
    findings: list[Finding] = []
    now = _unexplained(rows, model, moves)
    for _ in range(_MOST):
        best, left = _best(rows, now, model, moves)
        if best is None:
            break
        helped = int(np.argmax(now / left))
        findings.append(
            Finding(
                check=best.check,
                severity="refusal",
                joints=(model.description.joints[best.joint],) if best.joint >= 0 else (),
                logs=logs,
                found=f"model and friction leave {100 * now[helped]:.0f} % of the torque of joint "
                f"'{model.description.joints[helped]}' unexplained, and {100 * left[helped]:.0f} % "
                "once this is mended",
                cause=best.cause,
                changes=best.changes,
            )
        )
        rows, now = best.mended, left
    return findings


def _best(
    rows: Rows, now: Array, model: RobotModel, moves: NDArray[np.bool_]
) -> tuple[Mistake | None, Array]:
    """Return the mistake whose mend explains most, and what it leaves; None where none helps."""
    best, left, most = None, now, 0.0
    for mistake in _mistakes(rows, model, moves):
        then = _unexplained(mistake.mended, model, moves)
        gain = np.log(now / then)
        good = (gain > np.log(_BETTER)) & (1.0 - then**2 > _EXPLAINED)
        if not np.any(good) or np.min(gain) < -np.log(_NO_WORSE):
            continue
        if float(gain.sum()) > most * _CLEARLY:
            best, left, most = mistake, then, float(gain.sum())
        elif best and best.joint == mistake.joint and float(gain.sum()) * _CLEARLY > most:
            best = replace(best, cause=_either(best))
    return best, left


def _either(best: Mistake) -> str:
    """Say of a sign that the logs do not tell which of both it is."""
    if best.check != "torque-sign":
        return best.cause
    return best.cause.replace(
        "its torque counts backwards;",
        "its torque counts backwards, or its position and velocity do, which the logs do not tell;",
    )


def _unexplained(rows: Rows, model: RobotModel, moves: NDArray[np.bool_]) -> Array:
    """Deviation (n,) of the torques from what they can be, over their own; 1 at rest."""
    torques, logged = _torques(rows, model), model.description.logged
    v = onto(logged, rows.v)
    if logged:
        torques = Torques(
            gravity=logged.torque(torques.gravity), inertial=logged.torque(torques.inertial)
        )
    left = np.ones(rows.q.shape[1])
    for j in np.flatnonzero(moves):
        deviation = float(np.std(rows.tau[:, j]))
        left[j] = _left(rows.tau[:, j], torques, v, int(j)) / max(deviation, 1e-12)
    return left


def _left(tau: Array, torques: Torques, v: Array, j: int) -> float:
    columns = np.column_stack(
        [torques.gravity[:, j], torques.inertial[:, j], rubbing(v[:, j]), np.ones(len(tau))]
    )
    _, squares = non_negative_least_squares(columns, tau, non_negative=3)
    return float(np.sqrt(max(squares, 0.0) / len(tau))) + 1e-9


def _torques(rows: Rows, model: RobotModel) -> Torques:
    """Evaluate the model under the gravity of the rows."""
    torques = Torques.of(model, rows.q, rows.v, rows.a)
    declared = np.array(model.description.gravity)
    if np.array_equal(declared, rows.gravity):
        return torques
    gravity = np.einsum("kij,k->ij", _by_axis(rows.q, model), rows.gravity)
    return replace(torques, gravity=gravity - gravity.mean(axis=0))


def _by_axis(q: Array, model: RobotModel) -> Array:
    """Gravity torque (3, N, n) per unit of gravity [N.m / (m/s2)] along each axis of the base."""
    nothing = np.zeros_like(q)
    with model.under_gravity() as set_gravity:
        parts = []
        for axis in _AXES.values():
            set_gravity(axis)
            parts.append(model.torque(model.nominal_parameters, q, nothing, nothing))
    return np.array(parts)


def _mistakes(rows: Rows, model: RobotModel, moves: NDArray[np.bool_]) -> Iterator[Mistake]:
    """Yield what may be wrong, the simplest first."""
    robot, joints = model.description, [int(j) for j in np.flatnonzero(moves)]
    for j in joints:
        key, changes = sign_change(robot, j, position=False)
        tau = rows.tau.copy()
        tau[:, j] *= -1.0
        yield Mistake(
            check="torque-sign", joint=j, cause=f"its torque counts backwards; set {key}",
            changes=changes, mended=replace(rows, tau=tau),
        )  # fmt: skip
        key, changes = sign_change(robot, j, position=True)
        q, v, a = rows.q.copy(), rows.v.copy(), rows.a.copy()
        for part in (q, v, a):
            part[:, j] *= -1.0
        yield Mistake(
            check="position-sign", joint=j,
            cause=f"its position and velocity count backwards; set {key}",
            changes=changes, mended=replace(rows, q=q, v=v, a=a),
        )  # fmt: skip
    for mend in (_swapped_torques, _swapped_joints, _gravity, _moved_zeros):
        yield from mend(rows, model, joints)


def _swapped_torques(rows: Rows, model: RobotModel, joints: list[int]) -> Iterator[Mistake]:
    robot = model.description
    which = "tau" if robot.log.torque_per_ampere is None else "current"
    columns = column_names(getattr(robot.log.columns, which), robot.joints)
    gains = np.array(robot.log.torque_per_ampere or np.ones(model.n))
    for a, b in combinations(joints, 2):
        order = _exchanged(model.n, a, b)
        named = tuple(columns[k] for k in order)
        yield Mistake(
            check="torque-columns", joint=a,
            cause=f"its torque stands in the column of joint '{robot.joints[b]}', and that one's "
            "in "
            f"its; set [log.columns] {which} = {_quoted(named)}",
            changes={f"log.columns.{which}": named},
            mended=replace(rows, tau=rows.tau[:, order] / gains[order] * gains),
        )  # fmt: skip


def _swapped_joints(rows: Rows, model: RobotModel, joints: list[int]) -> Iterator[Mistake]:
    robot = model.description
    orders = {(a, b): _exchanged(model.n, a, b) for a, b in combinations(joints, 2)}
    if len(joints) == model.n > 2:
        orders[-1, -1] = list(reversed(range(model.n)))
    for (a, b), order in orders.items():
        changes = {
            f"log.columns.{key}": tuple(column_names(columns, robot.joints)[k] for k in order)
            for key, columns in robot.log.columns
            if key != "t" and columns
        }
        what = (
            "all columns stand in the order from tip to base"
            if a < 0
            else f"its columns are those of joint '{robot.joints[b]}', and the other way"
        )
        yield Mistake(
            check="joint-order", joint=a,
            cause=f"{what}; set [log.columns] q = {_quoted(changes['log.columns.q'])}, and the "
            "others alike",
            changes=dict(changes),
            mended=replace(rows, **{k: getattr(rows, k)[:, order] for k in ("q", "v", "a", "tau")}),
        )  # fmt: skip


def _moved_zeros(rows: Rows, model: RobotModel, joints: list[int]) -> Iterator[Mistake]:
    robot = model.description
    for j in joints:
        if model.tree[j].prismatic:
            continue
        for quarter in (1, -1, 2):
            zero = list(robot.log.zero or (0.0,) * model.n)
            zero[j] += quarter * np.pi / 2.0
            q = rows.q.copy()
            q[:, j] += quarter * np.pi / 2.0
            yield Mistake(
                check="zero", joint=j,
                cause=f"its zero is {90 * quarter} degrees from the model's; set [log] zero = "
                f"[{', '.join(f'{z:.6g}' for z in zero)}]",
                changes={"log.zero": tuple(zero)}, mended=replace(rows, q=q),
            )  # fmt: skip


def _gravity(rows: Rows, model: RobotModel, joints: list[int]) -> Iterator[Mistake]:
    """Yield the gravity that the torques show, where it points elsewhere than the robot file's."""
    by_axis, torques = _by_axis(rows.q, model), _torques(rows, model)
    rows_of, targets = [], []
    for place, j in enumerate(joints):
        own = np.zeros((len(rows.q), 3 * len(joints)))
        own[:, 3 * place : 3 * place + 3] = np.column_stack(
            [torques.inertial[:, j], rubbing(rows.v[:, j]), np.ones(len(rows.q))]
        )
        weight = max(_left(rows.tau[:, j], torques, rows.v, j), 1e-9)
        rows_of.append(np.hstack([by_axis[:, :, j].T, own]) / weight)
        targets.append(rows.tau[:, j] / weight)
    found = np.linalg.lstsq(np.concatenate(rows_of), np.concatenate(targets), rcond=None)[0][:3]
    declared = np.array(model.description.gravity)
    size = float(np.linalg.norm(declared))
    if not np.linalg.norm(found) > 0.2 * size or size == 0.0:
        return
    way = found / np.linalg.norm(found)
    for axis in _AXES.values():
        for sign in (1.0, -1.0):
            if way @ np.array(axis) * sign > np.cos(_SNAP):
                way = sign * np.array(axis)
    if way @ declared / size > np.cos(_TILTED):
        return
    gravity = tuple(round(float(g), 3) + 0.0 for g in size * way)
    upside = "upside down" if way @ declared / size < -np.cos(_TILTED) else "from another side"
    yield Mistake(
        check="gravity", joint=-1,
        cause=f"gravity is declared {upside}; set gravity = "
        f"[{', '.join(f'{g:g}' for g in gravity)}]",
        changes={"gravity": gravity}, mended=replace(rows, gravity=np.array(gravity)),
    )  # fmt: skip


def _exchanged(n: int, a: int, b: int) -> list[int]:
    order = list(range(n))
    order[a], order[b] = b, a
    return order


def _quoted(names: Sequence[str]) -> str:
    return json.dumps(list(names))
