"""Simulation of systems of FMUs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from cosim.workflow.answer import Answer, Written, find_job, written_files
from cosim.workflow.arguments import (
    list_names,
    remember_trust,
    require_choice,
    require_text,
    to_optional_path,
)
from hesr_model.errors import ArgumentError, ConfigError, SimulationError
from hesr_model.support.files import PathArg, to_path, written_whole
from hesr_model.support.progress import Progress, Stages, silent
from hesr_model.support.text import parse_toml

if TYPE_CHECKING:
    from cosim.systems.signals import Signals
    from cosim.systems.simulation import Master
    from cosim.workflow.arguments import Names
    from hesr_model.support.arrays import Array


Exchange = Literal["jacobi", "gauss_seidel"]


def simulate(
    system: PathArg,
    *,
    output: PathArg | None = None,
    start: float | None = None,
    stop: float | None = None,
    step: float | None = None,
    set: Names = (),  # noqa: A002  # the option's name
    input: PathArg | None = None,  # noqa: A002  # the option's name
    order: Exchange | None = None,
    only: int | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    insecure: bool = False,
    isolate: bool = False,
    trust: bool = False,
    progress: Stages = silent,
) -> Signals | Answer:
    r"""Run a system of FMUs, once or in a sweep, or one FMU of any tool.

    An interrupted sweep continues where it stopped.

    Parameters
    ----------
    system : path
        System (.toml: FMUs, connections, steps), SSP or FMU, or sweep (.toml:
        what is varied).
    output : path, optional
        CSV or Parquet file; for a sweep, the folder (default: results/NAME).
    start : float, s, optional
        SSP and FMU: begin of the run; by default that of the file.
    stop : float, s, optional
        SSP and FMU: end of the run; by default that of the file.
    step : float, s, optional
        SSP and FMU: time between rows; by default that of the file.
    set : str or sequence of str, optional
        SSP and FMU: start values as NAME=VALUE.
    input : path, optional
        FMU: CSV of inputs over time [s], linear for continuous inputs and held
        for others.
    order : {"jacobi", "gauss_seidel"}, optional
        System and SSP: exchange of values; outputs of FMUs that do not state
        their dependencies are then those of the step before.
    only : int, optional
        Sweep: repeat this run only and write its signals.
    workers : int, optional
        Sweep: processes; by default one per core.
    cluster : str, optional
        Sweep: address of a scheduler of dask.distributed, with the TLS settings
        of Dask.
    insecure : bool
        Sweep: allow a cluster on another machine without encryption.
    isolate : bool
        System: run each untrusted FMU in a process of its own, not all in one:
        slower.
    trust : bool
        Run these FMUs without a sandbox, now and later: faster, but with all
        your rights.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    Signals or SweepResult
        Observed signals over time [s]; for a sweep, outputs, worst runs and
        sensitivities.

    Raises
    ------
    ConfigError
        If the file, an FMU or a connection is not usable.
    SimulationError
        If an FMU fails; results so far are kept in `output`.

    Examples
    --------
    On the command line::

        $ hesr simulate loop.toml -o result.csv
        $ hesr simulate payload.toml -o results/payload
        $ hesr simulate payload.toml --only 7 -o run.csv
        $ hesr simulate Model.fmu --stop 10 --set gain=2 --input steps.csv \
          -o result.csv

    >>> import hesr
    >>> start = "dq[1]=0.3"
    >>> signals = hesr.simulate("Friction.fmu", stop=0.1, step=0.002, set=start)
    >>> signals.vector("tau").shape
    (51, 3)
    """
    from cosim.systems.simulation import Master
    from cosim.systems.system import open_system

    start_values = list_names("set", set)
    require_text("cluster", cluster)
    path = to_path(system, "'system'")
    file = to_optional_path("output", output)
    sweep_options = {
        "only": only,
        "workers": workers,
        "cluster": cluster,
        "insecure": insecure or None,
    }
    job = find_job(path, "simulate")
    if job:
        if isolate:
            raise ArgumentError(f"'isolate' is for a system; {path} is a sweep.")
        if only is not None and file is not None:
            _require_table(file)
        return job.run(path, output=file, progress=progress, **sweep_options)
    sweep_option = _find_first_set(sweep_options)
    if sweep_option is not None:
        raise ArgumentError(f"'{sweep_option}' is for a sweep; {path} is a system.")
    if file is not None:
        _require_table(file)
    times = {"start": start, "stop": stop, "step": step}
    if order is not None:
        require_choice("order", order, get_args(Exchange))
    if path.suffix.lower() == ".fmu":
        if order is not None:
            raise ArgumentError(f"'order' is for a system, not {path}.")
        from cosim.systems.single import open_single

        remember_trust([path], trust=trust)
        open_fmu = partial(
            open_single,
            path,
            times=times,
            values=parse_start_values(path, start_values),
            inputs=_read_inputs(input),
            isolate=isolate,
        )
        return _run(open_fmu, file, partial(progress, path.stem))
    _require_system_options(path, times, start_values, input)
    with open_system(path, times, parse_start_values(path, start_values)) as system_spec:
        if order is not None:
            changes = {"order": order, "delay_undeclared": True}
            system_spec = system_spec.model_copy(update=changes)
        remember_trust((component.fmu for component in system_spec.components), trust=trust)
        if not system_spec.observe:
            raise ConfigError(f"{path}: key 'observe' names no signals to write.")
        open_master = partial(Master, system_spec, path, isolate=isolate)
        return _run(open_master, file, partial(progress, system_spec.name))


def _require_system_options(
    path: Path,
    times: Mapping[str, float | None],
    start_values: Sequence[str],
    input_path: PathArg | None,
) -> None:
    """Refuse options of an FMU for an SSP, and those of both for a system."""
    options: dict[str, object] = {"input": input_path}
    if path.suffix.lower() != ".ssp":
        options |= {**times, "set": start_values or None}
    name = _find_first_set(options)
    if name is not None:
        owner = "an FMU" if name == "input" else "an FMU or SSP"
        raise ArgumentError(f"'{name}' is for {owner}, not {path}.")


def _find_first_set(options: Mapping[str, object]) -> str | None:
    """Return the name of the first option that is set."""
    for name, value in options.items():
        if value is not None:
            return name
    return None


def _run(
    open_master: Callable[[], AbstractContextManager[Master]], file: Path | None, stages: Progress
) -> Signals:
    """Run a system once and write its signals; results until a failure are written as well."""
    if file is None:
        with open_master() as master:
            return master.run(stages).require_success()
    # Check that the file can be written before the run.
    with written_whole(file) as temporary:
        with open_master() as master:
            result = master.run(stages)
        if not len(result.t):
            result.require_success()
        result.write(temporary)
    if result.failure:
        raise SimulationError(
            f"{str(result.failure).rstrip('.')}; the results so far, {len(result.t)} samples to "
            f"t = {result.end:.9g} s, are kept in {file}."
        )
    return result


def _read_inputs(path: PathArg | None) -> dict[str, Array]:
    """Return the columns of a table of inputs."""
    from hesr_model.logs.tables import read_table

    if path is None:
        return {}
    table = read_table(to_path(path, "'input'"))
    return dict(zip(table.names, table.numbers(table.names).T, strict=True))


def parse_start_values(path: Path, pairs: Sequence[str]) -> dict[str, Any]:
    """Return start values of texts NAME=VALUE; values are those of TOML, or texts."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not (name and sign):
            raise ArgumentError(f"{path}: 'set' is '{pair}'; expected NAME=VALUE, such as gain=2.")
        try:
            values[name] = parse_toml(f"value={text}")["value"]
        except ValueError:
            values[name] = text
    return values


def _require_table(path: Path) -> None:
    if path.suffix.lower() not in (".csv", ".parquet", ".pq"):
        raise ConfigError(f"{path}: results are written as .csv or .parquet.")


def answer(result: Signals, output: PathArg | None) -> Answer:
    """Return the answer of a simulation: end time and number of samples."""
    data: dict[str, Any] = {"samples": len(result.t), "end": result.end}
    return Written(
        format="hesr-simulation-1",
        lines=[
            f"{len(result.t)} samples of {len(result.signals)} signals to t = {result.end:.9g} s."
        ],
        data=data | {"signals": list(result.signals)},
        files=written_files(output),
    )
