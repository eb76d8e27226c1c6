"""Mistakes in a robot file that explain the torques better than the file as it is.

Each is a hypothesis with corrected rows. Weights of the model file's rigid body and friction are
non-negative, so wrong signs and swapped columns fit badly.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hesr_model.findings import Finding, of_joint
from hesr_model.fitting.joint_rows import ROUND_OFF, non_negative_least_squares
from hesr_model.health.evidence import Motionwise, Torques, rubbing
from hesr_model.health.positions import BEYOND
from hesr_model.health.torque import sign_change
from hesr_model.logs.log_format import OPTIONAL, column_names
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import onto
from hesr_model.support.arrays import Array, Mask

_SIGNAL = 0.8  # largest unexplained share of a torque that shows gravity
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_EARTH = 9.81
_SNAP = np.radians(12.0)
_TURNED = "its torque counts backwards"
_TILTED = np.radians(20.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class CandidateRows:
    """Rows of several logs (N, n), motors over gear ratios, and gravity (3,)."""

    q: Array
    v: Array
    a: Array
    tau: Array
    gravity: Array


@dataclass(frozen=True, eq=False)
class Mistake:
    """A hypothesis, its changes of the robot file, and corrected rows."""

    check: str
    joint: int
    remedy: str
    changes: dict[str, object]
    mended: CandidateRows


def torques_of(rows: CandidateRows, robot: Robot) -> Torques:
    """Evaluate the model under the rows' gravity."""
    torques = Torques.of(robot, rows.q, rows.v, rows.a)
    declared = robot.gravity
    if np.array_equal(declared, rows.gravity):
        return torques
    change = np.einsum("kij,k->ij", _by_axis(rows.q, robot), rows.gravity - declared)
    return replace(torques, gravity=torques.gravity + change - change.mean(axis=0))


def _by_axis(q: Array, robot: Robot) -> Array:
    """Return torques (3, N, n) of unit gravity along each axis."""
    nothing = np.zeros_like(q)
    masses = robot.nominal_parameters.copy()
    masses[robot.inertial :] = 0.0
    with robot.under_gravity() as set_gravity:
        parts = []
        for axis in _AXES.values():
            set_gravity(axis)
            parts.append(robot.torque(masses, q, nothing, nothing))
    return np.array(parts)


def mistakes(rows: CandidateRows, model: Robot, moves: Mask) -> Iterator[Mistake]:
    """Yield possible mistakes, the simplest first."""
    description = model.description
    joints = [int(j) for j in np.flatnonzero(moves)]
    if len(joints) > 1:
        key, changes = sign_change(description, None, position=False)
        remedy = f"all torques count backwards; set {key}"
        mended = replace(rows, tau=-rows.tau)
        yield Mistake("torque-sign", -1, remedy, changes, mended)
    for j in joints:
        key, changes = sign_change(description, j, position=False)
        position, other = sign_change(description, j, position=True)
        side = np.where(np.arange(model.n) == j, -1.0, 1.0)
        q, v, a, tau = (part * side for part in (rows.q, rows.v, rows.a, rows.tau))
        remedy = f"{_TURNED}; set {key}"
        yield Mistake("torque-sign", j, remedy, changes, replace(rows, tau=tau))
        remedy = f"its position and velocity count backwards; set {position}"
        yield Mistake("position-sign", j, remedy, other, replace(rows, q=q, v=v, a=a))
        remedy = f"its position, velocity and torque count backwards; set {position}, and {key}"
        mended = replace(rows, q=q, v=v, a=a, tau=tau)
        yield Mistake("position-sign", j, remedy, other | changes, mended)
    for mend in (_swapped_torques, _swapped_joints, _gravity, _moved_zeros):
        yield from mend(rows, model, joints)


def _swapped_torques(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    description = model.description
    which = "tau" if description.log.torque_per_ampere is None else "current"
    columns = column_names(getattr(description.log.columns, which), description.joints)
    gains = np.array(description.log.torque_per_ampere or np.ones(model.n))
    for a, b in combinations(joints, 2):
        order = _swap_order(model.n, a, b)
        named = tuple(columns[k] for k in order)
        remedy = (
            f"its torque is swapped with that of joint '{description.joints[b]}'; set "
            "[log.columns] "
            f"{which} = {json.dumps(named)}"
        )
        mended = replace(rows, tau=rows.tau[:, order] / gains[order] * gains)
        yield Mistake("torque-columns", a, remedy, {f"log.columns.{which}": named}, mended)


def _swapped_joints(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    description = model.description
    orders = {(a, b): _swap_order(model.n, a, b) for a, b in combinations(joints, 2)}
    if len(joints) == model.n > 2:
        n = model.n
        orders[-1, -1] = list(reversed(range(n)))
        orders[-1, 1] = [*range(1, n), 0]
        orders[-1, 2] = [n - 1, *range(n - 1)]
    for (a, b), order in orders.items():
        changes = {
            f"log.columns.{key}": tuple(column_names(columns, description.joints)[k] for k in order)
            for key, columns in description.log.columns
            if key != "t" and columns and columns != OPTIONAL.get(key)
        }
        what = (
            "the columns are in another order than the joints"
            if a < 0
            else f"its columns are swapped with those of joint '{description.joints[b]}'"
        )
        remedy = (
            f"{what}; set [log.columns] q = {json.dumps(changes['log.columns.q'])}, and the others "
            "accordingly"
        )
        moved = {k: getattr(rows, k)[:, order] for k in ("q", "v", "a", "tau")}
        yield Mistake("joint-order", a, remedy, dict(changes), replace(rows, **moved))


def _moved_zeros(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    description = model.description
    for j in joints:
        if model.slides[j]:
            continue
        for quarter in (1, -1, 2):
            zero = list(description.log.zero or (0.0,) * model.n)
            zero[j] += quarter * np.pi / 2.0
            q = rows.q.copy()
            q[:, j] += quarter * np.pi / 2.0
            remedy = (
                f"its zero is {90 * quarter} degrees from the model's; set [log] zero = "
                f"[{', '.join(f'{z:.6g}' for z in zero)}]"
            )
            yield Mistake("zero", j, remedy, {"log.zero": tuple(zero)}, replace(rows, q=q))


def _gravity(rows: CandidateRows, robot: Robot, joints: list[int]) -> Iterator[Mistake]:
    by_axis = _by_axis(rows.q, robot)
    inertial = torques_of(rows, robot).inertial
    v = rows.v
    logged = robot.description.logged
    if logged is not None:
        by_axis = np.array([logged.torque(one) for one in by_axis])
        inertial, v = logged.torque(inertial), logged.motion(v)
    rows_of = []
    targets = []
    for place, j in enumerate(joints):
        rubs = [inertial[:, j], rubbing(v[:, j]), np.ones(len(v))]
        columns = np.column_stack([*by_axis[:, :, j], *rubs])
        tau = rows.tau[:, j]
        left = float(np.std(tau - columns @ np.linalg.lstsq(columns, tau, rcond=None)[0]))
        if left > _SIGNAL * np.std(tau):
            continue
        own = np.zeros((len(tau), 3 + 3 * len(joints)))
        own[:, :3] = columns[:, :3]
        own[:, 3 + 3 * place : 6 + 3 * place] = columns[:, 3:]
        rows_of.append(own / max(left, 1e-9))
        targets.append(tau / max(left, 1e-9))
    if not rows_of:
        return
    found = np.linalg.lstsq(np.concatenate(rows_of), np.concatenate(targets), rcond=None)[0][:3]
    declared = robot.gravity
    size = float(np.linalg.norm(declared)) or _EARTH
    if not np.linalg.norm(found) > 0.2 * size:
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
    if not np.any(declared):
        upside = "as none"
    listed = ", ".join(f"{g:g}" for g in gravity)
    remedy = f"gravity is declared {upside}; set gravity = [{listed}]"
    mended = replace(rows, gravity=np.array(gravity))
    yield Mistake("gravity", -1, remedy, {"gravity": gravity}, mended)


def _swap_order(n: int, a: int, b: int) -> list[int]:
    order = list(range(n))
    order[a], order[b] = b, a
    return order


_ROWS = 450  # total
_BETTER = 2.0  # minimum gain of a corrected joint
_NO_WORSE = 1.25  # largest loss of other joints
_EXPLAINED = 0.6  # minimum R^2 after the correction
_CLEARLY = 1.05  # minimum gain over a simpler mistake
_MOST = 8  # mistakes searched one after another


def pooled(motions: Sequence[Motionwise], gravity: Sequence[float]) -> CandidateRows:
    """Take equally many rows from each log."""
    each = [motion.thinned(max(_ROWS // len(motions), 60)) for motion in motions]
    rows = {k: np.concatenate([getattr(one, k) for one in each]) for k in ("q", "v", "a", "tau")}
    return CandidateRows(**rows, gravity=np.array(gravity, dtype=float))


def check_causes(motions: Sequence[Motionwise], robot: Robot) -> list[Finding]:
    """Find the mistakes that explain all logs best, the best first."""
    if not motions:
        return []
    moves = np.any([motion.moves for motion in motions], axis=0)
    moves &= np.any([np.ptp(motion.tau, axis=0) > 0.0 for motion in motions], axis=0)
    rows = pooled(motions, robot.gravity.tolist())
    logged = robot.description.logged
    rows = replace(rows, tau=logged.torque(rows.tau)) if logged else rows
    logs = tuple(dict.fromkeys(motion.log.name for motion in motions))
    findings: list[Finding] = []
    now = _unexplained_share(rows, robot, moves)
    for _ in range(_MOST):
        best, left = _best(rows, now, robot, moves)
        if best is None:
            break
        helped = int(np.argmax(now / left))
        found = (
            f"model and friction leave {100 * now[helped]:.0f} % of the torque of joint "
            f"'{robot.joints[helped]}' unexplained; with the correction {100 * left[helped]:.0f} %"
        )
        joint = robot.joints[best.joint] if best.joint >= 0 else ""
        more = best.changes
        findings.append(of_joint(best.check, joint, found, best.remedy, logs=logs, changes=more))
        rows = best.mended
        now = left
    return findings


def _best(
    rows: CandidateRows, now: Array, robot: Robot, moves: Mask
) -> tuple[Mistake | None, Array]:
    best = None
    left = now
    most = 0.0
    for mistake in mistakes(rows, robot, moves):
        then = _unexplained_share(mistake.mended, robot, moves)
        if _beyond(mistake.mended.q, robot) > _beyond(rows.q, robot) + BEYOND:
            continue
        gain = np.log(now / then)
        good = (gain > np.log(_BETTER)) & (1.0 - then**2 > _EXPLAINED)
        if not np.any(good) or np.min(gain) < -np.log(_NO_WORSE):
            continue
        if float(gain.sum()) > most * _CLEARLY:
            best = mistake
            left = then
            most = float(gain.sum())
        elif best and best.joint == mistake.joint and float(gain.sum()) * _CLEARLY > most:
            either = f"{_TURNED}, or its position and velocity do (the logs cannot show which);"
            remedy = best.remedy.replace(f"{_TURNED};", either)
            best = replace(best, remedy=remedy)
    return best, left


def _beyond(q: Array, robot: Robot) -> float:
    """Return the largest excess over the model's limits [rad or m]."""
    lower, upper, _ = robot.limits
    return float(np.max(np.maximum(lower - q, q - upper), initial=0.0))


def _unexplained_share(rows: CandidateRows, robot: Robot, moves: Mask) -> Array:
    """Return the unexplained share (n,) of the torques' deviation."""
    torques = torques_of(rows, robot)
    logged = robot.description.logged
    torques, v = torques.at(logged) if logged else torques, onto(logged, rows.v)
    left = np.ones(rows.q.shape[1])
    for j in np.flatnonzero(moves):
        deviation = float(np.std(rows.tau[:, j]))
        left[j] = _left(rows.tau[:, j], torques, v, int(j)) / max(deviation, 1e-12)
    return left


def _left(tau: Array, torques: Torques, v: Array, j: int) -> float:
    known = np.column_stack([torques.gravity[:, j], torques.inertial[:, j]])
    # A torque of round-off must not be scaled up to explain noise.
    known[:, np.abs(known).max(axis=0) <= ROUND_OFF * np.abs(tau).max()] = 0.0
    columns = np.column_stack([known, rubbing(v[:, j]), np.ones(len(tau))])
    _, squares = non_negative_least_squares(columns, tau, non_negative=3)
    return float(np.sqrt(max(squares, 0.0) / len(tau))) + 1e-9
