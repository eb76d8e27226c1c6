"""Files with the numbers of joints for simulators, and copies of users' models with them.

Names and units are those of MuJoCo 4, URDF, SDFormat 1.12, Isaac Lab 2.3 and Newton 1.8.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from hesr.extras.reduction.projection import ReducedJoint
from hesr.extras.reduction.soft_friction import (
    DEFAULT_SOLREF,
    SOLREF,
    STEP,
    list_actuator_attributes,
    simulate_creep,
)
from hesr.extras.reduction.xml_copy import XmlCopy, XmlElement
from hesr_model.units import unit_of_joint

_DIGITS = 6
_NOT_JOINTS = ("default", "equality")  # elements of an MJCF whose <joint> is none

Comments = Sequence[str]
Edit = Callable[[XmlCopy, XmlElement, ReducedJoint], list[str]]
"""Sets the numbers of a joint in a copy; returns remarks for the user."""


@dataclass(frozen=True, kw_only=True)
class TextFormat:
    """A file with the numbers of joints.

    Attributes
    ----------
    noun : its name in messages.
    suffixes : allowed ones of the file.
    compose : joints and comments in, text out.
    describe : joints in, lines on what the format means or loses out.
    is_joint : whether an element of a user's model is one of the joints of its name; None if the
        format has no such model.
    edit : sets the numbers in a user's model.
    """

    noun: str
    suffixes: tuple[str, ...]
    compose: Callable[[Sequence[ReducedJoint], Comments], str]
    describe: Callable[[Sequence[ReducedJoint]], Iterator[str]]
    is_joint: Callable[[XmlElement], bool] | None = None
    edit: Edit | None = None


def format_number(value: float) -> str:
    """Return a number as it is written into files."""
    return f"{value:.{_DIGITS}g}"


# --- MuJoCo ---------------------------------------------------------------------------------------


def _list_mjcf_attributes(joint: ReducedJoint) -> dict[str, str]:
    attributes = {
        "damping": format_number(joint.damping),
        "frictionloss": format_number(joint.frictionloss),
        "solreffriction": SOLREF,
    }
    if joint.armature is not None:
        attributes["armature"] = format_number(joint.armature)
    return attributes


def compose_mjcf(joints: Sequence[ReducedJoint], comments: Comments) -> str:
    """Return defaults of MuJoCo, one class per joint, for `<include>` in a model."""
    root = ET.Element("mujoco")
    defaults = ET.SubElement(root, "default")
    for joint in joints:
        default_class = ET.SubElement(defaults, "default", {"class": joint.name})
        ET.SubElement(default_class, "joint", _list_mjcf_attributes(joint))
    servos = {joint.name: joint.servo for joint in joints if joint.servo is not None}
    if servos:
        actuators = ET.SubElement(root, "actuator")
        for name, servo in servos.items():
            ET.SubElement(actuators, "position", {"joint": name, **list_actuator_attributes(servo)})
    usage = "Include this file, and give each joint the class of its name."
    return _compose_xml(root, [*comments, usage])


def _describe_mjcf(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    """Yield how a held joint creeps: MuJoCo's Coulomb friction is a soft constraint."""
    creep_lines = [
        f"{joint.name}: {simulate_creep(joint):.2g} "
        f"{unit_of_joint('rad/s', is_prismatic=joint.sliding)}, without solreffriction "
        f"{simulate_creep(joint, solref=DEFAULT_SOLREF):.2g}."
        for joint in joints
        if joint.frictionloss > 0.0 and joint.inertia > 0.0
    ]
    if creep_lines:
        yield (
            "MuJoCo's Coulomb friction is soft: under half of it a held joint creeps, at a step "
            f"of {1e3 * STEP:g} ms:"
        )
        yield from creep_lines
    yield from _list_hidden_rotors(joints)


def _is_mjcf_joint(element: XmlElement) -> bool:
    in_other = element.parent is not None and element.parent.tag in _NOT_JOINTS
    return element.tag == "joint" and not in_other


def _edit_mjcf(copy: XmlCopy, element: XmlElement, joint: ReducedJoint) -> list[str]:
    """Set attributes of the joint, which win over those of its class, and of its servo."""
    copy.set_attributes(element, _list_mjcf_attributes(joint))
    if joint.servo is None:
        return []
    attributes = list_actuator_attributes(joint.servo)
    servos = [
        other
        for other in copy.root.list_elements()
        if other.tag == "position" and other.attributes.get("joint") == joint.name
    ]
    for servo in servos:
        copy.set_attributes(servo, attributes)
        copy.remove_attribute(servo, "dampratio")  # MuJoCo refuses it beside kv
    if servos:
        return []
    markup = ET.tostring(
        ET.Element("position", {"joint": joint.name, **attributes}), encoding="unicode"
    )
    return [f"{copy.path}: no <position> acts on joint '{joint.name}'; add {markup}."]


# --- URDF and SDF ---------------------------------------------------------------------------------


def _compose_dynamics(joint: ReducedJoint) -> str:
    element = ET.Element("dynamics", _list_urdf_attributes(joint))
    return ET.tostring(element, encoding="unicode")


def _list_urdf_attributes(joint: ReducedJoint) -> dict[str, str]:
    return {
        "damping": format_number(joint.damping),
        "friction": format_number(joint.frictionloss),
    }


def compose_urdf(joints: Sequence[ReducedJoint], comments: Comments) -> str:
    """Return `<dynamics>` elements for the joints of a URDF."""
    root = ET.Element("robot", name="friction")
    for joint in joints:
        kind = "prismatic" if joint.sliding else "revolute"
        joint_node = ET.SubElement(root, "joint", name=joint.name, type=kind)
        ET.SubElement(joint_node, "dynamics", _list_urdf_attributes(joint))
    usage = "Copy each <dynamics> into the joint of its name."
    return _compose_xml(root, [*comments, usage])


def _is_urdf_joint(element: XmlElement) -> bool:
    at_root = element.parent is not None and element.parent.parent is None
    return element.tag == "joint" and at_root


def _edit_urdf(copy: XmlCopy, element: XmlElement, joint: ReducedJoint) -> list[str]:
    dynamics = element.find_child("dynamics")
    if dynamics is None:
        copy.append(element, _compose_dynamics(joint))
    else:
        copy.set_attributes(dynamics, _list_urdf_attributes(joint))
    return []


def compose_sdf(joints: Sequence[ReducedJoint], comments: Comments) -> str:
    """Return `<dynamics>` elements for the axes of the joints of an SDF."""
    root = ET.Element("sdf", version="1.12")
    model = ET.SubElement(root, "model", name="friction")
    for joint in joints:
        kind = "prismatic" if joint.sliding else "revolute"
        joint_node = ET.SubElement(model, "joint", name=joint.name, type=kind)
        axis = ET.SubElement(joint_node, "axis")
        dynamics = ET.SubElement(axis, "dynamics")
        for name, value in _list_urdf_attributes(joint).items():
            ET.SubElement(dynamics, name).text = value
    usage = "Copy each <dynamics> into the <axis> of the joint of its name."
    return _compose_xml(root, [*comments, usage])


def _is_sdf_joint(element: XmlElement) -> bool:
    in_model = element.parent is not None and element.parent.tag == "model"
    return element.tag == "joint" and in_model


def _edit_sdf(copy: XmlCopy, element: XmlElement, joint: ReducedJoint) -> list[str]:
    axis = element.find_child("axis")
    if axis is None:
        copy.refuse(f"joint '{joint.name}' has no <axis>")
    values = _list_urdf_attributes(joint)
    dynamics = axis.find_child("dynamics")
    if dynamics is None:
        content = "".join(f"<{name}>{value}</{name}>" for name, value in values.items())
        copy.append(axis, f"<dynamics>{content}</dynamics>")
        return []
    missing = []
    for name, value in values.items():
        child = dynamics.find_child(name)
        if child is None:
            missing.append(f"<{name}>{value}</{name}>")
        else:
            copy.set_text(child, value)
    if missing:
        copy.append(dynamics, "".join(missing))
    return []


def _describe_dynamics(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    """Yield what `<dynamics>` cannot state."""
    rotors = [
        f"{joint.name} {format_number(joint.armature)}"
        for joint in joints
        if joint.armature is not None
    ]
    if rotors:
        yield (
            f"<dynamics> has no armature; inertias of rotors at joints: {', '.join(rotors)} kg.m2."
        )
    if any(joint.servo is not None for joint in joints):
        yield "<dynamics> has no servo; give its numbers to your controller."
    yield "How a simulator turns these numbers into friction was not run here."


# --- Isaac Lab and Newton -------------------------------------------------------------------------


def compose_isaaclab(joints: Sequence[ReducedJoint], comments: Comments) -> str:
    """Return an actuator configuration of Isaac Lab (Isaac Sim 5 and newer), as Python."""
    lines = [f"# {comment}" for comment in comments]
    lines += [
        "from isaaclab.actuators import ImplicitActuatorCfg",
        "",
        "FRICTION = ImplicitActuatorCfg(",
        f"    joint_names_expr={json.dumps([joint.name for joint in joints])},",
    ]
    for field, values in _list_isaaclab_fields(joints).items():
        if values:
            lines += [f"    {field}={{", *_list_items(values), "    },"]
        elif field in ("stiffness", "damping"):
            lines.append(f"    {field}=None,")
    return "\n".join([*lines, ")", ""])


def _list_isaaclab_fields(joints: Sequence[ReducedJoint]) -> dict[str, dict[str, float]]:
    """Return the values by joint of each field of an actuator, in the order of the file."""
    fields: dict[str, dict[str, float]] = {
        "stiffness": {},
        "damping": {},
        "effort_limit_sim": {},
        "friction": {},
        "dynamic_friction": {},
        "viscous_friction": {},
        "armature": {},
    }
    for joint in joints:
        if joint.servo is not None:
            fields["stiffness"][joint.name] = joint.servo.kp
            fields["damping"][joint.name] = joint.servo.kd
            if joint.servo.torque_limit is not None:
                fields["effort_limit_sim"][joint.name] = joint.servo.torque_limit
        fields["friction"][joint.name] = joint.frictionloss
        fields["dynamic_friction"][joint.name] = joint.frictionloss
        fields["viscous_friction"][joint.name] = joint.damping
        if joint.armature is not None:
            fields["armature"][joint.name] = joint.armature
    return fields


def _list_items(values: Mapping[str, float]) -> Iterator[str]:
    for name, value in values.items():
        yield f"        {json.dumps(name)}: {format_number(value)},"


def _describe_isaaclab(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    yield from _list_hidden_rotors(joints)
    yield "For Isaac Sim 5 and newer, where friction is an effort; before, it was a coefficient."
    if all(joint.servo is None for joint in joints):
        yield "Stiffness and damping are those of your controller."
    yield "PhysX's own form of friction was not run here."


_NEWTON = '''
def set_numbers(builder):
    """Set the numbers in a newton.ModelBuilder that has the joints, before `finalize`."""
    for name, numbers in JOINTS.items():
        matches = [
            joint
            for joint, label in enumerate(builder.joint_label)
            if label == name or label.endswith("/" + name)
        ]
        if len(matches) != 1:
            raise ValueError(f"{len(matches)} joints have the name {name!r}; expected one")
        dof = builder.joint_qd_start[matches[0]]
        for attribute, value in numbers.items():
            getattr(builder, attribute)[dof] = value
'''


def compose_newton(joints: Sequence[ReducedJoint], comments: Comments) -> str:
    """Return a Python module that sets the numbers in a builder of Newton."""
    lines = [f"# {comment}" for comment in comments]
    lines.append("JOINTS = {")
    for joint in joints:
        numbers = {"joint_friction": joint.frictionloss, "joint_damping": joint.damping}
        if joint.armature is not None:
            numbers["joint_armature"] = joint.armature
        if joint.servo is not None:
            numbers["joint_target_ke"] = joint.servo.kp
            numbers["joint_target_kd"] = joint.servo.kd
            if joint.servo.torque_limit is not None:
                numbers["joint_effort_limit"] = joint.servo.torque_limit
        lines += [f"    {json.dumps(joint.name)}: {{", *_list_items(numbers), "    },"]
    return "\n".join([*lines, "}", _NEWTON])


def _describe_newton(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    yield from _list_hidden_rotors(joints)
    yield "For Newton 1.3 and newer; before, joints had no damping beside that of their drives."
    yield "Newton's solvers differ in what they use of it; their form of friction was not run here."


def _list_hidden_rotors(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    """Yield which joints have no inertia of the rotor of their own."""
    hidden = [joint.name for joint in joints if joint.armature is None]
    if hidden:
        yield f"Armature is not separated from the inertia of the links: {', '.join(hidden)}."


def _compose_xml(root: ET.Element, comments: Comments) -> str:
    """Return a document whose comments precede the first child."""
    for k, comment in enumerate(comments):
        # Two hyphens end a comment.
        root.insert(k, ET.Comment(f" {comment.replace('--', '- -')} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


MJCF_JOINT = TextFormat(
    noun="an MJCF",
    suffixes=(".xml",),
    compose=compose_mjcf,
    describe=_describe_mjcf,
    is_joint=_is_mjcf_joint,
    edit=_edit_mjcf,
)
URDF_DYNAMICS = TextFormat(
    noun="a URDF",
    suffixes=(".urdf", ".xml"),
    compose=compose_urdf,
    describe=_describe_dynamics,
    is_joint=_is_urdf_joint,
    edit=_edit_urdf,
)
SDF_DYNAMICS = TextFormat(
    noun="an SDF",
    suffixes=(".sdf", ".world", ".xml"),
    compose=compose_sdf,
    describe=_describe_dynamics,
    is_joint=_is_sdf_joint,
    edit=_edit_sdf,
)
ISAACLAB = TextFormat(
    noun="a Python module",
    suffixes=(".py",),
    compose=compose_isaaclab,
    describe=_describe_isaaclab,
)
NEWTON = TextFormat(
    noun="a Python module",
    suffixes=(".py",),
    compose=compose_newton,
    describe=_describe_newton,
)
