"""Inputs, outputs and start values of an FMU, as parts of a compiled model."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np


@dataclass(frozen=True)
class ArmInput:
    """One input: its controls in the model."""

    name: str
    unit: str
    controls: tuple[int, ...]


@dataclass(frozen=True)
class ArmOutput:
    """One output: its reads are sensor addresses, factors, and whether the friction scale applies.

    `losses` are indices of losses that are added.
    """

    name: str
    unit: str
    reads: tuple[tuple[int, float, bool], ...]
    losses: tuple[int, ...] = ()
    noise: float | None = None
    stream: int = 0


@dataclass(frozen=True)
class ArmStart:
    """Start value: address of a position, and of an activation that balances forces at rest.

    `held` are the degrees of freedom with these forces; `other` is a further position with this
    start.
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
    """Dry friction of variable level at a degree of freedom; see `fmu_src.arm.table.Losses`.

    Springs and gravity compensation of the degree of freedom `carrier` are the load.
    """

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

    Without interpolation a command acts at the first step after the delay in the model. The time is
    then in whole steps, and the model gets half a step less: otherwise round-off of summed steps
    would now and then change it by one step. `longest` is the length of the buffers.
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
