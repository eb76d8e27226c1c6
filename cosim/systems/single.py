"""One FMU of any tool as a system of one component, with inputs from a table."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from cosim.systems.sampled_inputs import SOURCE, SampledInputs, find_jumps
from cosim.systems.simulation import Master
from cosim.systems.system import ComponentSpec, SystemSpec, Value
from fmu_src.run.archive import Archive
from fmu_src.run.variables import Declared, Variables, read_packed_description
from hesr_model.errors import ArgumentError, ArtifactError, ConfigError, SimulationError
from hesr_model.support.arrays import Array

_MAX_ROWS = 1_000_000
_MAX_STATES = 5  # shown of an FMU without outputs
_OBSERVED_TYPES = ("Real", "Float32", "Integer", "Enumeration", "Boolean", "String")
_TIME_TOLERANCE = 1e-9  # relative distance of times that are equal but for round-off
_COMPONENT_NAME = "fmu"  # of the component


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Times of a run [s]."""

    begin: float
    end: float
    step: float


def read_experiment(
    fmu: Path, model_description: Any, times: Mapping[str, float | None]
) -> Experiment:
    """Return the times of a run: those of the FMU unless others are given."""
    start_time = _read_time(fmu, model_description, times, "start")
    stop_time = _read_time(fmu, model_description, times, "stop")
    step_size = _read_time(fmu, model_description, times, "step")
    if start_time is None:
        start_time = 0.0
    if stop_time is None:
        stop_time = start_time + 1.0
    if not stop_time > start_time:
        raise ArgumentError(
            f"{fmu}: 'stop' is {stop_time:g} s, not after the start, {start_time:g} s."
        )
    if not step_size:
        step_size = _choose_step(stop_time - start_time)
    if not step_size > 0.0 or (stop_time - start_time) / step_size > _MAX_ROWS:
        raise ArgumentError(f"{fmu}: 'step' is {step_size:g} s; at most {_MAX_ROWS} steps are run.")
    if start_time + step_size == start_time or stop_time - step_size == stop_time:
        raise ArgumentError(
            f"{fmu}: 'step' is {step_size:g} s; it must change times of {stop_time:g} s."
        )
    return Experiment(begin=start_time, end=stop_time, step=step_size)


def _read_time(
    fmu: Path, model_description: Any, times: Mapping[str, float | None], option: str
) -> float | None:
    """Return a time of the run [s], or None if neither the user nor the FMU gives it."""
    stated_time = times.get(option)
    if stated_time is not None:
        if not isfinite(stated_time):
            raise ConfigError(
                f"{fmu}: --{option} is {stated_time:g} s; it must be a finite number."
            )
        return stated_time
    attribute = {"start": "startTime", "stop": "stopTime", "step": "stepSize"}[option]
    text = getattr(model_description.defaultExperiment, attribute, None)
    if text is None or text == "":
        return None
    try:
        time = float(text)
    except ValueError:
        time = float("nan")
    if not isfinite(time):
        raise ConfigError(f"{fmu}: its {attribute} is '{text}'; give --{option}.")
    return time


def _choose_step(length: float) -> float:
    """Return a round step that divides a length [s] into 500 to 1000 rows, as FMPy does."""
    step_size = float(10.0 ** (np.round(np.log10(length)) - 3.0))
    count = length / step_size
    for smallest_count, factor in ((2500, 5), (2000, 4), (1000, 2)):
        if count >= smallest_count:
            return step_size * factor
    for largest_count, divisor in ((200, 5), (250, 4), (500, 2)):
        if count <= largest_count:
            return step_size / divisor
    return step_size


def find_communication_points(
    experiment: Experiment, jumps: Array, *, any_step: bool
) -> tuple[Array, bool]:
    """Return the communication points [s], and whether they are evenly spaced.

    An FMU that takes any step also has points at the jumps of its inputs and at the end.
    """
    start_time = experiment.begin
    stop_time = experiment.end
    step_size = experiment.step
    step_count = int(np.floor((stop_time - start_time) / step_size * (1.0 + _TIME_TOLERANCE)))
    points: Array = start_time + step_size * np.arange(step_count + 1, dtype=float)
    if not any_step:
        return points, True
    inner = jumps[(jumps > start_time) & (jumps < stop_time)]
    extra_points = np.append(inner, stop_time)
    nearest = points[
        np.clip(np.rint((extra_points - start_time) / step_size).astype(int), 0, step_count)
    ]
    extra_points = extra_points[
        np.abs(extra_points - nearest)
        > _TIME_TOLERANCE * np.maximum(np.abs(extra_points), step_size)
    ]
    all_points: Array = np.union1d(points, extra_points)
    return all_points, not extra_points.size


@contextmanager
def open_single(
    fmu: Path,
    *,
    times: Mapping[str, float | None],
    values: Mapping[str, Value],
    inputs: Mapping[str, Array],
    isolate: bool = False,
) -> Iterator[Master]:
    """Yield a loaded system of one FMU for either kind, with all its outputs observed.

    Times default to those of its experiment; `inputs` have a column ``time``, linear for continuous
    variables and held for others. Raises ConfigError or SimulationError.
    """
    model_description, declared = _read_runnable_description(fmu)
    experiment = read_experiment(fmu, model_description, times)
    variables = Variables(fmu, model_description, declared)
    _require_settable(fmu, variables, values)
    columns = _require_inputs(fmu, variables, inputs)
    exchange = model_description.coSimulation is None
    any_step = exchange or bool(
        model_description.coSimulation.canHandleVariableCommunicationStepSize
    )
    t = np.zeros(1)
    if columns:
        t = inputs["time"]
    jumps = find_jumps(t, columns, variables)
    points, evenly_spaced = find_communication_points(experiment, jumps, any_step=any_step)
    if len(points) < 2:
        raise ArgumentError(
            f"{fmu}: 'step' is {experiment.step:g} s, longer than the run of "
            f"{experiment.end - experiment.begin:g} s, and the FMU takes no shorter step."
        )
    source = None
    if columns:
        source = SampledInputs(
            _COMPONENT_NAME, variables, t=t, columns=columns, points=points, exchange=exchange
        )
    count = len(points) - 1
    if evenly_spaced:
        run_times = None
        step_size = experiment.step
        stop_time = experiment.begin + count * experiment.step
    else:
        run_times = points
        step_size = float(points[-1] - points[0]) / count  # the mean one
        stop_time = float(points[-1])
    system = SystemSpec(
        name=str(model_description.modelName or fmu.stem),
        step=step_size,
        begin=experiment.begin,
        stop=stop_time,
        components=(ComponentSpec(name=_COMPONENT_NAME, fmu=fmu, start=dict(values)),),
        connections={f"{_COMPONENT_NAME}.{name}": f"{SOURCE}.{name}" for name in columns},
        open_inputs=True,
        observe=tuple(f"{_COMPONENT_NAME}.{name}" for name in _choose_outputs(model_description)),
    )
    master = Master(
        system,
        fmu,
        isolate=isolate,
        source=source,
        times=run_times,
        exchange=exchange,
        single=True,
    )
    with master:
        yield master


def _read_runnable_description(fmu: Path) -> tuple[Any, list[Declared]]:
    """Return the description of an FMU that can be run, and its variables of FMI 3.0."""
    try:
        with Archive(fmu) as archive:
            model_description, declared = read_packed_description(archive)
    except ArtifactError as error:
        raise SimulationError(f"{error}") from error
    if model_description.fmiVersion == "1.0":
        raise ConfigError(f"{fmu}: is of FMI 1.0; export it for FMI 2.0 or 3.0.")
    if model_description.coSimulation is None and model_description.modelExchange is None:
        raise ConfigError(f"{fmu}: is for scheduled execution only; export it for co-simulation.")
    return model_description, declared


def _choose_outputs(model_description: Any) -> list[str]:
    """Return the outputs; the first continuous states or variables of an FMU without outputs."""
    observable = [
        variable
        for variable in model_description.modelVariables
        if variable.type in _OBSERVED_TYPES and variable.name != "time"
    ]
    outputs = [variable.name for variable in observable if variable.causality == "output"]
    if outputs:
        return outputs
    states = [unknown.variable.derivative for unknown in model_description.derivatives or ()]
    state_names = [state.name for state in states if state is not None]
    if state_names:
        return state_names[:_MAX_STATES]
    return [variable.name for variable in observable[:_MAX_STATES]]


def _require_settable(fmu: Path, variables: Variables, values: Mapping[str, Value]) -> None:
    for name in variables.expand_values(values):
        variable = variables[name]
        has_start = variable.initial in ("exact", "approx") and variable.variability != "constant"
        if variable.causality != "input" and not has_start:
            raise ArgumentError(f"{fmu}: 'set': '{name}' has no start value that can be set.")


def _require_inputs(
    fmu: Path, variables: Variables, inputs: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the columns but the time; raise ConfigError or SimulationError if one is invalid."""
    columns = {name: column for name, column in inputs.items() if name != "time"}
    for name, column in columns.items():
        if variables[name].causality != "input":
            raise ArgumentError(f"{fmu}: 'input' has the column '{name}', which is not an input.")
        if variables[name].type == "String":
            raise ArgumentError(f"{fmu}: 'input' has the column '{name}', a text; use 'set'.")
        for value in np.unique(column).tolist():
            variables.expand_values({name: value})
    if inputs and "time" not in inputs:
        raise ArgumentError(f"{fmu}: 'input' has no column 'time'.")
    if inputs and np.any(np.diff(inputs["time"]) < 0.0):
        raise ArgumentError(f"{fmu}: 'input' has times that decrease.")
    return columns
