"""Which parts of an MJCF are the inputs, outputs and start values of an FMU."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
from pydantic import Field, model_validator

from hesr_model.config import Config, read_toml
from hesr_model.errors import ConfigError

Names = tuple[str, ...]
Element = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


class InputTable(Config):
    """A vector of inputs.

    Attributes
    ----------
    unit : of every element.
    actuators : for each element those whose control it is.
    """

    unit: str
    actuators: tuple[Names, ...] = Field(min_length=1)


class OutputTable(Config):
    """A vector of outputs.

    Attributes
    ----------
    unit : of every element.
    sensors : for each element the sensors that are summed, with their factors.
    scaled : sensors whose factor follows the friction scale.
    noise : standard deviation of each element's noise; none where left out.
    streams : of the noise, one for each element; their places among all outputs where left out.
    """

    unit: str
    sensors: tuple[dict[str, float], ...] = Field(min_length=1)
    scaled: Names = ()
    noise: tuple[Annotated[float, Field(ge=0)], ...] = ()
    streams: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _one_entry_per_element(self) -> "OutputTable":
        for key in ("noise", "streams"):
            entries = getattr(self, key)
            if entries and len(entries) != len(self.sensors):
                raise ValueError(f"{key} has {len(entries)} entries for {len(self.sensors)} elements")
        return self


class StartTable(Config):
    """A vector of start values.

    Attributes
    ----------
    unit : of every element.
    joints : the joint whose position each element is.
    integrals : the actuator whose activation each element is as well.
    hold : an output whose value at rest the integrals hold, divided by their gain.
    """

    unit: str
    joints: Names = Field(min_length=1)
    integrals: Names = ()
    hold: str | None = None


class SignalTable(Config):
    """The signals of an MJCF.

    Attributes
    ----------
    inputs, outputs, start : by the name of the vector.
    friction : dcmotor actuators that the friction scale applies to.
    payload : body that a payload's mass is added to, as a point at its centre of mass.
    step : preferred communication step [s]; the simulation's own where left out.
    seed : of the noise.
    """

    inputs: dict[Element, InputTable] = {}
    outputs: dict[Element, OutputTable] = Field(min_length=1)
    start: dict[Element, StartTable] = {}
    friction: Names = ()
    payload: str | None = None
    step: float | None = Field(default=None, gt=0)
    seed: int = Field(default=0, ge=0, lt=2**64)


@dataclass(frozen=True, kw_only=True)
class Input:
    """One input: its controls in the model."""

    name: str
    unit: str
    controls: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Output:
    """One output: addresses in the sensor data with factors, those that follow the scale; noise."""

    name: str
    unit: str
    reads: tuple[tuple[int, float, bool], ...]
    noise: float | None = None
    stream: int = 0


@dataclass(frozen=True, kw_only=True)
class Start:
    """One start value: addresses of a position and perhaps of an activation that holds an output."""

    name: str
    unit: str
    position: int
    value: float
    activation: int | None = None
    gain: float = 1.0
    held: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Signals:
    """All signals of a compiled model."""

    model: Any
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    starts: tuple[Start, ...] = ()
    friction: tuple[int, ...] = ()
    payload: int | None = None
    step: float = 0.0
    seed: int = 0
    names: dict[str, str] = field(default_factory=dict)


def compiled(path: Path) -> Any:
    """Return the MuJoCo model of an MJCF.

    Raises
    ------
    ConfigError
        If the file is missing or cannot be compiled.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: no such model file.")
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise ConfigError(f"{path}: cannot be compiled as an MJCF ({reason}).") from error


def signals_of(path: Path, table: Path | None = None) -> Signals:
    """Return the signals of an MJCF: those of a table, or every control and every sensor.

    Parameters
    ----------
    path : the MJCF.
    table : TOML file, see `SignalTable`.

    Raises
    ------
    ConfigError
        If a file is missing or not valid, names a part that the model lacks, or there is nothing
        to be seen of the model.
    """
    model = compiled(path)
    if table is not None:
        return _Lookup(model, table).signals(read_toml(table, SignalTable))
    inputs = [
        Input(name=_identifier(model.actuator(i).name, "control", i), unit="1",
              controls=(int(model.actuator_ctrladr[i]),))
        for i in range(len(model.actuator_ctrladr))
        if model.actuator_ctrladr[i] >= 0
    ]  # fmt: skip
    outputs = [
        Output(name=_identifier(model.sensor(i).name, "sensor", i) + (f"[{k + 1}]" if n > 1 else ""),
               unit="1", reads=((int(model.sensor_adr[i]) + k, 1.0, False),))
        for i, n in enumerate(model.sensor_dim)
        for k in range(n)
    ]  # fmt: skip
    starts = [
        Start(name=f"start_{_identifier(model.joint(i).name, 'joint', i)}", unit="1",
              position=int(model.jnt_qposadr[i]), value=float(model.qpos0[model.jnt_qposadr[i]]))
        for i, kind in enumerate(model.jnt_type)
        if kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    ]  # fmt: skip
    if not outputs:
        raise ConfigError(f"{path}: has no sensor, so an FMU of it would have no output.")
    return Signals(
        model=model, inputs=tuple(inputs), outputs=tuple(outputs), starts=tuple(starts),
        step=float(model.opt.timestep),
    )  # fmt: skip


def _identifier(name: str, kind: str, index: int) -> str:
    return "".join(c if c.isalnum() and c.isascii() else "_" for c in name) or f"{kind}{index + 1}"


class _Lookup:
    """Finds the parts that a table names."""

    def __init__(self, model: Any, table: Path) -> None:
        self._model, self._table = model, table

    def signals(self, table: SignalTable) -> Signals:
        model = self._model
        outputs = [o for name, vector in table.outputs.items() for o in self._outputs(name, vector)]
        named = {o.name for o in outputs}
        for name, start in table.start.items():
            if start.hold is not None and f"{start.hold}[1]" not in named:
                raise ConfigError(
                    f"{self._table}: key 'start.{name}.hold': there is no output '{start.hold}'."
                )
        return Signals(
            model=model,
            inputs=tuple(
                Input(
                    name=f"{name}[{i}]",
                    unit=vector.unit,
                    controls=tuple(self._control(actuator) for actuator in actuators),
                )
                for name, vector in table.inputs.items()
                for i, actuators in enumerate(vector.actuators, start=1)
            ),
            outputs=tuple(
                o if o.stream >= 0 else Output(**{**vars(o), "stream": k})
                for k, o in enumerate(outputs)
            ),
            starts=tuple(
                s for name, vector in table.start.items() for s in self._starts(name, vector)
            ),
            friction=tuple(self._find("actuator", name).id for name in table.friction),
            payload=None if table.payload is None else self._find("body", table.payload).id,
            step=table.step or float(model.opt.timestep),
            seed=table.seed,
        )

    def _outputs(self, name: str, vector: OutputTable) -> list[Output]:
        return [
            Output(
                name=f"{name}[{i + 1}]",
                unit=vector.unit,
                reads=tuple(
                    (int(self._model.sensor_adr[self._find("sensor", s).id]), factor,
                     s in vector.scaled)
                    for s, factor in sensors.items()
                ),
                noise=vector.noise[i] if vector.noise else None,
                stream=vector.streams[i] if vector.streams else -1,
            )
            for i, sensors in enumerate(vector.sensors)
        ]  # fmt: skip

    def _starts(self, name: str, vector: StartTable) -> list[Start]:
        model = self._model
        if vector.integrals and len(vector.integrals) != len(vector.joints):
            raise ConfigError(
                f"{self._table}: key 'start.{name}.integrals' has {len(vector.integrals)} entries "
                f"for {len(vector.joints)} joints."
            )
        found = []
        for i, joint in enumerate(vector.joints):
            position = int(model.jnt_qposadr[self._find("joint", joint).id])
            actuator = self._find("actuator", vector.integrals[i]).id if vector.integrals else None
            found.append(
                Start(
                    name=f"{name}[{i + 1}]",
                    unit=vector.unit,
                    position=position,
                    value=float(model.qpos0[position]),
                    activation=None if actuator is None else int(model.actuator_actadr[actuator]),
                    gain=1.0 if actuator is None else float(model.actuator_gainprm[actuator, 0]),
                    held=None if vector.hold is None else f"{vector.hold}[{i + 1}]",
                )
            )
        return found

    def _control(self, actuator: str) -> int:
        address = int(self._model.actuator_ctrladr[self._find("actuator", actuator).id])
        if address < 0:
            raise ConfigError(f"{self._table}: actuator '{actuator}' takes no control.")
        return address

    def _find(self, kind: str, name: str) -> Any:
        try:
            return getattr(self._model, kind)(name)
        except KeyError as error:
            raise ConfigError(f"{self._table}: the model has no {kind} '{name}'.") from error


def delays(model: Any) -> tuple[float, float]:
    """Return the delay of the model's actuators and the longest that their buffers hold [s]."""
    delayed = np.flatnonzero(np.asarray(model.actuator_delay) > 0)
    if not len(delayed):
        return 0.0, 0.0
    longest = float(np.min(model.actuator_history[delayed, 0])) * float(model.opt.timestep)
    return float(np.max(model.actuator_delay[delayed])), longest
