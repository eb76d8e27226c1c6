"""Signals of an MJCF: those named by a table, or every control and sensor."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fmu_src.arm.table import (
    ArmInput,
    ArmOutput,
    ArmSignals,
    ArmStart,
    InputTable,
    Loss,
    LossTable,
    OutputTable,
    SignalTable,
    StartTable,
)
from hesr_model.errors import ConfigError
from hesr_model.robots.mjcf import compile_model, compile_spec

_S = mujoco.mjtSensor
_J = mujoco.mjtJoint

SCALAR_JOINT_TYPES = (_J.mjJNT_HINGE, _J.mjJNT_SLIDE)  # types of joints with a scalar position
_SCALAR_UNITS = {_J.mjJNT_HINGE: "rad", _J.mjJNT_SLIDE: "m"}

_SENSORS = {
    "m": (_S.mjSENS_RANGEFINDER, _S.mjSENS_FRAMEPOS, _S.mjSENS_SUBTREECOM),
    "m/s": (_S.mjSENS_VELOCIMETER, _S.mjSENS_FRAMELINVEL, _S.mjSENS_SUBTREELINVEL),
    "m/s2": (_S.mjSENS_ACCELEROMETER, _S.mjSENS_FRAMELINACC),
    "rad/s": (_S.mjSENS_GYRO, _S.mjSENS_FRAMEANGVEL),
    "rad/s2": (_S.mjSENS_FRAMEANGACC,),
    "N": (_S.mjSENS_FORCE,),
    "N.m": (_S.mjSENS_TORQUE,),
    "s": (_S.mjSENS_CLOCK,),
    "J": (_S.mjSENS_E_POTENTIAL, _S.mjSENS_E_KINETIC),
}
_UNITS: dict[Any, str] = {}
for _unit_text, _sensor_types in _SENSORS.items():
    _UNITS |= dict.fromkeys(_sensor_types, _unit_text)
_UNITS_AT_JOINT = {
    _S.mjSENS_JOINTPOS: ("rad", "m"),
    _S.mjSENS_JOINTVEL: ("rad/s", "m/s"),
    _S.mjSENS_JOINTACTFRC: ("N.m", "N"),
}
SENSORS_OF_JOINT = {"q": _S.mjSENS_JOINTPOS, "dq": _S.mjSENS_JOINTVEL, "tau": _S.mjSENS_JOINTACTFRC}


def passive_motors(model: Any, joint: str | None = None) -> list[int]:
    """Return the dcmotors without control, which act as friction; on one joint if named."""
    passive = (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR) & (
        np.asarray(model.actuator_ctrlnum) == 0
    )
    if joint is not None:
        passive &= model.actuator_trnid[:, 0] == model.joint(joint).id
    return np.flatnonzero(passive).tolist()


def select_signals(model: Any, file: Path, table: SignalTable) -> ArmSignals:
    """Return the signals of a compiled model that a table names; errors name `file`."""
    return _Lookup(model, file).signals(table)


def read_signals(path: Path, table: Path | SignalTable | None = None) -> ArmSignals:
    """Return the signals of an MJCF: those of a table or its file, or every control and sensor.

    A file without sensors, such as a URDF, receives those of its joints, and one without actuators
    a motor per joint.
    """
    model = compile_model(path)
    if isinstance(table, SignalTable):
        return select_signals(model, path, table)
    if table is not None:
        return select_signals(model, table, SignalTable.read(table))
    if not model.nsensor:
        model = compile_spec(path, _add_joint_signals)
    if not model.nsensor:
        raise ConfigError(
            f"{path}: has neither a sensor nor a hinge or slide, so an FMU of it would have no "
            "output; add a sensor."
        )
    return build_all_signals(model)


def _add_joint_signals(spec: Any) -> None:
    """Add sensors of position, speed and torque to all joints, and motors to a file without."""
    passive = not list(spec.actuators)
    joint_type = mujoco.mjtObj.mjOBJ_JOINT
    for number, joint in enumerate(spec.joints, start=1):
        if joint.type in SCALAR_JOINT_TYPES:
            joint.name = joint.name or f"joint{number}"
            for stem, kind in SENSORS_OF_JOINT.items():
                name = f"{stem}_{joint.name}"
                spec.add_sensor(name=name, type=kind, objtype=joint_type, objname=joint.name)
            if passive:
                motor = spec.add_actuator(name=f"tau_{joint.name}", target=joint.name)
                motor.trntype = mujoco.mjtTrn.mjTRN_JOINT


class _Lookup:
    def __init__(self, model: Any, file: Path) -> None:
        self._model = model
        self._file = file

    def signals(self, table: SignalTable) -> ArmSignals:
        """Return the signals of a table; the first error of the table is raised."""
        outputs = _number_streams(self._all_outputs(table))
        inputs: list[ArmInput] = []
        for name, input_vector in table.inputs.items():
            inputs += self._inputs(name, input_vector)
        starts: list[ArmStart] = []
        for name, start_vector in table.start.items():
            starts += self._starts(name, start_vector)
        friction = tuple(map(self._motor, table.friction))
        losses: list[Loss] = []
        if table.losses is not None:
            losses += self._losses(table.losses)
        payload = None
        if table.payload is not None:
            payload = self._find("body", table.payload)
        return ArmSignals(
            model=self._model,
            inputs=tuple(inputs),
            outputs=outputs,
            starts=tuple(starts),
            friction=friction,
            losses=tuple(losses),
            payload=payload,
            step=table.step or float(self._model.opt.timestep),
            seed=table.seed,
        )

    def _inputs(self, name: str, vector: InputTable) -> Iterator[ArmInput]:
        for i, actuators in enumerate(vector.actuators, start=1):
            controls = tuple(map(self._control, actuators))
            yield ArmInput(f"{name}[{i}]", vector.unit, controls, vector.description)

    def _all_outputs(self, table: SignalTable) -> list[ArmOutput]:
        loss_joints: Sequence[str] = ()
        if table.losses is not None:
            loss_joints = table.losses.joints
        outputs: list[ArmOutput] = []
        for name, vector in table.outputs.items():
            outputs += self._outputs(name, vector, loss_joints)
        return outputs

    def _outputs(
        self, name: str, vector: OutputTable, loss_joints: Sequence[str]
    ) -> Iterator[ArmOutput]:
        for i, sensors in enumerate(vector.sensors):
            element_losses = vector.losses[i : i + 1]
            if element_losses and element_losses[0] not in loss_joints:
                raise self._error(
                    f"joint '{element_losses[0]}' of 'outputs.{name}.losses' has no losses."
                )
            noise = None
            if vector.noise:
                noise = vector.noise[i]
            stream = -1
            if vector.streams:
                stream = vector.streams[i]
            yield ArmOutput(
                f"{name}[{i + 1}]",
                vector.unit,
                tuple((self._sensor(s), k, s in vector.scaled) for s, k in sensors.items()),
                losses=tuple(map(loss_joints.index, element_losses)),
                noise=noise,
                stream=stream,
                description=vector.description,
            )

    def _starts(self, name: str, vector: StartTable) -> Iterator[ArmStart]:
        if vector.hold and not vector.integrals:
            raise self._error(f"key 'start.{name}.hold' needs 'integrals' that hold it.")
        for i, joint in enumerate(vector.joints):
            position = self._position(joint)
            value = float(self._model.qpos0[position])
            start = ArmStart(f"{name}[{i + 1}]", vector.unit, position, value)
            if vector.integrals:
                activation, gain = self._activation(vector.integrals[i])
                start = replace(start, activation=activation, gain=gain)
            start_joints = (joint, *vector.others[i : i + 1])
            if vector.hold:
                start = replace(start, held=tuple(map(self._dof, start_joints)))
            if vector.others:
                start = replace(start, other=self._position(start_joints[1]))
            yield start

    def _losses(self, table: LossTable) -> Iterator[Loss]:
        for i, joint in enumerate(table.joints):
            dof = self._dof(joint)
            if not self._model.dof_frictionloss[dof] > 0:
                raise self._error(f"joint '{joint}' has losses; it needs a frictionloss above 0.")
            carrier = -1
            if table.carriers:
                carrier = self._dof(table.carriers[i])
            yield Loss(dof=dof, carrier=carrier, **table.select_joint(i))

    def _dof(self, name: str) -> int:
        self._position(name)
        return int(self._model.jnt_dofadr[self._find("joint", name)])

    def _control(self, name: str) -> int:
        actuator = self._find("actuator", name)
        size = self._model.actuator_ctrlnum[actuator]
        self._require_one(size, f"actuator '{name}' takes {size} controls")
        return int(self._model.actuator_ctrladr[actuator])

    def _sensor(self, name: str) -> int:
        sensor = self._find("sensor", name)
        size = self._model.sensor_dim[sensor]
        self._require_one(size, f"sensor '{name}' has {size} numbers")
        return int(self._model.sensor_adr[sensor])

    def _require_one(self, size: int, observation: str) -> None:
        if size != 1:
            raise self._error(f"{observation}; expected exactly one.")

    def _position(self, name: str) -> int:
        joint_id = self._find("joint", name)
        if mujoco.mjtJoint(self._model.jnt_type[joint_id]) not in SCALAR_JOINT_TYPES:
            raise self._error(f"joint '{name}' is not a hinge or slide.")
        return int(self._model.jnt_qposadr[joint_id])

    def _activation(self, name: str) -> tuple[int, float]:
        actuator = self._find("actuator", name)
        address = int(self._model.actuator_actadr[actuator])
        gain = float(self._model.actuator_gainprm[actuator, 0])
        if address < 0 or gain == 0:
            raise self._error(f"actuator '{name}' is not an integral: it lacks a state or a gain.")
        return address, gain

    def _motor(self, name: str) -> int:
        actuator = self._find("actuator", name)
        if self._model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_DCMOTOR:
            raise self._error(
                f"actuator '{name}' is not a dcmotor; only the friction of dcmotors can be scaled."
            )
        return actuator

    def _find(self, kind: str, name: str) -> int:
        try:
            return int(getattr(self._model, kind)(name).id)
        except KeyError as error:
            raise self._error(f"the model has no {kind} '{name}'.") from error

    def _error(self, reason: str) -> ConfigError:
        return ConfigError(f"{self._file}: {reason}")


def _number_streams(outputs: Sequence[ArmOutput]) -> tuple[ArmOutput, ...]:
    """Return outputs whose streams of noise are numbered, where the table states none."""
    numbered = []
    for k, output in enumerate(outputs):
        if output.stream < 0:
            output = replace(output, stream=k)
        numbered.append(output)
    return tuple(numbered)


def build_all_signals(model: Any) -> ArmSignals:
    """Return all controls as inputs, all sensors as outputs, and start positions of all joints."""
    names = _Names()
    inputs: list[ArmInput] = []
    for i in range(model.nactuator):
        inputs += _inputs(model, i, names)
    outputs: list[ArmOutput] = []
    for i in range(model.nsensor):
        outputs += _outputs(model, i, names)
    starts = []
    for i, kind in enumerate(map(_J, model.jnt_type)):
        if kind in SCALAR_JOINT_TYPES:
            name = names.make_unique(f"start_{model.joint(i).name or f'joint{i + 1}'}", "")
            unit = _SCALAR_UNITS[kind]
            address = int(model.jnt_qposadr[i])
            starts.append(ArmStart(name, unit, address, float(model.qpos0[address])))
    step_size = float(model.opt.timestep)
    return ArmSignals(
        model=model,
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        starts=tuple(starts),
        step=step_size,
    )


class _Names:
    def __init__(self) -> None:
        self._used: set[str] = {"latency"}

    def make_unique(self, name: str, default: str) -> str:
        """Return a name as an identifier that no other signal has; `default` if it is empty."""
        identifier = re.sub("[^A-Za-z0-9]", "_", name) or default
        if identifier[0].isdigit():
            identifier = f"_{identifier}"
        numbered = chain([identifier], (f"{identifier}_{k}" for k in count(2)))
        unique_name = next(name for name in numbered if name not in self._used)
        self._used.add(unique_name)
        return unique_name


def _inputs(model: Any, actuator: int, names: _Names) -> Iterator[ArmInput]:
    size = int(model.actuator_ctrlnum[actuator])
    if not size:
        return
    address = int(model.actuator_ctrladr[actuator])
    name = names.make_unique(model.actuator(actuator).name, f"control{actuator + 1}")
    for k in range(size):
        yield ArmInput(name + _index(k, size), _unit_of_control(model, actuator), (address + k,))


def _unit_of_control(model: Any, actuator: int) -> str:
    """Return the unit of a control: that of torque or force if it is one on a joint."""
    kinds = (model.actuator_gaintype, model.actuator_biastype, model.actuator_dyntype)
    direct = all(kind[actuator] == 0 for kind in kinds) and model.actuator_gainprm[actuator, 0] == 1
    at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    if not (direct and at_joint and model.actuator_gear[actuator, 0] == 1):
        return "1"
    joint = model.jnt_type[model.actuator_trnid[actuator, 0]]
    return {_J.mjJNT_HINGE: "N.m", _J.mjJNT_SLIDE: "N"}.get(_J(joint), "1")


def _outputs(model: Any, sensor: int, names: _Names) -> Iterator[ArmOutput]:
    name = names.make_unique(model.sensor(sensor).name, f"sensor{sensor + 1}")
    size = int(model.sensor_dim[sensor])
    address = int(model.sensor_adr[sensor])
    for k in range(size):
        reads = ((address + k, 1.0, False),)
        yield ArmOutput(name + _index(k, size), _unit(model, sensor), reads)


def _index(k: int, size: int) -> str:
    if size == 1:
        return ""
    return f"[{k + 1}]"


def _unit(model: Any, sensor: int) -> str:
    kind = _S(model.sensor_type[sensor])
    if kind in _UNITS_AT_JOINT:
        at_hinge, at_slide = _UNITS_AT_JOINT[kind]
        if _J(model.jnt_type[model.sensor_objid[sensor]]) == _J.mjJNT_HINGE:
            return at_hinge
        return at_slide
    return _UNITS.get(kind, "1")
