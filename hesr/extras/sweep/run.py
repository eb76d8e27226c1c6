"""Run of a sweep in chunks; an interrupted sweep continues where it stopped."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from hesr.extras.sweep.plan import Plan, SweepRuns, planned, sensitivities
from hesr.extras.sweep.work import ABOUT, RUNS, RunOutputs, Store, release, run_rows, taken
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
) -> SweepRuns:
    """Do all missing runs of a sweep file, and write the page; 1 worker is this process."""
    try:
        plan = planned(path)
        store = Store(output, plan.study.names, tuple(one.name for one in plan.study.outputs))
        with taken(output, RUNS, ABOUT, plan.about()):
            left = [k for k in plan.firsts if not store.has(k, plan.chunk(k))]
            count = len(plan.values)
            done = reused = count - sum(len(plan.chunk(k)) for k in left)
            progress(plan.study.name, done, count)
            with _results(plan, left, workers, cluster) as results:
                for first, rows in results:
                    store.write(first, plan.chunk(first), rows)
                    done += len(plan.chunk(first))
                    progress(plan.study.name, done, count)
            table = store.read(plan.firsts)
            found = sensitivities(table.outputs, plan.study)
            swept = SweepRuns(plan=plan, table=table, sensitivities=found, reused=reused)
            if all(table.failures):
                raise SimulationError(
                    f"{path}: all {len(table.failures)} runs failed, the first because "
                    f"{table.failures[0]}"
                )
            from hesr.extras.sweep.page import write_page  # slow import

            write_page(swept, output / PAGE, path)
    finally:
        release()
    return swept


@contextmanager
def _results(
    plan: Plan, left: list[int], workers: int | None, cluster: str | None
) -> Iterator[Iterator[tuple[int, RunOutputs]]]:
    if cluster is not None:
        from hesr.extras.sweep.cluster import results_of

        with results_of(plan, left, cluster) as results:
            yield results
        return
    jobs = [partial(run_rows, plan.task, plan.chunk(first)) for first in left]
    with parallel.results_of(jobs, workers) as found:
        yield zip(left, found, strict=True)


def replay(path: Path, run: int) -> tuple[Plan, Signals]:
    """Repeat one run with all measured and observed signals."""
    try:
        plan = planned(path)
        if not 0 <= run < len(plan.values):
            raise ConfigError(f"{path}: run {run} is not one of 0 to {len(plan.values) - 1}.")
        own = SystemSpec.read(plan.study.system).observe
        spec = plan.task.spec
        spec = spec.model_copy(update={"observe": tuple(dict.fromkeys((*spec.observe, *own)))})
        with Master(spec, plan.study.system) as master:
            return plan, master.run(start=plan.task.start(plan.values[run]))
    finally:
        release()
