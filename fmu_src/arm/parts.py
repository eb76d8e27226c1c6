"""Signals of an arm as parts of a compiled model, and their FMI variables."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fmu_src.export.interface import Variable

SCALE, PAYLOAD, LATENCY, SEED = "friction_scale", "payload", "latency", "noise_seed"

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
    """An input and the controls that it drives."""

    name: str
    unit: str
    controls: tuple[int, ...]


@dataclass(frozen=True)
class ArmOutput:
    """An output: sensor addresses, factors, whether the friction scale applies; added losses."""

    name: str
    unit: str
    reads: tuple[tuple[int, float, bool], ...]
    losses: tuple[int, ...] = ()
    noise: float | None = None
    stream: int = 0


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
        time, step = times.pop(), float(model.opt.timestep)
        samples, interpolation = model.actuator_history[delayed].T
        if not interpolation.any():
            time = float(np.ceil(time / step - 1e-6)) * step
        return Delay(
            usual=time, longest=float(samples.min()) * step, actuators=tuple(delayed.tolist())
        )


def variables(signals: ArmSignals) -> tuple[Variable, ...]:
    """Return inputs, outputs and the parameters that apply to the model."""
    parameters = tuple(_parameters(signals))
    return (*_connectors(signals, tuple(p.name for p in parameters)), *parameters)


def noise_name(output: ArmOutput) -> str:
    """Return the name of an output's noise level, such as `q_noise[1]` for `q[1]`."""
    stem, bracket, index = output.name.partition("[")
    return f"{stem}_noise{bracket}{index}"


def _connectors(signals: ArmSignals, parameters: tuple[str, ...]) -> Iterator[Variable]:
    for one in signals.inputs:
        text = f"commanded {_KINDS.get(one.unit, 'control')}"
        yield Variable(one.name, "input", text, unit=one.unit)
    for out in signals.outputs:
        text = f"measured {_KINDS.get(out.unit, 'signal')}"
        yield Variable(out.name, "output", text, unit=out.unit, dependencies=parameters)


def _parameters(signals: ArmSignals) -> Iterator[Variable]:
    scaled = any(scaled for o in signals.outputs for _, _, scaled in o.reads)
    if signals.friction or signals.losses or scaled:
        text = "factor on the friction of the elements that are named for it"
        yield Variable(SCALE, "fixed", text, unit="1", start=1.0)
    if signals.payload is not None:
        yield Variable(PAYLOAD, "fixed", "mass of a payload", unit="kg")
    if signals.delay is not None:
        text = "time until a command acts, in whole steps of the simulation"
        yield Variable(LATENCY, "fixed", text, unit="s", start=signals.delay.usual)
    noisy = [output for output in signals.outputs if output.noise is not None]
    halves = (signals.seed & 0xFFFFFFFF, signals.seed >> 32) if noisy else ()
    for k, half in enumerate(halves, start=1):
        text = f"{'low' if k == 1 else 'high'} 32 bits of the noise's seed"
        yield Variable(f"{SEED}[{k}]", "fixed", text, unit="1", start=float(half))
    for start in signals.starts:
        text = "position at the start"
        yield Variable(start.name, "fixed", text, unit=start.unit, start=start.value)
    for out in noisy:
        text = f"standard deviation of the noise of {out.name}"
        yield Variable(noise_name(out), "fixed", text, unit=out.unit, start=out.noise or 0.0)
