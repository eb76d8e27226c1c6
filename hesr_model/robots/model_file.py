"""Model files of robots (URDF, MJCF), parsed by Pinocchio."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hesr_model.errors import RobotError
from hesr_model.support.arrays import Array

_DEGREES = 180.0 / np.pi


def load(path: Path, *, mimic: bool = False) -> Any:
    """Parse a URDF, or an MJCF (``.xml``); mimic joints are driven unless `mimic`."""
    import pinocchio  # slow to import

    if not path.is_file():
        raise RobotError(f"{path}: no such model file.")
    is_mjcf = path.suffix.lower() == ".xml"
    try:
        if is_mjcf:
            return _with_lengths(pinocchio.buildModelFromMJCF(str(path)), _mjcf(path))
        return pinocchio.buildModelFromUrdf(str(path), mimic=mimic)
    except RobotError:
        raise
    except Exception as error:  # many kinds
        kind = "an MJCF" if is_mjcf else "a URDF"
        reason = " ".join(str(error).split()).rstrip(".")
        raise RobotError(f"{path}: cannot be parsed as {kind} ({reason}).") from error


def _mjcf(path: Path) -> ElementTree.Element:
    root = ElementTree.parse(path).getroot()
    if (include := root.find(".//include")) is not None:
        raise RobotError(
            f"{path}: includes '{include.get('file')}'; write the model as one file (MuJoCo: "
            "mj_saveLastXML)."
        )
    return root


def _with_lengths(model: Any, mjcf: ElementTree.Element) -> Any:
    """Give sliding joints their range in metres; Pinocchio reads degrees."""
    angles = [compiler.get("angle") for compiler in mjcf.iter("compiler")]
    if "radian" not in angles:
        for joint in list(model.joints)[1:]:
            if _slides(joint):
                model.lowerPositionLimit[joint.idx_q] *= _DEGREES
                model.upperPositionLimit[joint.idx_q] *= _DEGREES
    return model


@dataclass(frozen=True, kw_only=True)
class ModelJoint:
    """A joint of a model file; mimic joints have no degree of freedom."""

    name: str
    freedom: int
    slides: bool


def joints_of(path: Path) -> tuple[ModelJoint, ...]:
    """Return the moving joints from base to tip."""
    model = load(path, mimic=True)
    try:
        names = list(model.names)[1:]
    except UnicodeDecodeError as error:
        raise RobotError(f"{path}: a joint name is not valid UTF-8.") from error
    return tuple(
        ModelJoint(name=name, freedom=joint.nv, slides=_slides(joint))
        for name, joint in zip(names, list(model.joints)[1:], strict=True)
    )


def _slides(joint: Any) -> bool:
    # Pinocchio's names: PX, PY, PZ, PrismaticUnaligned; planar joints have more freedom.
    return joint.nv == 1 and str(joint.shortname()).startswith("JointModelP")


def driven_joints(path: Path, wanted: Sequence[str] = ()) -> tuple[ModelJoint, ...]:
    """Return the wanted or all usable joints, or raise RobotError."""
    joints = {joint.name: joint for joint in joints_of(path)}
    for name in wanted:
        if name not in joints:
            raise RobotError(f"{path}: has no joint '{name}'; it has {', '.join(joints)}.")
        if joints[name].freedom == 0:
            raise RobotError(
                f"{path}: joint '{name}' follows another (mimic); only driven joints can be used."
            )
        require_one_axis(name, joints[name].freedom, path)
    found = tuple(j for j in joints.values() if (j.name in wanted if wanted else j.freedom == 1))
    if not found:
        raise RobotError(f"{path}: has no revolute or prismatic joint; at least one is needed.")
    return found


def require_one_axis(name: str, freedom: int, path: Path) -> None:
    """Raise RobotError unless a joint has one degree of freedom."""
    if freedom != 1:
        raise RobotError(
            f"{path}: joint '{name}' has {freedom} degrees of freedom; "
            "only revolute and prismatic joints can be used."
        )


def set_joint(joint: Any, states: Array, position: Array) -> None:
    """Write a position [rad or m] into `states`, (nq,) or (nq, N)."""
    if joint.nq == 1:
        states[joint.idx_q] = position
    else:
        states[joint.idx_q], states[joint.idx_q + 1] = np.cos(position), np.sin(position)


def motion_subspace(joint: Any, state: Array) -> Array:
    """Return the motion subspace (6,) at a state (nq,): linear, angular."""
    data = joint.createData()
    joint.calc(data, state)
    return np.asarray(data.S, dtype=float).ravel()
