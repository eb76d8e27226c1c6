"""The closed loop as files: FMUs, systems as TOML and SSP, and a script without HESR."""

import shutil
from pathlib import Path

from cosim.systems.system import SystemSpec, write_system
from hesr_model.errors import ArtifactError
from hesr_model.support import plugins
from hesr_model.support.files import folder_written_whole, models_folder

_LOOPS = ("closed_loop.toml", "plant_loop.toml")
_SCRIPT = "simulate.py"


def complete_loops(folder: Path) -> None:
    """Write the script that runs the loops in a folder, and their SSPs if that is possible."""
    ssp = plugins.load("hesr.systems").get("ssp")
    for path in _loops(folder):
        if ssp:
            ssp.load()(SystemSpec.read(path), path, path.with_suffix(".ssp"))
        shutil.copyfile(models_folder() / "loop" / _SCRIPT, folder / _SCRIPT)


def _loops(folder: Path) -> list[Path]:
    return [path for name in _LOOPS if (path := folder / name).is_file()]


def copy_loops(results: Path, output: Path) -> Path:
    """Copy the loops of results with all their FMUs into a folder that needs nothing else."""
    if not (loops := _loops(results)):
        raise ArtifactError(
            f"{results}: has no {_LOOPS[0]}; 'hesr run' writes it for a study with [twin] and "
            "[tracking]."
        )
    with folder_written_whole(output) as folder:
        (folder / "fmus").mkdir()
        for path in loops:
            spec = SystemSpec.read(path)
            for fmu in (*(c.fmu for c in spec.components), *results.glob("fmus/Velocity.fmu")):
                shutil.copyfile(fmu, folder / "fmus" / fmu.name)
            own = tuple(
                c.model_copy(update={"fmu": folder / "fmus" / c.fmu.name}) for c in spec.components
            )
            write_system(spec.model_copy(update={"components": own}), folder / path.name)
        complete_loops(folder)
    return output
