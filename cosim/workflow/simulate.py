"""Simulation of systems of FMUs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.workflow.answer import Answer, Written, written_files
from hesr_model.errors import ArgumentError, ConfigError, SimulationError
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.systems.signals import Signals
    from hesr_model.support.files import PathArg


def simulate(
    system: PathArg,
    *,
    output: PathArg | None = None,
    only: int | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    trust: bool = False,
    progress: Stages = silent,
) -> Signals | Answer:
    """Run a system of FMUs, once or in a sweep.

    An interrupted sweep continues where it stopped.

    Parameters
    ----------
    system : path
        System (.toml: FMUs, connections, steps), SSP, or sweep (.toml: what is varied).
    output : path, optional
        CSV or Parquet file; for a sweep, the folder (default: results/NAME).
    only : int, optional
        Sweep: repeat this run only and write its signals.
    workers : int, optional
        Sweep: processes; by default one per core.
    cluster : str, optional
        Sweep: address of a scheduler of dask.distributed.
    trust : bool
        Run these FMUs without a sandbox, now and later: faster, but with all your rights.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    Signals or SweepResult
        Observed signals over time [s]; for a sweep, outputs, worst runs and sensitivities.

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

    In Python:

    >>> import hesr
    >>> float(hesr.simulate("loop.toml").t[0])
    0.0
    """
    from cosim.systems.simulation import Master
    from cosim.systems.ssp_reader import opened_system
    from cosim.systems.system_file import System
    from cosim.workflow.arguments import remember_trust
    from cosim.workflow.jobs import find_job
    from hesr_model.support.files import path_of, written_whole

    path = path_of(system, "a system")
    file = None if output is None else path_of(output, "an output")
    if job := find_job(path, "simulate"):
        if only is not None and file is not None:
            _require_table(file)
        return job.run(
            path, output=file, only=only, workers=workers, cluster=cluster, progress=progress
        )
    given = {"only": only, "workers": workers, "cluster": cluster}
    for name in (name for name, value in given.items() if value is not None):
        raise ArgumentError(f"'{name}' is for a sweep; {path} is a system.")
    if file is not None:
        _require_table(file)
    with opened_system(path) as spec:
        remember_trust((component.fmu for component in spec.components), trust=trust)
        if not spec.observe:
            raise ConfigError(f"{path}: key 'observe' names no signals to write.")
        stages = partial(progress, spec.name)
        if file is None:
            return System(spec, path).run(stages)
        # Check that the file can be written before the run.
        with written_whole(file) as temporary:
            with Master(spec, path) as master:
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
