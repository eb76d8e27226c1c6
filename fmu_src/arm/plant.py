"""The arm of a digital twin: its MJCF, servo and measurement noise, and the signals of its FMU."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from fmu_src.arm.signals import SENSORS_OF_JOINT, passive_motors, select_signals
from fmu_src.arm.table import (
    ArmSignals,
    InputTable,
    OutputTable,
    SignalTable,
    StartTable,
    require_entries,
)
from fmu_src.arm.truth import Truth, TruthName
from hesr_model.errors import ConfigError, RuleError
from hesr_model.robots.mjcf import compile_model
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Config, RelativePath


class Servo(Config):
    """Servo in the MJCF, one entry per joint: commanded actuators, integral, sensors of torque.

    The integral is a commanded actuator whose state is the integrated command, a position.
    """

    commanded: tuple[tuple[str, ...], ...]
    integral: tuple[str, ...]
    torque: tuple[str, ...]


class Noise(Config):
    """Standard deviations of white normal noise per joint: torque [N.m], encoder [rad]."""

    seed: int
    torque: tuple[float, ...]
    encoder: tuple[float, ...]

    @field_validator("torque", "encoder")
    @classmethod
    def _not_negative(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(value < 0 for value in values):
            raise RuleError("standard deviations must not be negative", code="plant.noise")
        return values


class Plant(Config):
    """Properties of an arm that the MJCF lacks, with joints from base to tip.

    `sample_rate` is that of logs and commands [Hz]; `truths` replace the friction of the MJCF.
    """

    model: RelativePath
    joints: tuple[str, ...] = Field(min_length=1)
    sample_rate: float = Field(gt=0)
    servo: Servo
    noise: Noise
    truths: Mapping[TruthName, Truth] = {}

    @field_validator("servo", "noise")
    @classmethod
    def _one_entry_per_joint(cls, table: Config, info: ValidationInfo) -> Config:
        joints = info.data.get("joints")
        if joints:
            require_entries(table, len(joints))
        return table


def joint_limits(plant: Plant) -> Array:
    """Return the lowest and highest position (n, 2) [rad] of each joint."""
    model = compile_model(plant.model)
    for joint in plant.joints:
        _require(model, "joint", joint, plant)
    return np.array([model.joint(joint).range for joint in plant.joints])


def servo_signals(
    plant: Plant, coulomb: Array | float = 1.0, viscous: Array | float = 1.0
) -> ArmSignals:
    """Return the signals of an arm without a signal table.

    Friction is that of the passive dcmotors and the damping of the joints; the measured torque
    includes gravity compensation. The factors, scalar or (n,), apply to the dcmotors.
    """
    joint_limits(plant)  # rejects files that MuJoCo's specification reader accepts
    spec = mujoco.MjSpec.from_file(str(plant.model))
    force = mujoco.mjtSensor.mjSENS_ACTUATORFRC
    object_types = mujoco.mjtObj
    for i, actuator in enumerate(spec.actuators):
        actuator_name = actuator.name or f"/actuator{i}"
        actuator.name = actuator_name
        spec.add_sensor(
            name=f"/{actuator_name}",
            type=force,
            objtype=object_types.mjOBJ_ACTUATOR,
            objname=actuator_name,
        )
    for joint in plant.joints:
        spec.joint(joint).actgravcomp = True
        for suffix, kind in SENSORS_OF_JOINT.items():
            name = f"/{joint}/{suffix}"
            spec.add_sensor(name=name, type=kind, objtype=object_types.mjOBJ_JOINT, objname=joint)
    model = spec.compile()
    for sensor in plant.servo.torque:
        _require(model, "sensor", sensor, plant)
    elements = [passive_motors(model, joint) for joint in plant.joints]
    levels = np.broadcast_to(coulomb, len(elements))
    rates = np.broadcast_to(viscous, len(elements))
    for joint_elements, level, rate in zip(elements, levels, rates, strict=True):
        model.actuator_dynprm[joint_elements, 5] *= level  # bristle stiffness
        model.actuator_biasprm[np.ix_(joint_elements, (3, 4))] *= level
        model.actuator_damping[joint_elements] *= rate
    return select_signals(model, plant.model, _table(model, plant, elements))


def _table(model: Any, plant: Plant, elements: Sequence[Sequence[int]]) -> SignalTable:
    """Return the signals of an arm with sensors of its joints and actuators, see `servo_signals`.

    `elements` are the passive dcmotors of each joint.
    """

    def read_joints(suffix: str) -> tuple[dict[str, float], ...]:
        return tuple({f"/{joint}/{suffix}": 1.0} for joint in plant.joints)

    joint_torques = read_joints("tau")
    friction: list[str] = []
    torque_sensors = []
    friction_sensors = []
    for j, joint in enumerate(plant.joints):
        names = [model.actuator(i).name for i in elements[j]]
        friction += names
        # A dcmotor drives the joint, friction acts against its motion.
        forces = {f"/{name}": -1.0 for name in names}
        damping = model.joint(joint).damping[0] + model.actuator_damping[elements[j]].sum()
        torque_sensors.append(joint_torques[j] | forces)
        friction_sensors.append(forces | {f"/{joint}/dq": float(damping)})
    tau = tuple(torque_sensors)
    speeds = tuple(f"/{joint}/dq" for joint in plant.joints)
    streams = tuple(range(2 * len(plant.joints)))
    noise = plant.noise
    servo = plant.servo
    q = read_joints("q")
    start = StartTable(unit="rad", joints=plant.joints, integrals=servo.integral, hold=True)
    outputs = {
        "q": OutputTable(unit="rad", sensors=q, noise=noise.encoder, streams=streams[1::2]),
        "tau_meas": OutputTable(unit="N.m", sensors=tau, noise=noise.torque, streams=streams[::2]),
        "q_true": OutputTable(unit="rad", sensors=q),
        "dq_true": OutputTable(unit="rad/s", sensors=read_joints("dq")),
        "tau_true": OutputTable(unit="N.m", sensors=tau),
        "tau_f_true": OutputTable(unit="N.m", sensors=tuple(friction_sensors), scaled=speeds),
    }
    return SignalTable(
        seed=noise.seed % 2**64,
        step=1.0 / plant.sample_rate,
        friction=tuple(friction),
        inputs={"dq_cmd": InputTable(unit="rad/s", actuators=servo.commanded)},
        outputs=outputs,
        start={"q0": start},
    )


def _require(model: Any, kind: str, name: str, plant: Plant) -> None:
    try:
        getattr(model, kind)(name)
    except KeyError as error:
        raise ConfigError(f"{plant.model}: has no {kind} '{name}'.") from error
