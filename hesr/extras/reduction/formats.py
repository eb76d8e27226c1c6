"""Files with the numbers of joints: MJCF, URDF and Isaac Lab, with their price as comments."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from hesr.extras.reduction.creep import DEFAULT_SOLREF, SOLREF, STEP, simulate_creep
from hesr.extras.reduction.projection import LogRecords, ReducedJoint, Weight, reduce_model
from hesr_model.errors import ExportError
from hesr_model.friction.log_friction import LogSource, read_log
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.files import written_whole
from hesr_model.support.text import join_with_or
from hesr_model.units import unit_of_joint

_DIGITS = 6
_INERTIA_ROWS = 200  # number of positions for the mean of inertias


@dataclass(frozen=True, kw_only=True)
class TextFormat:
    """A file with the numbers of joints.

    Attributes
    ----------
    noun : its name in messages.
    suffixes : allowed ones of the file.
    compose : joints and comments in, text out.
    """

    noun: str
    suffixes: tuple[str, ...]
    compose: Callable[[Sequence[ReducedJoint], Sequence[str]], str]


def export_reduced(
    model: FrictionModel,
    path: Path,
    text_format: TextFormat,
    *,
    log: Sequence[LogSource],
    test_log: Sequence[LogSource] = (),
    robot: Robot,
    rigid_body: RigidBody | None = None,
    weight: Weight = "rows",
) -> list[str]:
    """Write the numbers of all joints by a format; return their price in words.

    Parameters
    ----------
    model : laws of the joints.
    path : file to write.
    text_format : format of the file.
    log : logs at whose speeds and loads the numbers hold, as a rule those of the fit.
    test_log : logs that decide on the price; by default `log`.
    robot : robot of the logs.
    rigid_body : body that separates friction; by default that of the fit.
    weight : weight of a row in the projection.

    Raises
    ------
    ExportError
        If the file has another suffix, a joint stands still, or its law does not oppose motion.
    LogError, RobotError, SimulationError
        If a log cannot be read, or log, body and law are of different robots.
    """
    if path.suffix not in text_format.suffixes:
        raise ExportError(
            f"{path}: {text_format.noun} ends in {join_with_or(text_format.suffixes)}, found "
            f"'{path.suffix}'."
        )
    training = _read_records(model, log, robot, rigid_body)
    tests = _read_records(model, test_log, robot, rigid_body) if test_log else None
    body = rigid_body or model.rigid_body
    inertias = _find_mean_inertias(robot, body, training)
    joints = reduce_model(model, training, tests, body, inertias, weight)
    price_lines = list(_describe_price(joints, is_held_back=tests is not None))
    comments = [
        f"Friction of '{model.robot}' by the law '{model.law}', reduced to numbers per joint.",
        "They hold at the speeds and loads below, and replace no other term of the law.",
        *price_lines,
    ]
    with written_whole(path) as temporary:
        temporary.write_text(text_format.compose(joints, comments), encoding="utf-8")
    return price_lines


def _read_records(
    model: FrictionModel,
    logs: Sequence[LogSource],
    robot: Robot,
    rigid_body: RigidBody | None,
) -> LogRecords:
    return [
        model.records(part, rigid_body=rigid_body, robot=robot)
        for source in logs
        for part in read_log(source, robot).parts()
    ]


def _find_mean_inertias(robot: Robot, body: RigidBody | None, records: LogRecords) -> list[float]:
    """Return the inertia at each joint [kg.m2], the mean over positions of the logs."""
    parameters = robot.nominal_parameters if body is None else body.parameters_for(robot)
    positions = [np.stack([record.q for record in log_records], axis=1) for log_records in records]
    q = np.concatenate(positions)
    step = max(1, len(q) // _INERTIA_ROWS)
    mass_matrices, _ = robot.dynamics(parameters, q[::step], np.zeros_like(q[::step]))
    diagonals = np.diagonal(mass_matrices, axis1=1, axis2=2)
    return [float(inertia) for inertia in np.mean(diagonals, axis=0)]


def _describe_price(joints: Sequence[ReducedJoint], *, is_held_back: bool) -> Iterator[str]:
    """Yield the price of each joint as one line."""
    rows = "logs that were not used for them" if is_held_back else "the logs of the projection"
    yield f"Price on {rows}: RMSE of the law and of the numbers, variance lost, energy kept:"
    for joint in joints:
        price = joint.price
        force, speed = (
            unit_of_joint(unit, is_prismatic=joint.sliding) for unit in ("N.m", "rad/s")
        )
        low_speed, high_speed = (f"{value:.3g}" for value in price.speeds)
        low_load, high_load = (f"{value:.3g}" for value in price.loads)
        yield (
            f"{joint.name}: {price.law_rmse:.4g} and {price.rmse:.4g} {force}, "
            f"{100.0 * price.lost_variance:.2g} %, {100.0 * price.energy:.4g} %; speeds of "
            f"{low_speed} to {high_speed} {speed}, loads of {low_load} to {high_load} {force}."
        )


def compose_mjcf(joints: Sequence[ReducedJoint], comments: Sequence[str]) -> str:
    """Return defaults of MuJoCo, one class per joint, for `<include>` in a model.

    MuJoCo's Coulomb friction is a soft constraint, so that a held joint creeps; the comments state
    how fast, as MuJoCo simulates it.
    """
    root = ET.Element("mujoco")
    defaults = ET.SubElement(root, "default")
    for joint in joints:
        attributes = {
            "damping": _format(joint.damping),
            "frictionloss": _format(joint.frictionloss),
            "solreffriction": SOLREF,
        }
        if joint.armature is not None:
            attributes["armature"] = _format(joint.armature)
        default_class = ET.SubElement(defaults, "default", {"class": joint.name})
        ET.SubElement(default_class, "joint", attributes)
    usage = "Include this file, and give each joint the class of its name."
    creep = (
        "MuJoCo's Coulomb friction is soft: under half of it a held joint creeps, at a step of "
        f"{1e3 * STEP:g} ms:"
    )
    creep_lines = [
        f"{joint.name}: {simulate_creep(joint):.2g} "
        f"{unit_of_joint('rad/s', is_prismatic=joint.sliding)}, without solreffriction "
        f"{simulate_creep(joint, solref=DEFAULT_SOLREF):.2g}."
        for joint in joints
        if joint.frictionloss > 0.0 and joint.inertia > 0.0
    ]
    if creep_lines:
        creep_lines.insert(0, creep)
    comments = [*comments, usage, *creep_lines, *_list_hidden_rotors(joints)]
    return _compose_xml(root, comments)


def compose_urdf(joints: Sequence[ReducedJoint], comments: Sequence[str]) -> str:
    """Return `<dynamics>` elements for the joints of a URDF, or of SDF."""
    root = ET.Element("robot", name="friction")
    for joint in joints:
        kind = "prismatic" if joint.sliding else "revolute"
        joint_node = ET.SubElement(root, "joint", name=joint.name, type=kind)
        ET.SubElement(
            joint_node,
            "dynamics",
            damping=_format(joint.damping),
            friction=_format(joint.frictionloss),
        )
    usage = "Copy each <dynamics> into the joint of its name."
    return _compose_xml(root, [*comments, usage])


def compose_isaaclab(joints: Sequence[ReducedJoint], comments: Sequence[str]) -> str:
    """Return an actuator configuration of Isaac Lab (Isaac Sim 5 and newer), as Python."""
    values_by_field = {
        "friction": {joint.name: joint.frictionloss for joint in joints},
        "dynamic_friction": {joint.name: joint.frictionloss for joint in joints},
        "viscous_friction": {joint.name: joint.damping for joint in joints},
        "armature": {joint.name: joint.armature for joint in joints if joint.armature is not None},
    }
    lines = [f"# {comment}" for comment in [*comments, *_list_hidden_rotors(joints)]]
    lines += [
        "# Isaac Sim 5 and newer, where friction is an effort. Stiffness and damping are those of",
        "# your controller.",
        "from isaaclab.actuators import ImplicitActuatorCfg",
        "",
        "FRICTION = ImplicitActuatorCfg(",
        f"    joint_names_expr={json.dumps([joint.name for joint in joints])},",
        "    stiffness=None,",
        "    damping=None,",
    ]
    for field, values in values_by_field.items():
        if values:
            lines.append(f"    {field}={{")
            lines += [
                f"        {json.dumps(name)}: {_format(value)}," for name, value in values.items()
            ]
            lines.append("    },")
    return "\n".join([*lines, ")", ""])


def _list_hidden_rotors(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    """Yield which joints have no inertia of the rotor of their own."""
    hidden = [joint.name for joint in joints if joint.armature is None]
    if hidden:
        yield f"Armature is not separated from the inertia of the links: {', '.join(hidden)}."


def _compose_xml(root: ET.Element, comments: Sequence[str]) -> str:
    """Return a document whose comments precede the first child."""
    for k, comment in enumerate(comments):
        # Two hyphens end a comment.
        root.insert(k, ET.Comment(f" {comment.replace('--', '- -')} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _format(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


MJCF_JOINT = TextFormat(noun="an MJCF", suffixes=(".xml",), compose=compose_mjcf)
URDF_DYNAMICS = TextFormat(noun="a URDF", suffixes=(".urdf", ".xml"), compose=compose_urdf)
ISAACLAB = TextFormat(noun="a Python module", suffixes=(".py",), compose=compose_isaaclab)
