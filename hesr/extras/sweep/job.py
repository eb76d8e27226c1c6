"""Job of `hesr simulate SWEEP.toml`."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from cosim.report.result_page import write_answer
from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from cosim.workflow.answer import Answer, PluginJob, Written
from hesr.extras.sweep.plan import Plan, compute_sensitivities, read_plan
from hesr.extras.sweep.study import SweepStudy
from hesr.extras.sweep.tables import SweepResult
from hesr.extras.sweep.work import ABOUT, RUNS, RunOutputs, Store, lock_folder, release, run_rows
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.support import parallel
from hesr_model.support.progress import Stages, silent

PAGE = "sweep.html"


def run_sweep(
    path: Path,
    output: Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Stages = silent,
) -> SweepResult:
    """Do all missing runs of a sweep file, and write the page; 1 worker is this process."""
    try:
        plan = read_plan(path)
        store = Store(
            output,
            plan.study.names,
            tuple(sweep_output.name for sweep_output in plan.study.outputs),
        )
        with lock_folder(output, RUNS, ABOUT, plan.describe_results()):
            open_starts = [
                start for start in plan.chunk_starts if not store.has(start, plan.chunk(start))
            ]
            run_count = len(plan.values)
            done_count = reused = run_count - sum(len(plan.chunk(start)) for start in open_starts)
            progress(plan.study.name, done_count, run_count)
            with _run_chunks(plan, open_starts, workers, cluster) as results:
                for chunk_start, rows in results:
                    store.write(chunk_start, plan.chunk(chunk_start), rows)
                    done_count += len(plan.chunk(chunk_start))
                    progress(plan.study.name, done_count, run_count)
            table = store.read(plan.chunk_starts)
            output_sensitivities = compute_sensitivities(table.outputs, plan.study)
            if all(table.failures):
                raise SimulationError(
                    f"{path}: all {len(table.failures)} runs failed, the first because "
                    f"{table.failures[0]}"
                )
            # The page of a continued sweep is that of an uninterrupted one, in any folder.
            sweep_result = SweepResult(
                plan=plan,
                table=table,
                sensitivities=output_sensitivities,
                reused=0,
                path=Path(path.name),
            )
            write_answer(sweep_result, output / PAGE)
    finally:
        release()
    return replace(sweep_result, reused=reused, path=path, files=(output / PAGE, output / RUNS))


@contextmanager
def _run_chunks(
    plan: Plan, open_starts: list[int], workers: int | None, cluster: str | None
) -> Iterator[Iterator[tuple[int, RunOutputs]]]:
    if cluster is not None:
        from hesr.extras.sweep.cluster import run_on_cluster

        with run_on_cluster(plan, open_starts, cluster) as results:
            yield results
        return
    jobs = [partial(run_rows, plan.task, plan.chunk(chunk_start)) for chunk_start in open_starts]
    with parallel.results_of(jobs, workers) as finished:
        yield zip(open_starts, finished, strict=True)


def replay(path: Path, run: int) -> tuple[Plan, Signals]:
    """Repeat one run with all measured and observed signals."""
    try:
        plan = read_plan(path)
        if not 0 <= run < len(plan.values):
            raise ConfigError(f"{path}: run {run} is not one of 0 to {len(plan.values) - 1}.")
        system_signals = SystemSpec.read(plan.study.system).observe
        system = plan.task.system
        system = system.model_copy(
            update={"observe": tuple(dict.fromkeys((*system.observe, *system_signals)))}
        )
        with Master(system, plan.study.system) as master:
            return plan, master.run(start=plan.task.start(plan.values[run]))
    finally:
        release()


def _run(
    path: Path,
    *,
    output: Path | None = None,
    only: int | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    insecure: bool = False,
    progress: Stages = silent,
) -> Answer:
    """Do all runs, by default into ``results/NAME``, or only one into ``runN.csv``."""
    if only is not None:
        return _replay(path, only, output or Path(f"run{only}.csv"))
    folder = output or Path("results") / SweepStudy.read(path).name
    if cluster is not None:
        from hesr.extras.sweep.cluster import require_encryption

        require_encryption(cluster, insecure=insecure)
    return run_sweep(path, folder, workers=workers, cluster=cluster, progress=progress)


JOB = PluginJob("simulate", "outputs", _run)


def _replay(path: Path, run: int, file: Path) -> Written:
    plan, signals = replay(path, run)
    if len(signals.t):
        signals.write(file)
    signals.require_success()
    study = plan.study
    varied_inputs = {
        name: float(value) for name, value in zip(study.names, plan.values[run], strict=True)
    }
    measured_outputs = {
        sweep_output.name: float(x)
        for sweep_output, x in zip(study.outputs, plan.task.measure_outputs(signals), strict=True)
    }
    return Written(
        lines=[
            *(f"{name} = {value:.9g}" for name, value in varied_inputs.items()),
            *(f"{name}: {value:.9g}" for name, value in measured_outputs.items()),
            f"{len(signals.t)} samples of {len(signals.signals)} signals",
        ],
        data={"run": run, "inputs": varied_inputs, "outputs": measured_outputs},
        files=[file],
    )
