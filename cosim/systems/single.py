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
from fmu_src.run.variables import Variables, read_packed_description
from hesr_model.errors import ArtifactError, ConfigError, SimulationError
from hesr_model.support.arrays import Array

_MOST_ROWS = 1_000_000
_MOST_STATES = 5  # shown of an FMU without outputs
_SHOWN = ("Real", "Float32", "Integer", "Enumeration", "Boolean", "String")
_CLOSE = 1e-9  # relative distance of times that are equal but for round-off
_NAME = "fmu"  # of the component


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Times of a run [s]."""

    begin: float
    end: float
    step: float


def read_experiment(fmu: Path, about: Any, times: Mapping[str, float | None]) -> Experiment:
    """Return the times of a run: those of the FMU unless others are given."""
    begin = _time(fmu, about, times, "start")
    end = _time(fmu, about, times, "stop")
    step = _time(fmu, about, times, "step")
    begin = 0.0 if begin is None else begin
    end = begin + 1.0 if end is None else end
    if not end > begin:
        raise ConfigError(f"{fmu}: --stop is {end:g} s, not after the start, {begin:g} s.")
    if not step:
        step = _auto_step(end - begin)
    if not step > 0.0 or (end - begin) / step > _MOST_ROWS:
        raise ConfigError(f"{fmu}: --step is {step:g} s; at most {_MOST_ROWS} steps are run.")
    if begin + step == begin or end - step == end:
        raise ConfigError(f"{fmu}: --step is {step:g} s; it must change times of {end:g} s.")
    return Experiment(begin=begin, end=end, step=step)


def _time(fmu: Path, about: Any, times: Mapping[str, float | None], option: str) -> float | None:
    """Return a time of the run [s], or None if neither the user nor the FMU gives it."""
    given = times.get(option)
    if given is not None:
        if not isfinite(given):
            raise ConfigError(f"{fmu}: --{option} is {given:g} s; it must be a finite number.")
        return given
    attribute = {"start": "startTime", "stop": "stopTime", "step": "stepSize"}[option]
    text = getattr(about.defaultExperiment, attribute, None)
    if text is None or text == "":
        return None
    try:
        time = float(text)
    except ValueError:
        time = float("nan")
    if not isfinite(time):
        raise ConfigError(f"{fmu}: its {attribute} is '{text}'; give --{option}.")
    return time


def _auto_step(length: float) -> float:
    """Return a round step that divides a length [s] into 500 to 1000 rows, as FMPy does."""
    step = float(10.0 ** (np.round(np.log10(length)) - 3.0))
    count = length / step
    for least, factor in ((2500, 5), (2000, 4), (1000, 2)):
        if count >= least:
            return step * factor
    for most, divisor in ((200, 5), (250, 4), (500, 2)):
        if count <= most:
            return step / divisor
    return step


def communication_points(
    experiment: Experiment, jumps: Array, *, any_step: bool
) -> tuple[Array, bool]:
    """Return the communication points [s], and whether they are evenly spaced.

    An FMU that takes any step also has points at the jumps of its inputs and at the end.
    """
    begin = experiment.begin
    end = experiment.end
    step = experiment.step
    count = int(np.floor((end - begin) / step * (1.0 + _CLOSE)))
    points: Array = begin + step * np.arange(count + 1, dtype=float)
    if not any_step:
        return points, True
    inner = jumps[(jumps > begin) & (jumps < end)]
    more = np.append(inner, end)
    nearest = points[np.clip(np.rint((more - begin) / step).astype(int), 0, count)]
    more = more[np.abs(more - nearest) > _CLOSE * np.maximum(np.abs(more), step)]
    all_points: Array = np.union1d(points, more)
    return all_points, not more.size


@contextmanager
def opened_single(
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
    try:
        with Archive(fmu) as archive:
            about, declared = read_packed_description(archive)
    except ArtifactError as error:
        raise SimulationError(f"{error}") from error
    if about.fmiVersion == "1.0":
        raise ConfigError(f"{fmu}: is of FMI 1.0; export it for FMI 2.0 or 3.0.")
    if about.coSimulation is None and about.modelExchange is None:
        raise ConfigError(f"{fmu}: is for scheduled execution only; export it for co-simulation.")
    experiment = read_experiment(fmu, about, times)
    variables = Variables(fmu, about, declared)
    _require_settable(fmu, variables, values)
    columns = _require_inputs(fmu, variables, inputs)
    exchange = about.coSimulation is None
    any_step = exchange or bool(about.coSimulation.canHandleVariableCommunicationStepSize)
    t = inputs["time"] if columns else np.zeros(1)
    jumps = find_jumps(t, columns, variables)
    points, even = communication_points(experiment, jumps, any_step=any_step)
    if len(points) < 2:
        raise ConfigError(
            f"{fmu}: --step is {experiment.step:g} s, longer than the run of "
            f"{experiment.end - experiment.begin:g} s, and the FMU takes no shorter step."
        )
    source = None
    if columns:
        source = SampledInputs(
            _NAME, variables, t=t, columns=columns, points=points, exchange=exchange
        )
    count = len(points) - 1
    system = SystemSpec(
        name=str(about.modelName or fmu.stem),
        step=experiment.step if even else float(points[-1] - points[0]) / count,
        begin=experiment.begin,
        stop=experiment.begin + count * experiment.step if even else float(points[-1]),
        components=(ComponentSpec(name=_NAME, fmu=fmu, start=dict(values)),),
        connections={f"{_NAME}.{name}": f"{SOURCE}.{name}" for name in columns},
        open_inputs=True,
        observe=tuple(f"{_NAME}.{name}" for name in _observed_outputs(about)),
    )
    master = Master(
        system,
        fmu,
        isolate=isolate,
        source=source,
        times=None if even else points,
        exchange=exchange,
        single=True,
    )
    with master:
        yield master


def _observed_outputs(about: Any) -> list[str]:
    """Return the outputs; the first continuous states or variables of an FMU without outputs."""
    known = [v for v in about.modelVariables if v.type in _SHOWN and v.name != "time"]
    outputs = [v.name for v in known if v.causality == "output"]
    if outputs:
        return outputs
    states = [unknown.variable.derivative for unknown in about.derivatives or ()]
    shown = [state.name for state in states if state is not None]
    return (shown or [v.name for v in known])[:_MOST_STATES]


def _require_settable(fmu: Path, variables: Variables, values: Mapping[str, Value]) -> None:
    for name in variables.expanded(values):
        about = variables[name]
        exact = about.initial in ("exact", "approx") and about.variability != "constant"
        if about.causality != "input" and not exact:
            raise ConfigError(f"{fmu}: --set '{name}' has no start value that can be set.")


def _require_inputs(
    fmu: Path, variables: Variables, inputs: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the columns but the time; raise ConfigError or SimulationError if one is invalid."""
    columns = {name: column for name, column in inputs.items() if name != "time"}
    for name, column in columns.items():
        if variables[name].causality != "input":
            raise ConfigError(f"{fmu}: --input has the column '{name}', which is not an input.")
        if variables[name].type == "String":
            raise ConfigError(f"{fmu}: --input has the column '{name}', a text; use --set.")
        for value in np.unique(column).tolist():
            variables.expanded({name: value})
    if inputs and "time" not in inputs:
        raise ConfigError(f"{fmu}: --input has no column 'time'.")
    if inputs and np.any(np.diff(inputs["time"]) < 0.0):
        raise ConfigError(f"{fmu}: --input has times that decrease.")
    return columns
