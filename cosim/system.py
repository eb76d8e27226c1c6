"""A system of FMUs as a TOML file describes it: components, start values, connections, steps."""

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cosim.component import Component
from hesr_model.config import Config, RelativePath
from hesr_model.errors import ConfigError

Order = Literal["gauss_seidel", "jacobi"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
Signal = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*\.\S+$")]
"""`component.variable`; without an index it stands for all elements of a vector."""
Value = float | int | str | tuple[float, ...]
Bounds = tuple[float, float]

_MULTIPLE = 1e-9  # relative; how exactly a step has to be a multiple of another


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
    order : "gauss_seidel" steps the components in their order, each with the newest outputs of the
        others; "jacobi" gives all of them the outputs of the last communication point.
    components : in the order in which they are stepped.
    connections : for each connected input the output that feeds it.
    observe : signals whose values are kept.
    limits : lowest and highest value of signals; the run stops where one is left.
    """

    name: str = "system"
    step: float = Field(gt=0.0)
    stop: float = Field(gt=0.0)
    order: Order = "gauss_seidel"
    components: tuple[ComponentSpec, ...] = Field(min_length=1)
    connections: Mapping[Signal, Signal] = {}
    observe: tuple[Signal, ...] = ()
    limits: Mapping[Signal, Bounds | tuple[Bounds, ...]] = {}

    @model_validator(mode="after")
    def _names_and_steps_fit(self) -> Self:
        names = [component.name for component in self.components]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two components are named '{name}'")
        multiple_of(self.stop, self.step, "the stop time")
        for component in self.components:
            if component.step is not None:
                multiple_of(component.step, self.step, f"the step of '{component.name}'")
        return self

    @property
    def steps(self) -> int:
        """How many communication steps a run has."""
        return round(self.stop / self.step)


def multiple_of(time: float, step: float, what: str) -> int:
    """Return how many steps a time is.

    Raises
    ------
    ValueError
        If it is no positive integer multiple.
    """
    count = round(time / step)
    if count < 1 or abs(time - count * step) > _MULTIPLE * time:
        raise ValueError(f"{what} is {time:g} s, no multiple of the communication step, {step:g} s")
    return count


class Wiring:
    """The signals of a system, checked against the descriptions of its FMUs.

    Parameters
    ----------
    spec : the system.
    slaves : its loaded components by name.
    path : file of the system, for messages.

    Attributes
    ----------
    sources : for each connected input (component, variable) the output that feeds it.

    Raises
    ------
    ConfigError
        Naming the file and the signal: if it does not exist, does not fit what it is connected to,
        or an input that an output needs has no value; if outputs depend on themselves.
    """

    def __init__(self, spec: SystemSpec, slaves: Mapping[str, Component], path: Path) -> None:
        self._slaves, self._path = slaves, path
        self.sources: dict[tuple[str, str], tuple[str, str]] = {}
        for target, source in spec.connections.items():
            self._connect(target, source)
        self._require_inputs(spec)
        self._require_no_loop()

    def elements(self, signal: str) -> list[tuple[str, str]]:
        """Return component and variable of each element of a signal."""
        name, _, variable = signal.partition(".")
        if name not in self._slaves:
            raise ConfigError(
                f"{self._path}: signal '{signal}': there is no component '{name}'; there are "
                f"{', '.join(self._slaves)}."
            )
        return [(name, element) for element in self._slaves[name].elements(variable)]

    def _connect(self, target: str, source: str) -> None:
        inputs, outputs = self.elements(target), self.elements(source)
        where = f"{self._path}: connection '{target}' = '{source}'"
        if len(inputs) != len(outputs):
            raise ConfigError(
                f"{where}: {len(inputs)} inputs cannot be fed by {len(outputs)} outputs."
            )
        for into, out in zip(inputs, outputs, strict=True):
            taken, given = (self._slaves[name].variable(variable) for name, variable in (into, out))
            if taken.causality != "input" or given.causality != "output":
                wrong, kind = (into, "input") if taken.causality != "input" else (out, "output")
                raise ConfigError(f"{where}: '{'.'.join(wrong)}' is no {kind}.")
            if taken.type != given.type or taken.type != "Real":
                raise ConfigError(
                    f"{where}: an input of type {taken.type} and an output of type {given.type}; "
                    "both must be Real."
                )
            if taken.unit and given.unit and taken.unit != given.unit:
                raise ConfigError(
                    f"{where}: the input is in {taken.unit}, the output in {given.unit}."
                )
            if into in self.sources:
                raise ConfigError(f"{where}: '{'.'.join(into)}' is connected twice.")
            self.sources[into] = out

    def _require_inputs(self, spec: SystemSpec) -> None:
        """Every input that an output depends on has a source or a start value in the file."""
        for component in spec.components:
            slave = self._slaves[component.name]
            given = {e for name in component.start for e in slave.elements(name)}
            for output, needed in slave.feedthrough.items():
                for name in needed:
                    if (component.name, name) not in self.sources and name not in given:
                        raise ConfigError(
                            f"{self._path}: input '{component.name}.{name}', on which "
                            f"'{output}' depends, is not connected and has no start value."
                        )

    def _require_no_loop(self) -> None:
        graph: dict[tuple[str, str], set[tuple[str, str]]] = {
            into: {out} for into, out in self.sources.items()
        }
        for name, slave in self._slaves.items():
            for output, needed in slave.feedthrough.items():
                graph[name, output] = {(name, element) for element in needed}
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            loop = " <- ".join(".".join(node) for node in error.args[1])
            raise ConfigError(
                f"{self._path}: algebraic loop through direct feedthrough: {loop}."
            ) from error
