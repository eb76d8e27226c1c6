"""Simulation of one FMU of any tool by FMPy, in the sandbox."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.run.archive import Archive
from fmu_src.run.instance import DiedError
from fmu_src.run.sandbox import run_in_sandbox
from fmu_src.run.variables import Value, Variables, description_in
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

SECONDS = 600.0  # for a whole simulation
_MOST_ROWS = 1_000_000


def simulate_single(
    fmu: Path,
    *,
    start: float | None = None,
    stop: float | None = None,
    step: float | None = None,
    values: Mapping[str, Value] | None = None,
    inputs: Mapping[str, Array] | None = None,
) -> tuple[Array, dict[str, Array]]:
    """Return times (N,) [s] and all outputs (N,) by name of an FMU for either kind.

    Times default to those of its experiment; `inputs` have a column ``time``, linear for continuous
    variables and held for others. Raises ConfigError or SimulationError.
    """
    from fmpy.simulation import auto_interval

    with Archive(fmu) as archive, scratch_folder() as folder:
        about, declared = description_in(archive)
        if about.fmiVersion == "1.0":
            raise ConfigError(f"{fmu}: is of FMI 1.0; export it for FMI 2.0 or 3.0.")
        if about.coSimulation is None and about.modelExchange is None:
            raise ConfigError(
                f"{fmu}: is for scheduled execution only; export it for co-simulation."
            )
        experiment = about.defaultExperiment
        given = {"start": start, "stop": stop, "step": step}
        for name, own in (("start", "startTime"), ("stop", "stopTime"), ("step", "stepSize")):
            text = getattr(experiment, own, None)
            given[name] = given[name] if given[name] is not None else text and float(text)
        begin = given["start"] or 0.0
        end = begin + 1.0 if given["stop"] is None else given["stop"]
        if not end > begin:
            raise ConfigError(f"{fmu}: --stop is {end:g} s, not after the start, {begin:g} s.")
        size = given["step"] or float(auto_interval(end - begin))
        if not size > 0.0 or (end - begin) / size > _MOST_ROWS:
            raise ConfigError(f"{fmu}: --step is {size:g} s; at most {_MOST_ROWS} steps are run.")
        variables = Variables(fmu, about)
        options = {
            "start": begin,
            "stop": end,
            "step": size,
            "values": _settable(fmu, variables, values or {}, arrays=bool(declared)),
            "inputs": _inputs(fmu, variables, inputs or {}),
        }
        archive.unpack(folder)
        process = folder / "process"
        process.mkdir()
        try:
            reader = "fmu_src.run.single:run"
            found = run_in_sandbox(reader, str(folder), options, folder=process, seconds=SECONDS)
        except DiedError as error:
            raise SimulationError(f"{fmu}: its simulation {error}.") from error
    columns = {name: np.array(column) for name, column in found.items()}
    return columns.pop("time"), columns


def _settable(
    fmu: Path, variables: Variables, values: Mapping[str, Value], *, arrays: bool
) -> dict[str, Any]:
    expanded = variables.expanded(values)
    for name in expanded:
        about = variables[name]
        exact = about.initial in ("exact", "approx") and about.variability != "constant"
        if about.causality != "input" and not exact:
            raise ConfigError(f"{fmu}: --set '{name}' has no start value that can be set.")
    # FMPy sets arrays of FMI 3 as a whole.
    return dict(values) if arrays else dict(expanded)


def _inputs(fmu: Path, variables: Variables, inputs: Mapping[str, Array]) -> dict[str, list[float]]:
    for name in inputs:
        if name != "time" and variables[name].causality != "input":
            raise ConfigError(f"{fmu}: --input has the column '{name}', which is not an input.")
    if inputs and "time" not in inputs:
        raise ConfigError(f"{fmu}: --input has no column 'time'.")
    if inputs and np.any(np.diff(inputs["time"]) < 0.0):
        raise ConfigError(f"{fmu}: --input has times that decrease.")
    return {name: column.tolist() for name, column in inputs.items()}


def run(folder: str, options: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the outputs of an unpacked FMU by name; called in the sandbox."""
    from fmpy import read_model_description, simulate_fmu

    about = read_model_description(folder, validate=False)
    names = [v.name for v in about.modelVariables if v.causality == "output"] or None
    texts = [v for v in about.modelVariables if v.causality == "output" and v.type == "String"]
    said: list[tuple[float, list[str]]] = []

    def listen(time: float, recorder: Any) -> bool:
        for v in texts:
            count = {} if about.fmiVersion == "2.0" else {"nValues": 1}
            (text,) = recorder.fmu.getString([v.valueReference], **count)
            said.append((time, [v.name, text.decode() if isinstance(text, bytes) else text]))
        return True

    columns = options["inputs"]
    signals = None
    if columns:
        order = ["time", *(name for name in columns if name != "time")]
        rows = list(zip(*(columns[name] for name in order), strict=True))
        signals = np.array(rows, dtype=[(name, float) for name in order])
    result = simulate_fmu(
        folder,
        validate=False,
        start_time=options["start"],
        stop_time=options["stop"],
        output_interval=options["step"],
        start_values=options["values"],
        input=signals,
        output=names,
        step_finished=listen,
        model_description=about,
        remote_platform=None,
    )
    found = {name: _scalars(name, result[name]) for name in result.dtype.names}
    columns = {scalar: values for part in found.values() for scalar, values in part.items()}
    return columns | {v.name: _held(v, said, columns["time"]) for v in texts}


def _scalars(name: str, values: Array) -> dict[str, list[Any]]:
    if values.ndim == 1:
        return {name: values.tolist()}
    shape = values.shape[1:]
    return {
        f"{name}[{','.join(str(i + 1) for i in place)}]": values[(slice(None), *place)].tolist()
        for place in np.ndindex(*shape)
    }


def _held(
    variable: Any, said: Sequence[tuple[float, list[str]]], times: Sequence[float]
) -> list[str]:
    """Return a text at each time; before the first step that of the description."""
    own = [(time, text) for time, (name, text) in said if name == variable.name]
    at = np.searchsorted([time for time, _ in own], times, side="right") - 1
    first = variable.start or (own[0][1] if own else "")
    return [own[i][1] if i >= 0 else first for i in at]
