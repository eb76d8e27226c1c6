"""What engines are given to run, and how their results are compared."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cosim.systems.contents import read_contents
from cosim.systems.ssp import write_ssp
from cosim.systems.ssp_reader import opened_system
from cosim.systems.system import SystemSpec
from cosim.systems.wiring import Wiring
from fmu_src.run.fmu import FmuInstance
from hesr_model.support.arrays import Array

_INDEX = re.compile(r"\[\d+(,\d+)*\]$")

ALONE, TOGETHER = 1e-12, 1e-9
"""Tolerances, relative to the largest value of a signal: rounding; rounding that a loop feeds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Alone:
    """One FMU for co-simulation with inputs that hold over each step.

    The inputs of row k are set at k * step, row 0 before the initialisation ends; outputs are read
    after the initialisation and after each step.

    Attributes
    ----------
    name : for tables.
    fmu : the FMU.
    step : of communication [s].
    steps : how many.
    inputs : (steps + 1,) of each input.
    outputs : signals that are compared.
    start : values of parameters, by the name of the variable.
    fmi : version.
    arrays : of FMI 3.0, names of the elements that are one array, by its name; where one element
        has a start value, all have.
    """

    name: str
    fmu: Path
    step: float
    steps: int
    inputs: Mapping[str, Array]
    outputs: Sequence[str]
    start: Mapping[str, float] = field(default_factory=dict)
    fmi: int = 2
    arrays: Mapping[str, Sequence[str]] = field(default_factory=dict)

    tolerance = ALONE

    @property
    def stop(self) -> float:
        """End of the run [s]."""
        return self.steps * self.step

    @property
    def times(self) -> Array:
        """(steps + 1,) communication points [s]."""
        return self.step * np.arange(self.steps + 1, dtype=float)


@dataclass(frozen=True, kw_only=True, eq=False)
class Together:
    """A system of FMUs.

    Attributes
    ----------
    name : for tables.
    spec : the system.
    ssp : the same as SSP.
    signals : outputs that are compared, `component.variable`.
    """

    name: str
    spec: SystemSpec
    ssp: Path
    signals: Sequence[str]

    tolerance = TOGETHER

    def wiring(self) -> Wiring:
        """Return how its FMUs are connected."""
        variables = {}
        for component in self.spec.components:
            with FmuInstance(component.fmu) as slave:
                variables[component.name] = slave.variables
        return Wiring(self.spec, variables, Path(self.spec.name))


Case = Alone | Together


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """What an engine gave.

    Attributes
    ----------
    signals : (N,) of each signal; engines may leave out the last point.
    first : number of the instant with which they begin.
    without : signals that the engine cannot give.
    seconds : how long the steps took, None where the engine does not tell.
    """

    signals: Mapping[str, Array]
    first: int = 0
    without: Collection[str] = ()
    seconds: float | None = None


def deviation(run: Run, reference: Mapping[str, Array]) -> float:
    """Return the largest difference of a signal, relative to the signal's largest value.

    Signals of the reference are (N,), by name. The elements of a vector have one largest value,
    since some are zero but for rounding, as the gravity torque of a vertical axis. What is zero
    throughout is compared absolutely; a signal that is missing, or ends more than one point early,
    or is no number deviates infinitely.
    """
    scales: dict[str, float] = {}
    for name, values in reference.items():
        vector = _INDEX.sub("", name)
        scales[vector] = max(scales.get(vector, 0.0), float(np.abs(values).max()))
    worst = 0.0
    for name, whole in reference.items():
        if name in run.without:
            continue
        values, expected = run.signals.get(name, np.zeros(0)), whole[run.first :]
        if not len(expected) - 1 <= len(values) <= len(expected):
            return np.inf
        difference = float(np.abs(values - expected[: len(values)]).max())
        scale = scales[_INDEX.sub("", name)] or 1.0
        worst = max(worst, difference / scale if np.isfinite(difference) else np.inf)
    return worst


@contextmanager
def opened_case(path: Path, folder: Path) -> Iterator[Together]:
    """Yield a system as a case: an SSP, or a system file, which is packaged as one.

    All outputs are compared that are connected or observed.

    Parameters
    ----------
    path : the SSP or the TOML file.
    folder : for the SSP of a TOML file.

    Raises
    ------
    ConfigError
        If it cannot be read, or its system does not fit its FMUs.
    """
    with opened_system(path) as spec:
        contents = read_contents(spec, path)
        packaged = path.suffix.lower() == ".ssp"
        yield Together(
            name=path.stem if packaged else spec.name,
            spec=spec,
            ssp=path if packaged else write_ssp(contents, folder / f"{spec.name}.ssp"),
            signals=[f"{name}.{variable}" for name, variable in contents.used],
        )
