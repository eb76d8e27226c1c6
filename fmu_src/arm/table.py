"""TOML file that names the signals of an MJCF; these as parts of a compiled model."""

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from fmu_src.export.interface import Variable
from hesr_model.errors import RuleError
from hesr_model.support.typed_files import Config

SCALE = "friction_scale"
PAYLOAD = "payload"
LATENCY = "latency"
SEED = "noise_seed"

_KINDS = {
    "N.m": "torque",
    "N": "force",
    "rad": "angle",
    "m": "position",
    "rad/s": "speed",
    "m/s": "speed",
}


@dataclass(frozen=True)
class ArmInput:
    """An input and the controls that it drives; `description` replaces that of its unit."""

    name: str
    unit: str
    controls: tuple[int, ...]
    description: str = ""


@dataclass(frozen=True)
class ArmOutput:
    """An output: sensor addresses, factors, whether the friction scale applies; added losses."""

    name: str
    unit: str
    reads: tuple[tuple[int, float, bool], ...]
    losses: tuple[int, ...] = ()
    noise: float | None = None
    stream: int = 0
    description: str = ""


@dataclass(frozen=True)
class ArmStart:
    """A start value: address of a position, and of an activation that balances forces at rest.

    The degrees of freedom with these forces are `held`; `other` is a further position.
    """

    name: str
    unit: str
    position: int
    value: float
    activation: int | None = None
    gain: float = 1.0
    held: tuple[int, ...] = ()
    other: int | None = None


@dataclass(frozen=True, kw_only=True)
class Loss:
    """Dry friction of variable level (`table.Losses`), loaded by springs, gravity at `carrier`."""

    dof: int
    carrier: int
    constant: float
    load: float
    direct: float
    speed: float
    evolution: float
    age: float
    slip: float
    longest: float


@dataclass(frozen=True, kw_only=True)
class Delay:
    """Delay [s] common to all delayed actuators, from a command until it acts.

    Without interpolation the delay in the model is half a step less than whole steps, because
    round-off of summed steps could add or remove one. `longest` is the length of the buffers.
    """

    usual: float
    longest: float
    actuators: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmSignals:
    """All signals of a compiled model."""

    model: Any
    inputs: tuple[ArmInput, ...]
    outputs: tuple[ArmOutput, ...]
    starts: tuple[ArmStart, ...] = ()
    friction: tuple[int, ...] = ()
    losses: tuple[Loss, ...] = ()
    payload: int | None = None
    step: float = 0.0
    seed: int = 0

    @cached_property
    def delay(self) -> Delay | None:
        """None also if actuators have different delays."""
        model = self.model
        delayed = np.flatnonzero(np.asarray(model.actuator_delay) > 0)
        times = set(model.actuator_delay[delayed].tolist())
        if len(times) != 1:
            return None
        time = times.pop()
        step_size = float(model.opt.timestep)
        samples, interpolation = model.actuator_history[delayed].T
        if not interpolation.any():
            time = float(np.ceil(time / step_size - 1e-6)) * step_size
        return Delay(
            usual=time, longest=float(samples.min()) * step_size, actuators=tuple(delayed.tolist())
        )


def variables(signals: ArmSignals) -> tuple[Variable, ...]:
    """Return inputs, outputs and the parameters that apply to the model."""
    parameters = tuple(_parameters(signals))
    return (*_connectors(signals, tuple(variable.name for variable in parameters)), *parameters)


def noise_name(output: ArmOutput) -> str:
    """Return the name of an output's noise level, such as `q_noise[1]` for `q[1]`."""
    stem, bracket, index = output.name.partition("[")
    return f"{stem}_noise{bracket}{index}"


def seed_halves(seed: int) -> tuple[int, int]:
    """Return the low and high 32 bits of a seed as signed integers, which FMI 2.0 has."""
    low, high = struct.unpack("<2i", struct.pack("<Q", seed))
    return low, high


def join_seed_halves(low: int, high: int) -> int:
    """Return the seed of two signed halves."""
    (seed,) = struct.unpack("<Q", struct.pack("<2i", low, high))
    return int(seed)


def _connectors(signals: ArmSignals, parameters: tuple[str, ...]) -> Iterator[Variable]:
    for arm_input in signals.inputs:
        text = arm_input.description or f"commanded {_KINDS.get(arm_input.unit, 'control')}"
        yield Variable(arm_input.name, "input", text, unit=arm_input.unit)
    for arm_output in signals.outputs:
        kind = "measured"
        if arm_output.noise is None:
            kind = "true"
        text = arm_output.description or f"{kind} {_KINDS.get(arm_output.unit, 'signal')}"
        yield Variable(
            arm_output.name, "output", text, unit=arm_output.unit, dependencies=parameters
        )


def _has_scale(signals: ArmSignals) -> bool:
    """Return whether anything follows the friction scale."""
    if signals.friction or signals.losses:
        return True
    return any(map(_reads_scaled_sensors, signals.outputs))


def _reads_scaled_sensors(output: ArmOutput) -> bool:
    return any(scaled for _, _, scaled in output.reads)


def _parameters(signals: ArmSignals) -> Iterator[Variable]:
    if _has_scale(signals):
        text = "factor on the friction of the elements that are named for it"
        yield Variable(SCALE, "fixed", text, unit="1", start=1.0)
    if signals.payload is not None:
        yield Variable(PAYLOAD, "fixed", "mass of a payload", unit="kg")
    if signals.delay is not None:
        text = "time until a command acts, in whole steps of the simulation"
        yield Variable(LATENCY, "fixed", text, unit="s", start=signals.delay.usual)
    noisy = [output for output in signals.outputs if output.noise is not None]
    if noisy:
        low, high = seed_halves(signals.seed)
        for k, text, half in ((1, "low", low), (2, "high", high)):
            text = f"{text} 32 bits of the noise's seed"
            yield Variable(f"{SEED}[{k}]", "fixed", text, integer=True, start=float(half))
    for start in signals.starts:
        text = "position at the start"
        yield Variable(start.name, "fixed", text, unit=start.unit, start=start.value)
    for arm_output in noisy:
        text = f"standard deviation of the noise of {arm_output.name}"
        yield Variable(
            noise_name(arm_output),
            "fixed",
            text,
            unit=arm_output.unit,
            start=arm_output.noise or 0.0,
        )


Names = tuple[str, ...]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Element = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


def require_entries(
    table: Config, count: int, entity: str = "joint", *, besides: Collection[str] = ()
) -> None:
    """Raise ValueError unless the lists of a table have `count` entries or are omitted."""
    for key, entries in table:
        if not isinstance(entries, tuple) or key in besides:
            continue
        omitted = not entries and not type(table).model_fields[key].is_required()
        if len(entries) != count and not omitted:
            raise RuleError(
                f"{key} has {len(entries)} entries; {count} are needed, one per {entity}",
                code="table.entries",
                key=key,
            )


class InputTable(Config):
    """Vector of inputs: the actuators that each element controls."""

    unit: str
    description: str = ""
    actuators: tuple[Names, ...] = Field(min_length=1)


class OutputTable(Config):
    """Vector of outputs: the summed sensors of each element, with their factors.

    Losses of joints are added as torque against the motion; `scaled` sensors follow the friction
    scale; `noise` is a standard deviation. The `description` is by default that of the unit.
    """

    unit: str
    description: str = ""
    sensors: tuple[dict[str, float], ...] = Field(min_length=1)
    losses: Names = ()
    scaled: Names = ()
    noise: tuple[NotNegative, ...] = ()
    streams: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _one_entry_per_element(self) -> Self:
        require_entries(self, len(self.sensors), "element", besides=("scaled",))
        return self


class StartTable(Config):
    """Vector of start values: the joint whose position each element sets.

    Joints in `others` get the same position, actuators in `integrals` the same activation; with
    `hold`, these balance the joints at rest.
    """

    unit: str
    joints: Names = Field(min_length=1)
    others: Names = ()
    integrals: Names = ()
    hold: bool = False

    @model_validator(mode="after")
    def _one_entry_per_joint(self) -> Self:
        require_entries(self, len(self.joints))
        return self


class Losses(Config):
    """Dry friction of variable level, instead of a constant `frictionloss` of joints.

        level = constant + load |torque| + direct ln(1 + |v| / speed) + evolution ln(1 + s / age)
        s' = 1 - (|v| / slip + 1 / longest) s

    The last two terms are rate-and-state friction (ageing law of Dieterich and Ruina). Units are
    N.m, rad, rad/s and s; `load` is a share of the transmitted torque. Lists have one entry per
    joint; omitted terms are zero.
    """

    constant: tuple[NotNegative, ...] = Field(min_length=1)
    load: tuple[NotNegative, ...] = ()
    direct: tuple[NotNegative, ...] = ()
    speed: tuple[Positive, ...] = ()
    evolution: tuple[NotNegative, ...] = ()
    age: tuple[Positive, ...] = ()
    slip: tuple[Positive, ...] = ()
    longest: Positive = 1e4

    def select_joint(self, i: int) -> dict[str, float]:
        """Return the numbers of a joint by key; omitted ones have no effect."""
        scales = ("speed", "age", "slip")
        lists = ("constant", "load", "direct", "evolution", *scales)
        # Terms with the factor 0 and the scale 1 have no effect.
        numbers = {key: float(key in scales) for key in lists}
        for key in lists:
            entries = getattr(self, key)
            if entries:
                numbers[key] = entries[i]
        return numbers | {"longest": self.longest}

    @model_validator(mode="after")
    def _complete(self) -> Self:
        require_entries(self, len(self.constant))
        for key, need in (("direct", "speed"), ("evolution", "age"), ("evolution", "slip")):
            if getattr(self, key) and not getattr(self, need):
                raise RuleError(f"{key} needs {need}", code="losses.needs", key=need)
        return self


class LossTable(Losses):
    """Losses of joints with a `frictionloss`; `carriers` transmit the torque for `load`."""

    joints: Names = Field(min_length=1)
    carriers: Names = ()

    @model_validator(mode="after")
    def _load_has_carriers(self) -> Self:
        if any(self.load) and not self.carriers:
            raise RuleError("load needs carriers", code="losses.carriers", key="carriers")
        return self


class SignalTable(Config):
    """Signals of an MJCF; inputs, outputs and start values by the name of the vector.

    The dcmotors in `friction` and the losses follow the friction scale. The payload is a point
    mass. `step` [s] is by default that of the simulation; `seed` is the noise's.
    """

    inputs: dict[Element, InputTable] = Field(default_factory=dict)
    outputs: dict[Element, OutputTable] = Field(min_length=1)
    start: dict[Element, StartTable] = Field(default_factory=dict)
    friction: Names = ()
    losses: LossTable | None = None
    payload: str | None = None
    step: float | None = Field(default=None, gt=0)
    seed: int = Field(default=0, ge=0, lt=2**64)
