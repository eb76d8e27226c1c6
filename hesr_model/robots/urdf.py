"""URDF files: checked numbers, mimic joints, inertias; limits of joints and doubts about models."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from hesr_model.errors import RobotError
from hesr_model.findings import Finding, build_joint_finding, caution
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.ledger import Ledger
from hesr_model.support.xml_files import parse_xml

UNLIMITED = 1e9  # position limit of a joint without one, which Pinocchio's URDF parser would refuse
_NUMBERS = {
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
}
_USED_NAMES = {
    "robot": ("name", "link", "joint"),
    "link": ("name", "inertial"),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("name", "type", "origin", "parent", "child", "axis", "limit", "mimic", "dynamics"),
    "dynamics": (),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint", "multiplier", "offset"),
    "limit": ("lower", "upper", "effort", "velocity"),
    **{kind: tuple(_NUMBERS[kind]) for kind in ("mass", "inertia", "origin", "axis")},
}
_FRICTION_REASON = "friction, which the laws of logs describe"
_IRRELEVANT_NAMES = {
    "robot": {
        "material": "a colour",
        "version": "of the format",
        "gazebo": "for a simulator",
        "transmission": "for a controller; gears of HESR are in robot files",
        "sensor": "measures, without a mass of its own",
        "ros2_control": "for a controller",
        "group": "for a planner",
        "disable_collisions": "for a planner",
        "collision_filter_group": "for contacts",
    },
    "link": {
        "visual": "appearance",
        "collision": "shape of contacts",
        "material": "a colour",
        "sensor": "measures, without a mass of its own",
        "contact": "friction and stiffness of contacts",
        "surface": "friction and stiffness of contacts",
        "type": "of old files",
        "collision_checking": "for a planner",
        "self_collision_checking": "for a planner",
        "self_filter": "for a planner",
        "gravity": "of a body in a simulator",
        "kinematic": "of a body in a simulator",
    },
    "joint": {
        "safety_controller": "limits of a controller within those of the joint",
        "calibration": "of the zero by a controller",
        "dont_collapse": "for a converter",
    },
    "dynamics": {
        "damping": _FRICTION_REASON,
        "friction": _FRICTION_REASON,
        "mu_coulomb": _FRICTION_REASON,
        "mu_viscous": _FRICTION_REASON,
        "K": "stiffness of a gear, whose torque is that of the joint",
        "D": "damping of a gear, whose torque is that of the joint",
    },
    "limit": {
        "acceleration": "for a planner",
        "jerk": "for a planner",
        "current": "for a controller",
        "command_effort": "for a controller",
        "gear_velocity": "for a controller",
    },
}
_MOVING_TYPES = ("revolute", "continuous", "prismatic", "planar")
_ROUNDING_SLACK = 1e-6  # relative violation of the triangle inequality by rounded inertias


@dataclass(frozen=True, kw_only=True)
class Urdf:
    """A URDF: plain text, mimic joints (leader, multiplier, offset), parents and doubts by link."""

    text: str
    followers: dict[str, tuple[str, float, float]]
    parents: dict[str, tuple[str, str]]  # parent link and joint of each link
    doubts: dict[str, Finding]
    left_over: tuple[Finding, ...]  # about names that nothing reads


_XACRO = ("/xacro}", "{xacro}")  # ends of the namespace of its elements


def read_urdf(path: Path, text: str | bytes) -> Urdf:
    """Read a URDF; RobotError if a number cannot be read, or an axis or a mass cannot be."""
    try:
        root = parse_xml(text.strip())
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # or an encoding
        raise RobotError(f"{path}: cannot be parsed as a URDF ({error}).") from error
    tags = [element.tag for element in root.iter() if isinstance(element.tag, str)]
    if any(name in tag for tag in tags for name in _XACRO):
        raise RobotError(f"{path}: is a xacro template; expand it first: xacro FILE > robot.urdf.")
    ledger = Ledger(str(path), "part")
    # Tools put elements of their own anywhere, under names that URDF has elsewhere.
    ledger.compare_elements(root, _USED_NAMES, _IRRELEVANT_NAMES, finds_homes=False)
    ledger.refuse_misspelt(RobotError)
    plain_root = Element("robot", name=root.get("name", "robot"))
    followers = {}
    parents: dict[str, tuple[str, str]] = {}
    findings: dict[str, Finding] = {}
    for link in root.iterfind("link"):
        plain_link = SubElement(plain_root, "link", name=link.get("name", ""))
        inertial = link.find("inertial")
        if inertial is not None:
            _require_numbers(path, link, inertial)
            plain_link.append(inertial)
            name = link.get("name", "")
            doubt = _doubt_inertia(path, name, inertial)
            if doubt is not None:
                findings[name] = doubt
    for joint in root.iterfind("joint"):
        _require_numbers(path, joint, joint)
        _complete_joint(path, joint)
        plain_root.append(joint)
        name = joint.get("name", "")
        ends = (joint.find("parent"), joint.find("child"))
        if ends[0] is not None and ends[1] is not None:
            child = ends[1].get("link", "")
            if child in parents:
                raise RobotError(
                    f"{path}: link '{child}' is the child of joints '{parents[child][1]}' and "
                    f"'{name}'; a URDF has no loops, so remove one of these joints."
                )
            parents[child] = ends[0].get("link", ""), name
        mimic = joint.find("mimic")
        if mimic is not None:
            factor = mimic.get("multiplier", "1")
            offset = mimic.get("offset", "0")
            followers[name] = mimic.get("joint", ""), float(factor), float(offset)
    plain_text = ElementTree.tostring(plain_root, encoding="unicode")
    return Urdf(
        text=plain_text,
        followers=followers,
        parents=parents,
        doubts=findings,
        left_over=tuple(ledger.findings()),
    )


def _require_numbers(path: Path, owner: Element, parent: Element) -> None:
    for element in parent:
        for key, count in _NUMBERS.get(element.tag, {}).items():
            text = element.get(key)
            if text is None:
                continue
            try:
                numbers = [float(word) for word in text.split()]
            except ValueError:
                numbers = []
            if len(numbers) != count or np.any(np.isnan(numbers)):
                expectation = f"{count} numbers" if count > 1 else "a number"
                raise RobotError(
                    f"{path}: {key} = '{text}' in <{element.tag}> of {owner.tag} "
                    f"'{owner.get('name', '')}' is not {expectation}; write decimals with a point."
                )


def _complete_joint(path: Path, joint: Element) -> None:
    kind = joint.get("type")
    axis = joint.find("axis")
    if (
        kind in _MOVING_TYPES
        and axis is not None
        and not any(map(float, axis.get("xyz", "1").split()))
    ):
        raise RobotError(
            f"{path}: the axis of joint '{joint.get('name', '')}' is 0 0 0, which is no direction; "
            "give its <axis> a unit vector."
        )
    if kind not in ("revolute", "prismatic"):
        return
    limit = joint.find("limit")
    if limit is None:
        limit = SubElement(joint, "limit")
    # A lower or upper limit alone has 0 as its counterpart; where neither is stated, none is meant.
    if limit.get("lower") is None and limit.get("upper") is None:
        limit.set("lower", f"{-UNLIMITED:g}")
        limit.set("upper", f"{UNLIMITED:g}")
    for key in ("lower", "upper", "effort", "velocity"):
        value = np.clip(float(limit.get(key, "0")), -UNLIMITED, UNLIMITED)
        limit.set(key, limit.get(key, "0") if abs(value) < UNLIMITED else f"{value:g}")


def _doubt_inertia(path: Path, link: str, inertial: Element) -> Finding | None:
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    if mass is not None and float(mass.get("value", "0")) < 0.0:
        raise RobotError(
            f"{path}: link '{link}' has a negative mass, {mass.get('value')} kg; "
            "correct its <mass>."
        )
    if inertia is None:
        return None
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "0")) for key in _NUMBERS["inertia"])
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.all(np.isfinite(moments)):
        raise RobotError(
            f"{path}: link '{link}' has an infinite moment of inertia; correct its <inertia>."
        )
    principal = np.linalg.eigvalsh(moments)
    excess = principal[2] - principal[0] - principal[1]
    slack = _ROUNDING_SLACK * principal[2]
    if principal[0] >= -slack and excess <= slack:
        return None
    numbers = ", ".join(f"{value:.3g}" for value in principal)
    return caution(
        check="impossible-inertia",
        where=str(path),
        found=f"the principal moments of inertia of link '{link}' are {numbers} kg.m2",
        remedy="none may be negative or exceed the sum of the others; correct its <inertia>",
    )


def find_model_doubts(path: Path, pin_model: Any) -> Iterator[Finding]:
    """Yield doubts about single joints of a model file."""
    urdf = path.suffix.lower() != ".xml"
    build_doubt = partial(build_joint_finding, where=str(path))
    for name, joint, link in list(
        zip(pin_model.names, pin_model.joints, pin_model.inertias, strict=True)
    )[1:]:
        if joint.nv != 1:
            observation = "has several degrees of freedom and is held at its reference position"
            yield build_doubt("held-joint", name, observation, "leave it out if it moves", "advice")
            continue
        lower, upper = position_limits(pin_model, joint, valid=False)
        if urdf and not link.mass > 0.0:
            remedy = "give the link an <inertial> if it is a real part"
            yield build_doubt("massless-link", name, "its link has no mass", remedy, "warning")
        if urdf and link.mass > 0.0 and not np.any(link.inertia):
            observation = f"its link of {link.mass:.3g} kg has no inertia, as if it was rounded"
            remedy = "write more digits of its <inertia>"
            yield build_doubt("rounded-inertia", name, observation, remedy, "warning")
        if joint.nq != 1 or not np.isfinite(lower + upper):
            if joint.nq == 1 and urdf:
                remedy = "state them in its <limit>; hesr excite needs them"
                yield build_doubt("no-limits", name, "has no limits", remedy, "advice")
        elif lower >= upper:
            relation = "equal" if lower == upper else "reversed"
            observation = (
                f"its position limits are {relation}, {lower:g} and {upper:g}, and count as none"
            )
            yield build_doubt("odd-limits", name, observation, "correct its limits", "warning")
        elif 4 * np.pi < max(-lower, upper) <= 720.0 and "JointModelP" not in joint.shortname():
            observation = f"its limits {lower:g} and {upper:g} rad look like degrees"
            yield build_doubt("odd-limits", name, observation, "write radians", "warning")


def find_chain_doubts(
    path: Path,
    joints: Sequence[str],
    masses: Array,
    is_bare: Mask,
    spring_torques: Mapping[str, float],
) -> Iterator[Finding]:
    """Yield doubts about mass matrices (N, n, n), joints without range (n,) and springs."""
    build_doubt = partial(build_joint_finding, where=str(path))
    for name, torque in spring_torques.items():
        observation = (
            f"has a spring of up to {torque:.3g} N.m (N if it slides), which its torque leaves out"
        )
        yield build_doubt(
            "no-spring", name, observation, "list it in 'springs' of the robot file", "warning"
        )
    lowest_inertia = np.diagonal(masses, axis1=1, axis2=2).min(axis=0)
    for j in np.flatnonzero(lowest_inertia <= 1e-12 * np.abs(masses).max()).tolist():
        observation = (
            f"moves an inertia of {lowest_inertia[j]:.3g} kg.m2 (kg if it slides), which makes its "
            "torques meaningless"
        )
        remedy = "correct the <inertial> of the links after it"
        yield build_doubt("no-inertia", joints[j], observation, remedy)
    for j in np.flatnonzero(is_bare).tolist():
        observation = "joints that follow it leave it no range, and their limits count as none"
        remedy = "correct their limits or their <mimic> or equality"
        yield build_doubt("odd-limits", joints[j], observation, remedy, "warning")


def position_limits(pin_model: Any, joint: Any, *, valid: bool = True) -> tuple[float, float]:
    """Return the position limits, infinite if absent or, if `valid`, equal or reversed."""
    lower = float(pin_model.lowerPositionLimit[joint.idx_q]) if joint.nq == 1 else -np.inf
    upper = float(pin_model.upperPositionLimit[joint.idx_q]) if joint.nq == 1 else np.inf
    lower, upper = (
        (lower if lower > -UNLIMITED else -np.inf),
        (upper if upper < UNLIMITED else np.inf),
    )
    return (-np.inf, np.inf) if valid and not lower < upper else (lower, upper)


def chain_limits(
    pin_model: Any, numbers: Sequence[int], follow: tuple[Array, Array] | None
) -> tuple[Array, Array, Array, Mask]:
    """Return lowest and highest position [rad or m] and highest speed (n,) of the joints `numbers`.

    `follow` is G and b of q_all = G q + b. Joints that follow a leader also limit it, unless they
    leave it no range: there the mask (n,) is true.
    """
    joints = list(pin_model.joints)[1:]
    n = len(numbers)
    ranges = np.array([position_limits(pin_model, joint) for joint in joints])
    speeds = np.array([float(pin_model.velocityLimit[joint.idx_v]) for joint in joints])
    speeds = np.where((speeds > 0.0) & (speeds < UNLIMITED), speeds, np.inf)
    slopes, offsets = follow or (np.eye(n), np.zeros(n))
    is_driven = slopes != 0.0
    scale = np.where(is_driven, slopes, 1.0)
    ends = np.sort((ranges.T - offsets)[:, :, None] / scale, axis=0)
    lower = np.where(is_driven, ends[0], -np.inf).max(axis=0)
    upper = np.where(is_driven, ends[1], np.inf).min(axis=0)
    is_bare = lower >= upper
    own_limits = ranges[np.array(numbers) - 1].T
    lower, upper = np.where(is_bare, own_limits, [lower, upper])
    speed = np.where(is_driven, speeds[:, None] / np.abs(scale), np.inf).min(axis=0)
    return lower, upper, speed, is_bare
