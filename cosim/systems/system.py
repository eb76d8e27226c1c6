"""A system of FMUs as a TOML file describes it: components, start values, connections, steps."""

from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from fmu_src.run.master import Order
from hesr_model.support.config import Config, RelativePath

Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
Signal = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*\.\S+$")]
"""`component.variable`; without an index it stands for all elements of a vector."""
Value = bool | int | float | str | tuple[float, ...]

_MULTIPLE = 1e-9  # relative; how exactly a step has to be a multiple of another
_MOST_STEPS = 10**9  # of a run
_MOST_COMPONENTS = 1000


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        raise ValueError(f"the limits {bounds[0]:g} and {bounds[1]:g} leave nothing between them")
    return bounds


Bounds = Annotated[tuple[float, float], AfterValidator(_ordered)]


class ComponentSpec(Config):
    """One FMU of a system.

    Attributes
    ----------
    name : in this system.
    fmu : the file.
    start : values of parameters, inputs and states before the initialisation: a number, a list for
        all elements of a vector, or the name of a choice.
    step : its own step [s], a multiple of the system's; the system's where not given.
    """

    name: Name
    fmu: RelativePath
    start: Mapping[str, Value] = {}
    step: float | None = Field(default=None, gt=0.0)


class SystemSpec(Config):
    """A system of FMUs.

    Attributes
    ----------
    name : of the system.
    step : communication step [s].
    stop : end of the run, which starts at 0 [s].
    order : "gauss_seidel" or "jacobi"; see `fmu_src.run.master.ExchangeScheme`.
    components : in the order in which they are stepped.
    connections : for each connected input the output that feeds it.
    observe : signals whose values are kept.
    limits : lowest and highest value of signals; the run stops where one is left.
    """

    name: str = "system"
    step: float = Field(gt=0.0)
    stop: float = Field(gt=0.0)
    order: Order = "gauss_seidel"
    components: tuple[ComponentSpec, ...] = Field(min_length=1, max_length=_MOST_COMPONENTS)
    connections: Mapping[Signal, Signal] = {}
    observe: tuple[Signal, ...] = ()
    limits: Mapping[Signal, Bounds | tuple[Bounds, ...]] = {}

    @model_validator(mode="after")
    def _names_and_steps_fit(self) -> Self:
        for name, count in Counter(c.name for c in self.components).items():
            if count > 1:
                raise ValueError(f"two components are named '{name}'")
        _multiple_of(self.stop, self.step, "the stop time")
        for component in self.components:
            if component.step is not None:
                _multiple_of(component.step, self.step, f"the step of '{component.name}'")
        return self

    @property
    def steps(self) -> int:
        """How many communication steps a run has."""
        return round(self.stop / self.step)

    def every(self, component: ComponentSpec) -> int:
        """How many communication steps one step of a component has."""
        return round((component.step or self.step) / self.step)


def _multiple_of(time: float, step: float, what: str) -> None:
    """Check that a time is a positive integer multiple of the communication step."""
    if not time / step <= _MOST_STEPS:
        raise ValueError(
            f"{what} is {time:g} s, {time / step:.3g} communication steps of {step:g} s; at most "
            f"{_MOST_STEPS:g} can be done"
        )
    count = round(time / step)
    if count < 1 or abs(time - count * step) > _MULTIPLE * time:
        raise ValueError(f"{what} is {time:g} s, no multiple of the communication step, {step:g} s")
