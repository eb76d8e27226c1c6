"""Sweep file."""

from collections import Counter
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from cosim.systems.system import Signal
from hesr_model.errors import RuleError
from hesr_model.support.typed_files import Config, RelativePath

MAX_RUNS = 10**7
_SYMMETRY_TOLERANCE = 1e-9  # relative


def _require_distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    for name, count in Counter(names).items():
        if count > 1:
            raise RuleError(f"'{name}' is listed twice", code="sweep.listed_twice")
    return names


DistinctSignals = Annotated[
    tuple[Signal, ...], Field(min_length=1), AfterValidator(_require_distinct)
]


class SweepInput(Config):
    """One varied number: one of `values`, uniform from `low` to `high`, or normal."""

    variables: DistinctSignals  # `component.variable`; without index all elements
    factor: bool = False  # multiplies the start values
    values: tuple[float, ...] = ()
    low: float | None = None
    high: float | None = None
    mean: float | None = None
    std: float | None = Field(default=None, gt=0.0)
    integer: bool = False
    levels: int = Field(default=5, ge=2)  # values in a grid

    @property
    def name(self) -> str:
        """First variable, as the name in tables."""
        return self.variables[0]

    @model_validator(mode="after")
    def _require_one_distribution(self) -> Self:
        pairs = ((self.low, self.high), (self.mean, self.std))
        stated_forms = [bool(self.values), *(None not in pair for pair in pairs)]
        incomplete_pairs = [pair for pair in pairs if (None in pair) and pair != (None, None)]
        if sum(stated_forms) != 1 or incomplete_pairs:
            raise RuleError(
                f"'{self.name}' needs one of 'values', 'low' and 'high', or 'mean' and 'std'",
                code="sweep.distribution",
                key="variables",
            )
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise RuleError(
                f"'{self.name}' has a range from {self.low:g} to {self.high:g}",
                code="sweep.range",
                key="low",
            )
        return self


class Correlated(Config):
    """Varied numbers with a joint normal distribution."""

    variables: DistinctSignals
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _require_covariance(self) -> Self:
        n = len(self.variables)
        if len(self.mean) != n or [len(row) for row in self.covariance] != [n] * n:
            raise RuleError(
                f"{n} correlated variables need {n} means and a covariance of {n} x {n}",
                code="sweep.sizes",
                key="covariance",
            )
        covariance = np.array(self.covariance)
        scale = float(np.abs(covariance).max())
        if np.abs(covariance - covariance.T).max() > _SYMMETRY_TOLERANCE * scale or (
            np.linalg.eigvalsh(covariance).min() < -_SYMMETRY_TOLERANCE * scale
        ):
            raise RuleError(
                f"the covariance of '{self.variables[0]}' and others is not symmetric and positive "
                "semidefinite",
                code="sweep.covariance",
                key="covariance",
            )
        return self


Measure = Literal["rms", "max", "mean", "final"]


class Measured(Config):
    """One measured number of each run, over all elements of a signal minus `reference`."""

    name: str = Field(pattern=r"^[A-Za-z][\w ]*$")
    signal: Signal
    reference: Signal | None = None
    measure: Measure = "rms"  # "max" is that of magnitudes, "final" their mean at the end
    start: float = Field(default=0.0, ge=0.0)  # [s]


Design = Literal["grid", "latin_hypercube", "monte_carlo", "sobol"]


class SweepStudy(Config):
    """A study of many runs; `chunk` runs share one file and one worker."""

    name: str = Field(default="sweep", min_length=1)
    system: RelativePath
    design: Design = "latin_hypercube"
    runs: int | None = Field(default=None, ge=1, le=MAX_RUNS)
    seed: int = Field(default=0, ge=0)
    chunk: int = Field(default=50, ge=1, le=100_000)
    inputs: tuple[SweepInput, ...] = ()
    correlated: tuple[Correlated, ...] = ()
    outputs: tuple[Measured, ...] = Field(min_length=1)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the varied numbers."""
        input_names = [sweep_input.name for sweep_input in self.inputs]
        return (*input_names, *self._list_correlated())

    def _list_correlated(self) -> list[str]:
        variables: list[str] = []
        for group in self.correlated:
            variables += group.variables
        return variables

    @model_validator(mode="after")
    def _require_distinct_names(self) -> Self:
        names: list[str] = []
        for sweep_input in self.inputs:
            names += sweep_input.variables
        names += self._list_correlated()
        if not names:
            raise RuleError(
                "nothing is varied: give 'inputs' or 'correlated'",
                code="sweep.nothing",
                key="inputs",
            )
        names += [output.name for output in self.outputs]
        for name, count in Counter(names).items():
            if count > 1:
                raise RuleError(
                    f"'{name}' is varied or measured twice", code="sweep.names", key="inputs"
                )
        return self

    @model_validator(mode="after")
    def _require_design(self) -> Self:
        if self.design == "grid":
            self._require_grid()
        elif self.runs is None:
            raise RuleError(
                f"the design '{self.design}' needs the key 'runs'", code="sweep.runs", key="runs"
            )
        elif self.design == "sobol" and self.runs & (self.runs - 1):
            raise RuleError(
                f"the design 'sobol' needs a power of 2 as 'runs', not {self.runs}",
                code="sweep.sobol",
                key="runs",
            )
        return self

    def _require_grid(self) -> None:
        if self.runs is not None:
            raise RuleError(
                "a grid determines the number of runs; remove 'runs'",
                code="sweep.grid_runs",
                key="runs",
            )
        if self.correlated or any(sweep_input.mean is not None for sweep_input in self.inputs):
            raise RuleError(
                "a grid needs 'values' or 'low' and 'high' of every input",
                code="sweep.grid_range",
                key="inputs",
            )
