"""Default signals of an MJCF: every control, sensor and joint position."""

from collections.abc import Iterator
from typing import Any

import mujoco

from fmu_src.arm.parts import ArmInput, ArmOutput, ArmSignals, ArmStart

_S, _J = mujoco.mjtSensor, mujoco.mjtJoint

SINGLE = (_J.mjJNT_HINGE, _J.mjJNT_SLIDE)
"""Types of joints with a scalar position."""

_UNITS = {
    _S.mjSENS_ACCELEROMETER: "m/s2",
    _S.mjSENS_VELOCIMETER: "m/s",
    _S.mjSENS_GYRO: "rad/s",
    _S.mjSENS_FORCE: "N",
    _S.mjSENS_TORQUE: "N.m",
    _S.mjSENS_RANGEFINDER: "m",
    _S.mjSENS_FRAMEPOS: "m",
    _S.mjSENS_FRAMELINVEL: "m/s",
    _S.mjSENS_FRAMEANGVEL: "rad/s",
    _S.mjSENS_FRAMELINACC: "m/s2",
    _S.mjSENS_FRAMEANGACC: "rad/s2",
    _S.mjSENS_SUBTREECOM: "m",
    _S.mjSENS_SUBTREELINVEL: "m/s",
    _S.mjSENS_CLOCK: "s",
    _S.mjSENS_E_POTENTIAL: "J",
    _S.mjSENS_E_KINETIC: "J",
}
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
    starts = tuple(
        ArmStart(
            name=names.of(f"start_{model.joint(i).name or f'joint{i + 1}'}", ""),
            unit="rad" if kind == _J.mjJNT_HINGE else "m",
            position=int(model.jnt_qposadr[i]),
            value=float(model.qpos0[model.jnt_qposadr[i]]),
        )
        for i, kind in enumerate(map(_J, model.jnt_type))
        if kind in SINGLE
    )
    return ArmSignals(
        model=model, inputs=inputs, outputs=outputs, starts=starts, step=float(model.opt.timestep)
    )


class _Names:
    """Unique FMI names from names that are unique only within their kind."""

    def __init__(self) -> None:
        self._used: set[str] = {"latency"}

    def of(self, name: str, otherwise: str) -> str:
        """Replace characters that FMI forbids by underscores, and number duplicates."""
        plain = "".join(c if c.isalnum() and c.isascii() else "_" for c in name) or otherwise
        plain = f"_{plain}" if plain[0].isdigit() else plain
        free, k = plain, 1
        while free in self._used:
            k += 1
            free = f"{plain}_{k}"
        self._used.add(free)
        return free


def _inputs(model: Any, actuator: int, names: _Names) -> Iterator[ArmInput]:
    size, address = int(model.actuator_ctrlnum[actuator]), int(model.actuator_ctrladr[actuator])
    name = names.of(model.actuator(actuator).name, f"control{actuator + 1}") if size else ""
    for k in range(size):
        yield ArmInput(name=name + _index(k, size), unit="1", controls=(address + k,))


def _outputs(model: Any, sensor: int, names: _Names) -> Iterator[ArmOutput]:
    name = names.of(model.sensor(sensor).name, f"sensor{sensor + 1}")
    size, address = int(model.sensor_dim[sensor]), int(model.sensor_adr[sensor])
    for k in range(size):
        yield ArmOutput(
            name=name + _index(k, size),
            unit=_unit(model, sensor),
            reads=((address + k, 1.0, False),),
        )


def _index(k: int, size: int) -> str:
    return f"[{k + 1}]" if size > 1 else ""


def _unit(model: Any, sensor: int) -> str:
    kind = _S(model.sensor_type[sensor])
    if kind in _UNITS_AT_JOINT:
        hinge = _J(model.jnt_type[model.sensor_objid[sensor]]) == _J.mjJNT_HINGE
        return _UNITS_AT_JOINT[kind][0 if hinge else 1]
    return _UNITS.get(kind, "1")
