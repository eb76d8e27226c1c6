"""Export format `loop`: all files of a closed loop, of results or of a study that is run first."""

from __future__ import annotations

from pathlib import Path

from fmu_src.exporter import Exporter, ExportRequest
from hesr_model.errors import ArgumentError
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Stages


def prepare(request: ExportRequest) -> dict[str, Stages]:
    """Pass the progress of the run on."""
    return {"progress": request.progress}


def write(source: Path, output: Path, progress: Stages) -> None:
    """Copy the loop of results; run a study with its quick laws first."""
    from cosim.loop.traces import copy_loops
    from cosim.study.run import run_study
    from cosim.study.study import Study
    from fmu_src.export.toolchain import DEFAULT_PLATFORMS

    if source.is_dir():
        copy_loops(source, output)
        return
    if Study.read(source).tracking is None:
        raise ArgumentError(f"{source}: has no [tracking], which a loop needs; add it, and [twin].")
    with scratch_folder() as folder:
        results_folder = folder / "results"
        run_study(
            source, results_folder, platforms=DEFAULT_PLATFORMS, quick=True, progress=progress
        )
        copy_loops(results_folder, output)


LOOP = Exporter(
    title="folder with all FMUs of the closed loop, the system as SSP and TOML, and a script that "
    "runs it with FMPy and NumPy",
    suffixes=(),
    write=write,
    prepare=prepare,
    platform_refusal="'platform' is for single FMUs; those of a loop have the platforms of its "
    "run.",
)
