"""URDF files: checked numbers, mimic joints and inertias, without the appearance."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from hesr_model.errors import RobotError
from hesr_model.findings import Finding, caution

UNLIMITED = 1e9  # position limit of a joint without one, which Pinocchio's URDF parser would refuse
_NUMBERS = {
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
}
_MOVING = ("revolute", "continuous", "prismatic", "planar")
_SLACK = 1e-6  # relative violation of the triangle inequality by rounded inertias


@dataclass(frozen=True, kw_only=True)
class Urdf:
    """A URDF: plain text, mimic joints (leader, multiplier, offset), parents and doubts."""

    text: str
    followers: dict[str, tuple[str, float, float]]
    parents: dict[str, tuple[str, str]]  # parent link and joint of each link
    doubts: tuple[Finding, ...]


_XACRO = "/xacro}"  # end of the namespace of its elements


def read_urdf(path: Path, text: str | bytes) -> Urdf:
    """Read a URDF; RobotError if a number cannot be read, or an axis or a mass cannot be."""
    try:
        root = ElementTree.fromstring(text.strip())
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # or an encoding
        raise RobotError(f"{path}: cannot be parsed as a URDF ({error}).") from error
    if any(_XACRO in element.tag for element in root.iter() if isinstance(element.tag, str)):
        raise RobotError(f"{path}: is a xacro template; expand it first: xacro FILE > robot.urdf.")
    plain = Element("robot", name=root.get("name", "robot"))
    followers, parents = {}, {}
    doubts: list[Finding] = []
    for link in root.iterfind("link"):
        kept = SubElement(plain, "link", name=link.get("name", ""))
        if (inertial := link.find("inertial")) is not None:
            _require_numbers(path, link, inertial)
            kept.append(inertial)
            doubts += _inertia_doubts(path, link.get("name", ""), inertial)
    for joint in root.iterfind("joint"):
        _require_numbers(path, joint, joint)
        _complete(path, joint)
        plain.append(joint)
        name, ends = joint.get("name", ""), (joint.find("parent"), joint.find("child"))
        if ends[0] is not None and ends[1] is not None:
            parents[ends[1].get("link", "")] = ends[0].get("link", ""), name
        if (mimic := joint.find("mimic")) is not None:
            factor, offset = mimic.get("multiplier", "1"), mimic.get("offset", "0")
            followers[name] = mimic.get("joint", ""), float(factor), float(offset)
    plain_text = ElementTree.tostring(plain, encoding="unicode")
    return Urdf(text=plain_text, followers=followers, parents=parents, doubts=tuple(doubts))


def _require_numbers(path: Path, owner: Element, parent: Element) -> None:
    for element in parent:
        for key, count in _NUMBERS.get(element.tag, {}).items():
            if (text := element.get(key)) is None:
                continue
            try:
                found = [float(word) for word in text.split()]
            except ValueError:
                found = []
            if len(found) != count or np.any(np.isnan(found)):
                needed = f"{count} numbers" if count > 1 else "a number"
                raise RobotError(
                    f"{path}: {key} = '{text}' in <{element.tag}> of {owner.tag} "
                    f"'{owner.get('name', '')}' is not {needed}; write decimals with a point."
                )


def _complete(path: Path, joint: Element) -> None:
    kind, axis = joint.get("type"), joint.find("axis")
    if kind in _MOVING and axis is not None and not any(map(float, axis.get("xyz", "1").split())):
        raise RobotError(
            f"{path}: the axis of joint '{joint.get('name', '')}' is 0 0 0, which is no direction; "
            "give its <axis> a unit vector."
        )
    if kind not in ("revolute", "prismatic"):
        return
    if (limit := joint.find("limit")) is None:
        limit = SubElement(joint, "limit", lower=f"{-UNLIMITED:g}", upper=f"{UNLIMITED:g}")
    for key in ("lower", "upper", "effort", "velocity"):
        value = np.clip(float(limit.get(key, "0")), -UNLIMITED, UNLIMITED)
        limit.set(key, limit.get(key, "0") if abs(value) < UNLIMITED else f"{value:g}")


def _inertia_doubts(path: Path, link: str, inertial: Element) -> Iterator[Finding]:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is not None and float(mass.get("value", "0")) < 0.0:
        raise RobotError(
            f"{path}: link '{link}' has a negative mass, {mass.get('value')} kg; "
            "correct its <mass>."
        )
    if inertia is None:
        return
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "0")) for key in _NUMBERS["inertia"])
    principal = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    excess = principal[2] - principal[0] - principal[1]
    if principal[0] < -_SLACK * principal[2] or excess > _SLACK * principal[2]:
        numbers = ", ".join(f"{value:.3g}" for value in principal)
        yield caution(
            check="impossible-inertia",
            where=str(path),
            found=f"the principal moments of inertia of link '{link}' are {numbers} kg.m2",
            remedy="none may be negative or exceed the sum of the others; correct its <inertia>",
        )
