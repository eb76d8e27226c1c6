"""The main job: a study's logs in; rigid body, laws, FMUs and their scores out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.describe import save_run
from cosim.job import Job
from cosim.scoring import Comparison
from cosim.study import Study
from fmu_src import export_fmu
from fmu_src.toolchain import targets
from hesr_model.artifacts import provenance, write_json, write_model, write_rigid_body
from hesr_model.files import folder_written_whole, models_folder
from hesr_model.friction.model import FrictionModel
from hesr_model.progress import Stages, counted, unheard
from hesr_model.residual import friction_records
from hesr_model.rigid_body import RigidBody
from hesr_model.robot import RobotModel
from hesr_model.robot_log import RobotLog

if TYPE_CHECKING:
    from cosim.studies.whole_loop import LoopOutcome
    from hesr_model.friction.properties import Properties

QUICK_LAWS = ("stribeck", "lugre", "parfam_h")
"""Laws of a quick run: the paper's law and its classic baselines."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a run made.

    Attributes
    ----------
    rigid_body : the identified rigid body.
    comparisons : scores of the FMUs on each test set.
    models : fitted model of each law.
    fmus : path of each law's FMU.
    left_out : why a law of the study was not fitted, by law.
    properties : what the property battery found, by law; empty for a quick run.
    loop : what the closed loop gave, None where the study has none.
    """

    rigid_body: RigidBody
    comparisons: Mapping[str, Comparison]
    models: Mapping[str, FrictionModel]
    fmus: Mapping[str, Path]
    left_out: Mapping[str, str]
    properties: "Mapping[str, Properties]"
    loop: "LoopOutcome | None" = None

    def to_json(self) -> dict[str, Any]:
        """Return JSON data: scores and where the FMUs are."""
        return {
            "fmus": {law: str(path) for law, path in self.fmus.items()},
            "left_out": dict(self.left_out),
            "evaluation": {name: c.to_json() for name, c in self.comparisons.items()},
            "closed_loop": self.loop.to_json() if self.loop else None,
        }


def run_study(
    path: Path,
    output: Path,
    *,
    platforms: Sequence[str] = ("linux64",),
    quick: bool = False,
    progress: Stages = unheard,
) -> Outcome:
    """Run a study and write everything that it makes into a folder, or nothing on an error.

    The scores are those of the FMUs, driven through FMPy over the test logs.

    Parameters
    ----------
    path : study file.
    output : folder of the results.
    platforms : for which the FMUs hold a binary.
    quick : run `QUICK_LAWS` only, without variants, without refining the rigid body and without
        the property battery.
    progress : told how far the run has come.

    Raises
    ------
    HesrError
        If the study, a log or the data in it do not allow the run.
    """
    study = Study.read(path)
    if quick:
        study = study.model_copy(
            update={"laws": QUICK_LAWS, "variants": {}, "refinement": None, "tracking": None}
        )
    targets(platforms)
    job = Job(study=study, path=path, progress=progress)
    model = RobotModel(job.robot)
    with folder_written_whole(output) as folder:
        files = job.log_files(folder)
        logs = {name: RobotLog.read(file, job.robot) for name, file in files.items()}
        rigid_body = job.rigid_body(logs, model)
        about = [study.robot, job.robot.model, *(files[name] for name in job.trained_on)]
        source = provenance(files=about, seed=study.seed)
        write_rigid_body(folder / "rigid_body.json", rigid_body, source)
        records = {name: friction_records(log, model, rigid_body) for name, log in logs.items()}
        models, left_out = job.fit_all(records, source)
        found = {} if quick else job.properties(model, rigid_body, models, folder)
        for law, fitted in counted(models.items(), partial(job.progress, "building FMUs")):
            write_model(folder / "laws" / f"{law}.json", fitted)
            path_of_fmu = folder / "fmus" / f"{law}.fmu"
            export_fmu(fitted, path_of_fmu, platforms=platforms, properties=found.get(law))
        comparisons, predictions = job.compare(models, records, files, folder / "fmus")
        loop = job.closed_loop(model, rigid_body, folder, models, kept=unfinished(output))
        write_json(
            folder / "evaluation.json", {name: c.to_json() for name, c in comparisons.items()}
        )
        save_run(
            folder,
            study=study,
            command=_command(path, platforms, quick=quick),
            quick=quick,
            robot=job.robot,
            files=files,
            logs=logs,
            records=records,
            predictions=predictions,
            models=models,
            left_out=left_out,
            source=source,
        )
    from cosim.report import write_report  # draws, which takes long to load

    write_report(output, progress=job.progress)
    return Outcome(
        rigid_body=rigid_body,
        comparisons=comparisons,
        models=models,
        fmus={law: output / "fmus" / f"{law}.fmu" for law in models},
        left_out=left_out,
        properties=found,
        loop=loop,
    )


def unfinished(output: Path) -> Path:
    """Return where finished rows of the closed loop are kept until a run is done."""
    return output.parent / f".{output.name}-unfinished"


def _command(study: Path, platforms: Sequence[str], *, quick: bool) -> str:
    """Return the command that makes the same results again; folders of the machine stay out."""
    default = models_folder() / "studies" / "default.toml"
    given = [study.name if study.is_absolute() else study.as_posix()]
    return " ".join(
        [
            "hesr run",
            *(given if study.resolve() != default.resolve() else []),
            *(f"--platform {platform}" for platform in platforms if list(platforms) != ["linux64"]),
            *(["--quick"] if quick else []),
        ]
    )
