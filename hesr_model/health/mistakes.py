"""Mistakes in robot files as hypotheses, each with the corrected rows."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hesr_model.health.evidence import Torques, rubbing
from hesr_model.health.torque import sign_change
from hesr_model.logs.log_format import OPTIONAL, column_names
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Mask

_SIGNAL = 0.8  # largest unexplained share of a torque that shows gravity
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_EARTH = 9.81
_SNAP = np.radians(12.0)
_TILTED = np.radians(20.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class CandidateRows:
    """Rows of several logs (N, n), motors over gear ratios, and gravity (3,)."""

    q: Array
    v: Array
    a: Array
    tau: Array
    gravity: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Mistake:
    """A hypothesis, its changes of the robot file, and corrected rows."""

    check: str
    joint: int
    remedy: str
    changes: dict[str, object]
    mended: CandidateRows


def torques_of(rows: CandidateRows, model: Robot) -> Torques:
    """Evaluate the model under the rows' gravity."""
    torques = Torques.of(model, rows.q, rows.v, rows.a)
    declared = model.gravity
    if np.array_equal(declared, rows.gravity):
        return torques
    change = np.einsum("kij,k->ij", _by_axis(rows.q, model), rows.gravity - declared)
    return replace(torques, gravity=torques.gravity + change - change.mean(axis=0))


def _by_axis(q: Array, model: Robot) -> Array:
    """Return torques (3, N, n) of unit gravity along each axis."""
    nothing, masses = np.zeros_like(q), model.nominal_parameters.copy()
    masses[model.inertial :] = 0.0
    with model.under_gravity() as set_gravity:
        parts = []
        for axis in _AXES.values():
            set_gravity(axis)
            parts.append(model.torque(masses, q, nothing, nothing))
    return np.array(parts)


def mistakes(rows: CandidateRows, model: Robot, moves: Mask) -> Iterator[Mistake]:
    """Yield possible mistakes, the simplest first."""
    robot, joints = model.description, [int(j) for j in np.flatnonzero(moves)]
    if len(joints) > 1:
        key, changes = sign_change(robot, None, position=False)
        yield Mistake(
            check="torque-sign",
            joint=-1,
            remedy=f"all torques count backwards; set {key}",
            changes=changes,
            mended=replace(rows, tau=-rows.tau),
        )
    for j in joints:
        key, changes = sign_change(robot, j, position=False)
        position, other = sign_change(robot, j, position=True)
        side = np.where(np.arange(model.n) == j, -1.0, 1.0)
        q, v, a, tau = (part * side for part in (rows.q, rows.v, rows.a, rows.tau))
        yield Mistake(
            check="torque-sign",
            joint=j,
            remedy=f"its torque counts backwards; set {key}",
            changes=changes,
            mended=replace(rows, tau=tau),
        )
        yield Mistake(
            check="position-sign",
            joint=j,
            remedy=f"its position and velocity count backwards; set {position}",
            changes=other,
            mended=replace(rows, q=q, v=v, a=a),
        )
        yield Mistake(
            check="position-sign",
            joint=j,
            remedy=f"its position, velocity and torque count backwards; set {position}, and {key}",
            changes=other | changes,
            mended=replace(rows, q=q, v=v, a=a, tau=tau),
        )
    for mend in (_swapped_torques, _swapped_joints, _gravity, _moved_zeros):
        yield from mend(rows, model, joints)


def _swapped_torques(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    robot = model.description
    which = "tau" if robot.log.torque_per_ampere is None else "current"
    columns = column_names(getattr(robot.log.columns, which), robot.joints)
    gains = np.array(robot.log.torque_per_ampere or np.ones(model.n))
    for a, b in combinations(joints, 2):
        order = _exchanged(model.n, a, b)
        named = tuple(columns[k] for k in order)
        yield Mistake(
            check="torque-columns",
            joint=a,
            remedy=f"its torque is swapped with that of joint '{robot.joints[b]}'; set "
            f"[log.columns] {which} = {_quoted(named)}",
            changes={f"log.columns.{which}": named},
            mended=replace(rows, tau=rows.tau[:, order] / gains[order] * gains),
        )


def _swapped_joints(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    robot = model.description
    orders = {(a, b): _exchanged(model.n, a, b) for a, b in combinations(joints, 2)}
    if len(joints) == model.n > 2:
        n = model.n
        orders[-1, -1] = list(reversed(range(n)))
        orders[-1, 1], orders[-1, 2] = [*range(1, n), 0], [n - 1, *range(n - 1)]
    for (a, b), order in orders.items():
        changes = {
            f"log.columns.{key}": tuple(column_names(columns, robot.joints)[k] for k in order)
            for key, columns in robot.log.columns
            if key != "t" and columns and columns != OPTIONAL.get(key)
        }
        what = (
            "the columns are in another order than the joints"
            if a < 0
            else f"its columns are swapped with those of joint '{robot.joints[b]}'"
        )
        yield Mistake(
            check="joint-order",
            joint=a,
            remedy=f"{what}; set [log.columns] q = {_quoted(changes['log.columns.q'])}, and the "
            "others accordingly",
            changes=dict(changes),
            mended=replace(rows, **{k: getattr(rows, k)[:, order] for k in ("q", "v", "a", "tau")}),
        )


def _moved_zeros(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    robot = model.description
    for j in joints:
        if model.slides[j]:
            continue
        for quarter in (1, -1, 2):
            zero = list(robot.log.zero or (0.0,) * model.n)
            zero[j] += quarter * np.pi / 2.0
            q = rows.q.copy()
            q[:, j] += quarter * np.pi / 2.0
            yield Mistake(
                check="zero",
                joint=j,
                remedy=f"its zero is {90 * quarter} degrees from the model's; set [log] zero = "
                f"[{', '.join(f'{z:.6g}' for z in zero)}]",
                changes={"log.zero": tuple(zero)},
                mended=replace(rows, q=q),
            )


def _gravity(rows: CandidateRows, model: Robot, joints: list[int]) -> Iterator[Mistake]:
    by_axis, inertial, v = _by_axis(rows.q, model), torques_of(rows, model).inertial, rows.v
    if (logged := model.description.logged) is not None:
        by_axis = np.array([logged.torque(one) for one in by_axis])
        inertial, v = logged.torque(inertial), logged.motion(v)
    rows_of, targets = [], []
    for place, j in enumerate(joints):
        rubs = [inertial[:, j], rubbing(v[:, j]), np.ones(len(v))]
        columns, tau = np.column_stack([*by_axis[:, :, j], *rubs]), rows.tau[:, j]
        left = float(np.std(tau - columns @ np.linalg.lstsq(columns, tau, rcond=None)[0]))
        if left > _SIGNAL * np.std(tau):
            continue
        own = np.zeros((len(tau), 3 + 3 * len(joints)))
        own[:, :3], own[:, 3 + 3 * place : 6 + 3 * place] = columns[:, :3], columns[:, 3:]
        rows_of.append(own / max(left, 1e-9))
        targets.append(tau / max(left, 1e-9))
    if not rows_of:
        return
    found = np.linalg.lstsq(np.concatenate(rows_of), np.concatenate(targets), rcond=None)[0][:3]
    declared = model.gravity
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
    yield Mistake(
        check="gravity",
        joint=-1,
        remedy=f"gravity is declared {upside}; set gravity = "
        f"[{', '.join(f'{g:g}' for g in gravity)}]",
        changes={"gravity": gravity},
        mended=replace(rows, gravity=np.array(gravity)),
    )


def _exchanged(n: int, a: int, b: int) -> list[int]:
    order = list(range(n))
    order[a], order[b] = b, a
    return order


def _quoted(names: Sequence[str]) -> str:
    return json.dumps(list(names))
