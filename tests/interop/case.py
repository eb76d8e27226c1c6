"""Cases for engines, and the comparison of their results."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cosim.systems.system import SystemSpec, open_system
from cosim.systems.wiring import Wiring
from fmu_src.run.fmu import FmuInstance
from hesr.extras.ssp.contents import read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr_model.support.arrays import Array

_INDEX = re.compile(r"\[\d+(,\d+)*\]$")

ALONE, TOGETHER = 1e-12, 1e-9
"""Tolerances relative to the largest value of a signal: round-off, and round-off in a loop."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Alone:
    """An FMU for co-simulation with inputs held over each step.

    The inputs of row k are set at k * step, row 0 during initialisation; outputs are read
    after initialisation and after each step.

    Attributes
    ----------
    name : label in tables.
    fmu : the FMU.
    step : communication step [s].
    steps : number of steps.
    inputs : (steps + 1,) of each input.
    outputs : compared signals.
    start : values of parameters by variable name.
    fmi : version.
    arrays : for FMI 3.0, element names by array name; if one element has a start value,
        all have.
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
    name : label in tables.
    spec : the system.
    ssp : the same as SSP.
    signals : compared outputs, `component.variable`.
    """

    name: str
    spec: SystemSpec
    ssp: Path
    signals: Sequence[str]

    tolerance = TOGETHER

    def wiring(self) -> Wiring:
        """Return the connections of its FMUs."""
        variables = {}
        for component in self.spec.components:
            with FmuInstance(component.fmu) as slave:
                variables[component.name] = slave.variables
        return Wiring(self.spec, variables, Path(self.spec.name))


Case = Alone | Together


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Results of an engine.

    Attributes
    ----------
    signals : (N,) of each signal; engines may omit the last point.
    first : index of the first instant.
    without : signals that the engine does not provide.
    seconds : duration of the steps, None if unknown.
    """

    signals: Mapping[str, Array]
    first: int = 0
    without: Collection[str] = ()
    seconds: float | None = None


def deviation(run: Run, reference: Mapping[str, Array]) -> float:
    """Return the largest difference of a signal relative to the signal's largest value.

    Signals of the reference are (N,), by name. The elements of a vector share one largest value,
    since some are zero except for round-off, such as the gravity torque of a vertical axis. Signals
    that are zero throughout are compared absolutely; a signal that is missing, ends more than one
    point early or is not finite has an infinite deviation.
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
    """Yield a system as a case: an SSP, or a system file to be packaged as one.

    All connected or observed outputs are compared.

    Parameters
    ----------
    path : the SSP or the TOML file.
    folder : for the SSP of a TOML file.

    Raises
    ------
    ConfigError
        If it cannot be read, or its system is inconsistent with its FMUs.
    """
    with open_system(path) as spec:
        contents = read_contents(spec, path)
        packaged = path.suffix.lower() == ".ssp"
        yield Together(
            name=path.stem if packaged else spec.name,
            spec=spec,
            ssp=path if packaged else write_ssp(contents, folder / f"{spec.name}.ssp"),
            signals=[f"{name}.{variable}" for name, variable in contents.used_outputs],
        )
