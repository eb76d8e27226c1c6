"""Signals of an MJCF: those named by a table, or every control and sensor."""

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
_UNITS = {sensor: unit for unit, sensors in _SENSORS.items() for sensor in sensors}
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
        model = self._model
        loss_joints = table.losses.joints if table.losses else ()
        outputs = [
            o for name, v in table.outputs.items() for o in self._outputs(name, v, loss_joints)
        ]
        inputs = [
            ArmInput(
                f"{name}[{i}]",
                vector.unit,
                tuple(map(self._control, actuators)),
                vector.description,
            )
            for name, vector in table.inputs.items()
            for i, actuators in enumerate(vector.actuators, start=1)
        ]
        return ArmSignals(
            model=model,
            inputs=tuple(inputs),
            outputs=tuple(
                o if o.stream >= 0 else replace(o, stream=k) for k, o in enumerate(outputs)
            ),
            starts=tuple(s for name, v in table.start.items() for s in self._starts(name, v)),
            friction=tuple(map(self._motor, table.friction)),
            losses=tuple(self._losses(table.losses)) if table.losses else (),
            payload=None if table.payload is None else self._find("body", table.payload),
            step=table.step or float(model.opt.timestep),
            seed=table.seed,
        )

    def _outputs(
        self, name: str, vector: OutputTable, loss_joints: Sequence[str]
    ) -> Iterator[ArmOutput]:
        for i, sensors in enumerate(vector.sensors):
            element_losses = vector.losses[i : i + 1]
            if element_losses and element_losses[0] not in loss_joints:
                raise self._error(
                    f"joint '{element_losses[0]}' of 'outputs.{name}.losses' has no losses."
                )
            yield ArmOutput(
                f"{name}[{i + 1}]",
                vector.unit,
                tuple((self._sensor(s), k, s in vector.scaled) for s, k in sensors.items()),
                losses=tuple(map(loss_joints.index, element_losses)),
                noise=vector.noise[i] if vector.noise else None,
                stream=vector.streams[i] if vector.streams else -1,
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
            carrier = self._dof(table.carriers[i]) if table.carriers else -1
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


def build_all_signals(model: Any) -> ArmSignals:
    """Return all controls as inputs, all sensors as outputs, and start positions of all joints."""
    names = _Names()
    inputs = tuple(
        arm_input for i in range(model.nactuator) for arm_input in _inputs(model, i, names)
    )
    outputs = tuple(output for i in range(model.nsensor) for output in _outputs(model, i, names))
    starts = []
    for i, kind in enumerate(map(_J, model.jnt_type)):
        if kind in SCALAR_JOINT_TYPES:
            name = names.make_unique(f"start_{model.joint(i).name or f'joint{i + 1}'}", "")
            unit = "rad" if kind == _J.mjJNT_HINGE else "m"
            address = int(model.jnt_qposadr[i])
            starts.append(ArmStart(name, unit, address, float(model.qpos0[address])))
    step_size = float(model.opt.timestep)
    return ArmSignals(
        model=model, inputs=inputs, outputs=outputs, starts=tuple(starts), step=step_size
    )


class _Names:
    def __init__(self) -> None:
        self._used: set[str] = {"latency"}

    def make_unique(self, name: str, default: str) -> str:
        identifier = "".join(c if c.isalnum() and c.isascii() else "_" for c in name) or default
        identifier = f"_{identifier}" if identifier[0].isdigit() else identifier
        numbered = chain([identifier], (f"{identifier}_{k}" for k in count(2)))
        unique_name = next(name for name in numbered if name not in self._used)
        self._used.add(unique_name)
        return unique_name


def _inputs(model: Any, actuator: int, names: _Names) -> Iterator[ArmInput]:
    size = int(model.actuator_ctrlnum[actuator])
    address = int(model.actuator_ctrladr[actuator])
    name = (
        names.make_unique(model.actuator(actuator).name, f"control{actuator + 1}") if size else ""
    )
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
    return f"[{k + 1}]" if size > 1 else ""


def _unit(model: Any, sensor: int) -> str:
    kind = _S(model.sensor_type[sensor])
    if kind in _UNITS_AT_JOINT:
        hinge = _J(model.jnt_type[model.sensor_objid[sensor]]) == _J.mjJNT_HINGE
        return _UNITS_AT_JOINT[kind][0 if hinge else 1]
    return _UNITS.get(kind, "1")
