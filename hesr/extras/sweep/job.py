"""Job of `hesr simulate SWEEP.toml`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.report.tables.table import ResultTable
from cosim.workflow.answer import Answer, PluginJob, Written, shortened
from hesr.extras.sweep import tables
from hesr.extras.sweep.plan import SweepRuns
from hesr.extras.sweep.study import SweepStudy
from hesr.extras.sweep.work import RUNS
from hesr_model.support.progress import Stages, silent


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
    from hesr.extras.sweep.run import PAGE, run_sweep

    if only is not None:
        return _replay(path, only, output or Path(f"run{only}.csv"))
    folder = output or Path("results") / SweepStudy.read(path).name
    if cluster is not None:
        from hesr.extras.sweep.cluster import require_encryption

        require_encryption(cluster, insecure=insecure)
    runs = run_sweep(path, folder, workers=workers, cluster=cluster, progress=progress)
    return SweepResult(**vars(runs), path=path, files=(folder / PAGE, folder / RUNS))


JOB = PluginJob("simulate", "outputs", _run)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SweepResult(Answer, SweepRuns):
    """Result of a sweep file."""

    format = "hesr-sweep-1"
    path: Path
    files: Sequence[Path] = ()

    def summary(self) -> str:
        """Return the numbers of runs and failures, and the worst runs."""
        failures = self.table.failures
        lines = [f"{len(failures)} runs, {sum(map(bool, failures))} failed."]
        if self.reused:
            lines.append(f"Complete before: {self.reused} runs.")
        for k, one in enumerate(self.plan.study.outputs):
            command = tables.replay_command(self.path, self.worst(k)[0])
            lines.append(f"Worst run by {one.name}: {command}")
        return shortened(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return distributions and sensitivities."""
        return [tables.outputs(self), *tables.sensitivities(self)]

    def result(self) -> Any:
        """Return worst runs and sensitivities by output."""
        return {
            "runs": len(self.table.failures),
            "reused": self.reused,
            "failed": sum(map(bool, self.table.failures)),
            "worst": {o.name: self.worst(k) for k, o in enumerate(self.plan.study.outputs)},
            "sensitivities": {
                one.output: {"first": one.first.tolist(), "total": one.total.tolist()}
                for one in self.sensitivities
            },
        }


def _replay(path: Path, run: int, file: Path) -> Written:
    from hesr.extras.sweep.run import replay

    plan, result = replay(path, run)
    if len(result.t):
        result.write(file)
    result.require_success()
    study = plan.study
    varied = {name: float(x) for name, x in zip(study.names, plan.values[run], strict=True)}
    measured = {
        one.name: float(x) for one, x in zip(study.outputs, plan.task.measured(result), strict=True)
    }
    return Written(
        lines=[
            *(f"{name} = {value:.9g}" for name, value in varied.items()),
            *(f"{name}: {value:.9g}" for name, value in measured.items()),
            f"{len(result.t)} samples of {len(result.signals)} signals",
        ],
        data={"run": run, "inputs": varied, "outputs": measured},
        files=[file],
    )
