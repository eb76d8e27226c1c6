"""Job of `hesr monitor FLEET.toml`."""

from pathlib import Path

from cosim.workflow.answer import Answer, PluginJob
from hesr.extras.fleet.study import FleetStudy
from hesr_model.support.progress import Stages, silent


def _run(
    path: Path, *, output: Path | None = None, workers: int | None = None, progress: Stages = silent
) -> Answer:
    """Process all robots, by default into ``results/NAME``."""
    from hesr.extras.fleet.run import run_fleet

    folder = output or Path("results") / FleetStudy.read(path).name
    return run_fleet(path, folder, workers=workers, progress=progress)


JOB = PluginJob("monitor", "types", _run)
