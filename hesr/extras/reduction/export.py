"""Export of the numbers of joints, as a file or in a copy of a model, with their price."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hesr.extras.reduction.formats import TextFormat
from hesr.extras.reduction.positions import (
    ServoRun,
    add_position_price,
    assume_servos,
    find_inertias,
    predict_friction,
    read_commands,
)
from hesr.extras.reduction.projection import LogRecords, ReducedJoint, Weight, reduce_model
from hesr.extras.reduction.soft_friction import STEP
from hesr.extras.reduction.xml_copy import XmlCopy, XmlElement
from hesr_model.errors import ExportError
from hesr_model.friction.log_friction import LogSource, read_log
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.files import written_whole
from hesr_model.support.text import join_with_or
from hesr_model.units import unit_of_joint

_INERTIA_ROWS = 200  # number of positions for the mean of inertias
_REFERENCES = ("file", "filename")  # attributes with paths of other files
_SAME_MASS = 1e-3  # relative difference of masses that is not mentioned


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
    kp: Sequence[float] | None = None,
    into: Path | None = None,
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
    kp : gains of servos for the price in positions [N.m/rad], by default those of the robot file;
        laws from commands have their servos.
    into : model of the user, of which a copy with the numbers is written.

    Raises
    ------
    ExportError
        If the file has another suffix, a joint stands still, its law does not oppose motion, or the
        model of the user lacks it.
    LogError, RobotError, SimulationError
        If a log cannot be read, or log, body and law are of different robots.
    """
    if path.suffix not in text_format.suffixes:
        raise ExportError(
            f"{path}: {text_format.noun} ends in {join_with_or(text_format.suffixes)}, found "
            f"'{path.suffix}'."
        )
    copy = None
    elements: list[XmlElement] = []
    remarks: list[str] = []
    if into is not None:  # first, as the rest takes longer
        copy = XmlCopy(into)
        elements = [find_joint(copy, text_format, joint) for joint in model.joints]
    training = _read_parts(log, robot)
    tests = _read_parts(test_log, robot)
    if model.servos:
        joints = _reduce_from_commands(model, training, tests, robot, weight)
    else:
        joints = _reduce_from_torques(model, training, tests, robot, rigid_body, weight, kp)
    price_lines = list(_describe_price(joints, is_held_back=bool(tests)))
    comments = [
        f"Friction of '{model.robot}' by the law '{model.law}', reduced to numbers per joint.",
        "They hold at the speeds and loads below, and replace no other term of the law.",
        *price_lines,
        *_describe_servos(joints),
        *text_format.describe(joints),
    ]
    if copy is None:
        data = text_format.compose(joints, comments).encode()
    else:
        data, remarks = edit_copy(copy, text_format, joints, elements, comments)
    with written_whole(path) as temporary:
        temporary.write_bytes(data)
    if copy is not None:
        remarks.extend(_describe_references(copy, path))
    return [*price_lines, *remarks]


def _read_parts(sources: Sequence[LogSource], robot: Robot) -> list[Log]:
    """Return the parts between gaps of all logs."""
    parts: list[Log] = []
    for source in sources:
        parts += read_log(source, robot).parts()
    return parts


def _reduce_from_commands(
    model: FrictionModel,
    training: Sequence[Log],
    tests: Sequence[Log],
    robot: Robot,
    weight: Weight,
) -> list[ReducedJoint]:
    """Return the numbers of laws that were fitted to commands, with their servos."""
    training_run = read_commands(model, training, robot)
    test_run = training_run
    if tests:
        test_run = read_commands(model, tests, robot)
    joints = reduce_model(
        model,
        predict_friction(model, training_run),
        predict_friction(model, test_run),
        None,
        find_inertias(training_run),
        weight,
    )
    driven_joints = []
    for joint, fitted in zip(joints, model.servos, strict=True):
        armature = fitted.servo.armature or None
        driven_joints.append(replace(joint, servo=fitted.servo, armature=armature))
    return _add_positions(model, driven_joints, test_run)


def _reduce_from_torques(
    model: FrictionModel,
    training: Sequence[Log],
    tests: Sequence[Log],
    robot: Robot,
    rigid_body: RigidBody | None,
    weight: Weight,
    kp: Sequence[float] | None,
) -> list[ReducedJoint]:
    """Return the numbers of laws of torques."""
    body = rigid_body or model.rigid_body
    training_records = _separate_friction(model, training, robot, rigid_body)
    test_records = None
    if tests:
        test_records = _separate_friction(model, tests, robot, rigid_body)
    inertias = _find_mean_inertias(robot, body, training_records)
    joints = reduce_model(model, training_records, test_records, body, inertias, weight)
    gains = kp or _find_stated_gains(robot)
    if gains is None:
        return joints
    return _add_positions(model, joints, assume_servos(gains, tests or training, robot, body))


def _find_stated_gains(robot: Robot) -> Sequence[float] | None:
    """Return the gains of the servos in the robot file [N.m/rad], if it states them."""
    servo = robot.description.servo
    gains = [servo.find_stated("kp", j, robot.n) for j in range(robot.n)]
    stated_gains = [gain for gain in gains if gain is not None]
    if len(stated_gains) < robot.n:
        return None
    return stated_gains


def _add_positions(
    model: FrictionModel, joints: Sequence[ReducedJoint], run: ServoRun
) -> list[ReducedJoint]:
    return [
        add_position_price(joint, model.laws[j], run.servos[j], run, j)
        for j, joint in enumerate(joints)
    ]


def _separate_friction(
    model: FrictionModel, logs: Sequence[Log], robot: Robot, rigid_body: RigidBody | None
) -> LogRecords:
    return [model.records(log, rigid_body=rigid_body, robot=robot) for log in logs]


def _find_mean_inertias(robot: Robot, body: RigidBody | None, records: LogRecords) -> list[float]:
    """Return the inertia at each joint [kg.m2], the mean over positions of the logs."""
    parameters = robot.nominal_parameters if body is None else body.parameters_for(robot)
    positions = []
    for log_records in records:
        joint_positions = [record.q for record in log_records]
        positions.append(np.stack(joint_positions, axis=1))
    q = np.concatenate(positions)
    step = max(1, len(q) // _INERTIA_ROWS)
    mass_matrices, _ = robot.dynamics(parameters, q[::step], np.zeros_like(q[::step]))
    diagonals = np.diagonal(mass_matrices, axis1=1, axis2=2)
    return [float(inertia) for inertia in np.mean(diagonals, axis=0)]


# --- words ----------------------------------------------------------------------------------------


def _describe_price(joints: Sequence[ReducedJoint], *, is_held_back: bool) -> Iterator[str]:
    """Yield the price of each joint as one line, and that in positions as another."""
    rows = "logs that were not used for them" if is_held_back else "the logs of the projection"
    errors = "RMSE of the law and of the numbers"
    if joints[0].servo is not None:
        errors = "RMSE of the numbers against the law"
    yield f"Price on {rows}: {errors}, variance lost, energy kept:"
    for joint in joints:
        price = joint.price
        force = unit_of_joint("N.m", is_prismatic=joint.sliding)
        speed = unit_of_joint("rad/s", is_prismatic=joint.sliding)
        rmses = f"{price.law_rmse:.4g} and {price.rmse:.4g}"
        if joint.servo is not None:
            rmses = f"{price.rmse:.4g}"
        if price.spread is not None:
            lowest, highest = price.spread
            rmses += f" ({lowest:.4g} to {highest:.4g} in single logs)"
        low_speed, high_speed = (f"{value:.3g}" for value in price.speeds)
        low_load, high_load = (f"{value:.3g}" for value in price.loads)
        yield (
            f"{joint.name}: {rmses} {force}, "
            f"{100.0 * price.lost_variance:.2g} %, {100.0 * price.energy:.4g} %; speeds of "
            f"{low_speed} to {high_speed} {speed}, loads of {low_load} to {high_load} {force}."
        )
    yield from _describe_positions(joints)


def _describe_positions(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    for joint in joints:
        price = joint.positions
        if price is None:
            continue
        unit = "mm" if joint.sliding else "mrad"
        gain = unit_of_joint("N.m/rad", is_prismatic=joint.sliding)
        numbers = f"{1e3 * price.numbers:.3g}"
        in_mujoco = f"{1e3 * price.in_mujoco:.3g}"
        if np.isinf(price.in_mujoco):
            in_mujoco = "unstable"
        in_mujoco += f" in MuJoCo at steps of {1e3 * STEP:g} ms"
        if price.is_measured:
            yield (
                f"{joint.name}: position RMSE from commands {1e3 * price.law:.3g} {unit} with the "
                f"law, {numbers} with the numbers, {in_mujoco}."
            )
        else:
            yield (
                f"{joint.name}: under a servo of {price.kp:.4g} {gain} the numbers move it "
                f"{numbers} {unit} (RMSE) from where the law does, {in_mujoco}."
            )


def _describe_servos(joints: Sequence[ReducedJoint]) -> Iterator[str]:
    """Yield what was fitted beside friction, also what a simulator has no number for."""
    for joint in joints:
        servo = joint.servo
        if servo is None:
            continue
        steps = round(servo.latency / STEP)
        parts = [
            f"kp {servo.kp:.4g}, kd {servo.kd:.4g}",
            f"delay of commands {1e3 * servo.latency:.3g} ms ({steps} steps of {1e3 * STEP:g} ms)",
        ]
        if servo.ki:
            parts.append(f"integral gain {servo.ki:.4g}")
        if servo.kd:
            parts.append("kd acts on the error of speeds")
        if servo.torque_limit is not None:
            parts.append(f"torque limit {servo.torque_limit:.4g}")
        if servo.command_filter:
            parts.append(f"filter of commands {1e3 * servo.command_filter:.3g} ms")
        if servo.speed_limit is not None:
            parts.append(f"speed limit of commands {servo.speed_limit:.4g}")
        if abs(servo.body_factor - 1.0) > _SAME_MASS:
            parts.append(f"links {servo.body_factor:.4g} times as heavy as in the model file")
        yield f"{joint.name}: servo with {', '.join(parts)}."


# --- copies ---------------------------------------------------------------------------------------


def find_joint(copy: XmlCopy, text_format: TextFormat, joint: str) -> XmlElement:
    """Return the element of a joint; raises ExportError unless there is exactly one."""
    assert text_format.is_joint is not None
    elements = [
        element
        for element in copy.root.list_elements()
        if element.attributes.get("name") == joint and text_format.is_joint(element)
    ]
    if len(elements) == 1:
        return elements[0]
    if elements:
        raise ExportError(f"{copy.path}: has {len(elements)} joints '{joint}'; expected one.")
    includes = [
        element.attributes.get("file", "")
        for element in copy.root.list_elements()
        if element.tag == "include"
    ]
    remedy = ""
    if includes:
        remedy = f"; if it is in an included file ({', '.join(includes)}), give that one"
    raise ExportError(f"{copy.path}: has no joint '{joint}' of the law{remedy}.")


def edit_copy(
    copy: XmlCopy,
    text_format: TextFormat,
    joints: Sequence[ReducedJoint],
    elements: Sequence[XmlElement],
    comments: Sequence[str],
) -> tuple[bytes, list[str]]:
    """Return the bytes of a copy with the numbers, and remarks."""
    assert text_format.edit is not None
    remarks = []
    for joint, element in zip(joints, elements, strict=True):
        remarks += text_format.edit(copy, element, joint)
    copy.set_comment(comments)
    return copy.to_bytes(), remarks


def _describe_references(copy: XmlCopy, path: Path) -> Iterator[str]:
    """Yield a remark if a copy in another folder refers to files beside its original."""
    if path.resolve().parent == copy.path.resolve().parent:
        return
    for element in copy.root.list_elements():
        for name in _REFERENCES:
            file = element.attributes.get(name, "")
            if file and "://" not in file and not Path(file).is_absolute():
                yield f"{path}: refers to files beside {copy.path}; keep it in that folder."
                return
