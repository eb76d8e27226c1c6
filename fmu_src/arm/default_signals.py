"""Default signals of an MJCF: every control, sensor and joint position."""

from collections.abc import Iterator
from itertools import chain, count
from typing import Any

import mujoco

from fmu_src.arm.parts import ArmInput, ArmOutput, ArmSignals, ArmStart

_S, _J = mujoco.mjtSensor, mujoco.mjtJoint

SINGLE = (_J.mjJNT_HINGE, _J.mjJNT_SLIDE)  # types of joints with a scalar position

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


def everything(model: Any) -> ArmSignals:
    """Return every control as an input, every sensor as outputs, every joint's start position."""
    names = _Names()
    inputs = tuple(one for i in range(model.nactuator) for one in _inputs(model, i, names))
    outputs = tuple(output for i in range(model.nsensor) for output in _outputs(model, i, names))
    starts = []
    for i, kind in enumerate(map(_J, model.jnt_type)):
        if kind in SINGLE:
            name = names.of(f"start_{model.joint(i).name or f'joint{i + 1}'}", "")
            unit = "rad" if kind == _J.mjJNT_HINGE else "m"
            place = int(model.jnt_qposadr[i])
            starts.append(ArmStart(name, unit, place, float(model.qpos0[place])))
    step = float(model.opt.timestep)
    return ArmSignals(model=model, inputs=inputs, outputs=outputs, starts=tuple(starts), step=step)


class _Names:
    """Unique FMI names from names that are unique only within their kind."""

    def __init__(self) -> None:
        self._used: set[str] = {"latency"}

    def of(self, name: str, otherwise: str) -> str:
        """Replace characters that FMI forbids by underscores, and number duplicates."""
        plain = "".join(c if c.isalnum() and c.isascii() else "_" for c in name) or otherwise
        plain = f"_{plain}" if plain[0].isdigit() else plain
        numbered = chain([plain], (f"{plain}_{k}" for k in count(2)))
        free = next(name for name in numbered if name not in self._used)
        self._used.add(free)
        return free


def _inputs(model: Any, actuator: int, names: _Names) -> Iterator[ArmInput]:
    size, address = int(model.actuator_ctrlnum[actuator]), int(model.actuator_ctrladr[actuator])
    name = names.of(model.actuator(actuator).name, f"control{actuator + 1}") if size else ""
    for k in range(size):
        yield ArmInput(name + _index(k, size), "1", (address + k,))


def _outputs(model: Any, sensor: int, names: _Names) -> Iterator[ArmOutput]:
    name = names.of(model.sensor(sensor).name, f"sensor{sensor + 1}")
    size, address = int(model.sensor_dim[sensor]), int(model.sensor_adr[sensor])
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
