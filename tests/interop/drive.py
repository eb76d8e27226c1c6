"""Inputs for comparing any FMU between engines."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from interop.case import Alone

from cosim.systems.system import Value
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.variables import split_reference
from hesr_model.support.arrays import Array

_AMPLITUDE, _RATE, _PHASE = 0.5, 2.0 * np.pi, 0.7
_SECONDS = 2.0
_STEP = 0.005  # [s] if the FMU states none


def driven(
    fmu: Path, *, name: str | None = None, start: Mapping[str, Value] | None = None
) -> Alone:
    """Return a run of an FMU with sinusoidal inputs, each with another phase.

    They have an amplitude of 0.5 around their start values and stay within their limits. The step
    is the one preferred by the FMU.

    Parameters
    ----------
    fmu : for co-simulation.
    name : label in tables; by default the file's stem.
    start : values of parameters by name.

    Raises
    ------
    SimulationError
        If it is not an FMU of FMI 2.0 or 3.0 for co-simulation with a binary for this machine, or
        the start values are inconsistent with it.
    """
    with FmuInstance(fmu) as component:
        about, variables = component.description, component.variables
        given = variables.expand_values(start or {})
    fmi = int(about.fmiVersion[0])
    parts: dict[int, list[str]] = {}
    for variable in about.modelVariables:
        parts.setdefault(split_reference(variable.valueReference)[0], []).append(variable.name)
    arrays = {n: tuple(parts[a]) for a, n, *_ in component.declared if n not in parts[a]}
    for elements in arrays.values():
        if any(name in given for name in elements):
            whole: dict[str, float | str] = {n: float(variables[n].start or 0) for n in elements}
            given = whole | given
    experiment = about.defaultExperiment
    step = float(experiment.stepSize) if experiment and experiment.stepSize else _STEP
    steps = round(_SECONDS / step)
    t = step * np.arange(steps + 1, dtype=float)
    reals = [v for v in about.modelVariables if v.type == "Real"]
    inputs: dict[str, Array] = {}
    for variable in reals:
        if variable.causality == "input" and variable.name not in given:
            wave = _AMPLITUDE * np.sin(_RATE * t + _PHASE * len(inputs))
            low, high = (float(bound) if bound else None for bound in (variable.min, variable.max))
            wave += float(variable.start or 0.0)
            inputs[variable.name] = wave if low is high is None else np.clip(wave, low, high)
    return Alone(
        name=name or fmu.stem,
        fmu=fmu,
        step=step,
        steps=steps,
        inputs=inputs,
        outputs=[v.name for v in reals if v.causality == "output"],
        start={key: float(value) for key, value in given.items()},
        fmi=fmi,
        arrays=arrays,
    )
