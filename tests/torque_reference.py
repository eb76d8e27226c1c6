"""Torques of model files by MuJoCo and by Pinocchio, and the worth of each force of an MJCF.

Nothing here is HESR's: a file is compiled as it is, and a force is removed from the specification
of the model before it is compiled.
"""

import re
import warnings
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

Array = np.ndarray[Any, np.dtype[np.float64]]
Motion = tuple[Array, Array, Array]
"""Positions, velocities and accelerations (N, n) [rad or m, per s, per s2]."""
Removal = Callable[[Any, Collection[str]], None]
STATES = 8
SINGLE_JOINTS = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
JOINT = re.compile(r'<joint\b[^>]*?\sname="([^"]*)"[^>]*?>(.*?)</joint>', re.DOTALL)
MIMIC = re.compile(r"<mimic\b([^>]*)>")
ATTRIBUTE = re.compile(r'(\w+)\s*=\s*"([^"]*)"')


def draw_motion(count: int, seed: int, middle: Array | float = 0.0) -> Motion:
    """Return eight random states of some joints."""
    q, dq, ddq = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, STATES, count))
    return q + middle, dq, ddq


class MjcfReference:
    """Torques of an MJCF, with all passive forces and without constraints.

    Parameters
    ----------
    path : file.
    removed : forces to remove, of `REMOVALS`, with the joints whose springs are meant.
    """

    def __init__(
        self, path: Path, removed: Mapping[str, Collection[str]] = MappingProxyType({})
    ) -> None:
        with warnings.catch_warnings(action="ignore"):  # deprecated attributes
            spec = mujoco.MjSpec.from_file(str(path))
            if removed:
                _replace_time_constants(spec)
            for force, joints in removed.items():
                REMOVALS[force](spec, joints)
            self.model = spec.compile()
        flags = mujoco.mjtDisableBit
        disabled = int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_EQUALITY)
        self.equalities: list[int] = []
        if not self.model.opt.disableflags & disabled:
            self.equalities = np.flatnonzero(self.model.eq_active0).tolist()
        self.model.opt.disableflags |= int(flags.mjDSBL_CONSTRAINT)
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_INVDISCRETE)
        self.numbers = {
            self.model.joint(j).name or f"joint{j}": j
            for j in range(self.model.njnt)
            if self.model.jnt_type[j] in SINGLE_JOINTS
        }

    @property
    def can_move(self) -> bool:
        """Whether a joint has one degree of freedom and a torque of its own."""
        return bool(self.numbers) and not self.equalities

    def find_followers(self, leaders: Collection[str]) -> list[str]:
        """Return the joints that some joints move, with these."""
        slopes, _ = self._follow([self.numbers[name] for name in leaders], {})
        moves = np.any(slopes != 0.0, axis=1)
        return [name for name, row in zip(self.numbers, moves, strict=True) if row]

    def draw_free_motion(self) -> tuple[list[str], Motion]:
        """Return the joints that no equality holds, and states as HESR's check draws them."""
        held = self._find_held()
        names = [name for name in self.numbers if self.numbers[name] not in held]
        joints = [self.numbers[name] for name in names]
        rest = self.model.qpos0[self.model.jnt_qposadr[joints]]
        return names, draw_motion(len(names), 0, rest)

    def compute_apart(self, names: list[str], motion: Motion) -> Array:
        """Return the torques (N, n) of joints that do not move each other."""
        _, offsets = self._follow([], {})
        held = self._find_held()
        rest = {
            joint: offset
            for joint, offset in zip(self.numbers.values(), offsets, strict=True)
            if joint in held
        }
        joints = [self.numbers[name] for name in names]
        return self._invert(joints, motion, rest)[:, self.model.jnt_dofadr[joints]]

    def compute(self, names: list[str], motion: Motion, held: Mapping[str, float]) -> Array:
        """Return the torques (N, n) of leading joints, whose followers move with them."""
        leaders = [self.numbers[name] for name in names]
        slopes, offsets = self._follow(leaders, held)
        q, dq, ddq = motion
        moved = (q @ slopes.T + offsets, dq @ slopes.T, ddq @ slopes.T)
        joints = list(self.numbers.values())
        torques = self._invert(joints, moved, {})
        return np.asarray(torques[:, self.model.jnt_dofadr[joints]] @ slopes)

    def _invert(self, joints: list[int], motion: Motion, rest: Mapping[int, float]) -> Array:
        data = mujoco.MjData(self.model)
        for joint, position in rest.items():
            data.qpos[self.model.jnt_qposadr[joint]] = position
        addresses = self.model.jnt_qposadr[joints]
        dofs = self.model.jnt_dofadr[joints]
        torques = []
        for state in zip(*motion, strict=True):
            data.qpos[addresses], data.qvel[dofs], data.qacc[dofs] = state
            mujoco.mj_inverse(self.model, data)
            torques.append(data.qfrc_inverse.copy())
        return np.array(torques)

    def _list_lines(self) -> list[tuple[int, int, float, float]]:
        """Return follower, leader or -1, constant and slope of each linear equality of joints."""
        lines = []
        for k in self.equalities:
            constant, slope, *higher = self.model.eq_data[k][:5].tolist()
            if self.model.eq_type[k] == int(mujoco.mjtEq.mjEQ_JOINT) and not any(higher):
                ends = (int(self.model.eq_obj1id[k]), int(self.model.eq_obj2id[k]))
                lines.append((*ends, constant, slope))
        return lines

    def _find_held(self) -> set[int]:
        lines = self._list_lines()
        held = {follower for follower, leader, *_ in lines if leader < 0}
        for _ in lines:
            held |= {follower for follower, leader, *_ in lines if leader in held}
        return held

    def _follow(self, leaders: list[int], held: Mapping[str, float]) -> tuple[Array, Array]:
        """Return G (single joints, leaders) and b of q = G q_leaders + b."""
        rows = {j: row for row, j in enumerate(self.numbers.values())}
        rest = self.model.qpos0[self.model.jnt_qposadr]
        slopes = np.zeros((len(rows), len(leaders)))
        offsets = np.array([held.get(name, rest[j]) for name, j in self.numbers.items()])
        for column, j in enumerate(leaders):
            slopes[rows[j], column] = 1.0
            offsets[rows[j]] = 0.0
        lines = self._list_lines()
        # As often as there are equalities, so that a follower of a follower is reached.
        for _ in lines:
            for follower, leader, constant, slope in lines:
                row = rows[follower]
                offsets[row] = rest[follower] + constant
                slopes[row] = 0.0
                if leader >= 0:
                    offsets[row] += slope * (offsets[rows[leader]] - rest[leader])
                    slopes[row] = slope * slopes[rows[leader]]
        return slopes, offsets


def _replace_time_constants(spec: Any) -> None:
    """Replace `springdamper` by the stiffness and damping that the compiler computes from it."""
    if not any(np.any(joint.springdamper) for joint in spec.joints):
        return
    model = spec.compile()
    for joint in spec.joints:
        if np.any(joint.springdamper):
            joint.stiffness = [model.jnt_stiffness[joint.id], 0.0, 0.0]
            joint.damping = [model.dof_damping[model.jnt_dofadr[joint.id]], 0.0, 0.0]
            joint.springdamper = [0.0, 0.0]


def _remove(parts: str, *attributes: str) -> Removal:
    """Return a function that sets attributes of all parts of a kind to 0."""

    def remove(spec: Any, _: Collection[str]) -> None:
        for part in getattr(spec, parts):
            for attribute in attributes:
                values = np.zeros_like(getattr(part, attribute))
                setattr(part, attribute, values if values.ndim else 0.0)

    return remove


def _remove_line(spec: Any, joints: Collection[str]) -> None:
    for joint in spec.joints:
        if joint.name in joints:
            joint.stiffness = [0.0, *joint.stiffness[1:]]


def _remove_orders(spec: Any, _: Collection[str]) -> None:
    for joint in spec.joints:
        joint.stiffness = [joint.stiffness[0], 0.0, 0.0]


def _remove_fluid(spec: Any, _: Collection[str]) -> None:
    spec.option.density = 0.0
    spec.option.viscosity = 0.0


def _remove_armature(spec: Any, _: Collection[str]) -> None:
    kinds = mujoco.mjtTrn
    for actuator in spec.actuators:
        if actuator.trntype not in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
            actuator.armature = 0.0


REMOVALS: dict[str, Removal] = {
    "gravcomp of <body>": _remove("bodies", "gravcomp"),
    "stiffness of <joint>": _remove_line,
    "higher orders of stiffness of <joint>": _remove_orders,
    "damping of <joint>": _remove("joints", "damping"),
    "stiffness of <tendon>": _remove("tendons", "stiffness"),
    "damping of <tendon>": _remove("tendons", "damping"),
    "armature of <tendon>": _remove("tendons", "armature"),
    "damping of <actuator>": _remove("actuators", "damping"),
    "elasticity of <flex>": _remove("flexes", "young", "damping", "edgestiffness", "edgedamping"),
    "density and viscosity of <option>": _remove_fluid,
    "armature of <actuator> at a tendon": _remove_armature,
}
"""Functions that remove a force from the specification of a model, by the force's name."""


class UrdfReference:
    """Torques of a URDF as Pinocchio reads it; joints that mimic others move with them."""

    def __init__(self, path: Path) -> None:
        self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        text = re.sub(r"<!--.*?-->", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        names = list(self.model.names)
        self.mimics: dict[str, tuple[str, float, float]] = {}
        for name, content in JOINT.findall(text):
            mimic = MIMIC.search(content)
            if mimic and name in names:
                numbers = dict(ATTRIBUTE.findall(mimic[1]))
                slope = float(numbers.get("multiplier", 1.0))
                self.mimics[name] = numbers["joint"], slope, float(numbers.get("offset", 0.0))

    @property
    def can_move(self) -> bool:
        """Whether a joint has one degree of freedom, and all that others mimic exist."""
        names = list(self.model.names)
        has_joint = any(joint.nv == 1 for joint in list(self.model.joints)[1:])
        return has_joint and all(leader in names for leader, *_ in self.mimics.values())

    def compute(self, names: list[str], motion: Motion, held: Mapping[str, float]) -> Array:
        """Return the torques (N, n) of joints, with others held."""
        all_names = list(self.model.names)[1:]
        joints = list(self.model.joints)[1:]
        slopes = np.array([[float(name == leader) for leader in names] for name in all_names])
        offsets = np.array([held.get(name, 0.0) for name in all_names])
        for _ in self.mimics:
            for name, (leader, slope, offset) in self.mimics.items():
                row, leading_row = all_names.index(name), all_names.index(leader)
                slopes[row] = slope * slopes[leading_row]
                offsets[row] = slope * offsets[leading_row] + offset
        torques = []
        for state in zip(*motion, strict=True):
            q = pin.neutral(self.model)
            v, a = np.zeros((2, self.model.nv))
            for joint, row, offset in zip(joints, slopes, offsets, strict=True):
                if joint.nv == 1:
                    _place(joint, q, float(row @ state[0]) + offset)
                    v[joint.idx_v], a[joint.idx_v] = row @ state[1], row @ state[2]
            tau = pin.rnea(self.model, self.data, q, v, a)
            single = [joint.nv == 1 for joint in joints]
            dofs = [joint.idx_v for joint in joints if joint.nv == 1]
            torques.append(tau[dofs] @ slopes[single])
        return np.array(torques)


def _place(joint: Any, q: Array, position: float) -> None:
    values = [position] if joint.nq == 1 else [np.cos(position), np.sin(position)]
    q[joint.idx_q : joint.idx_q + joint.nq] = values
