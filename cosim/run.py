"""The main job: a study's logs in; rigid body, laws, FMUs and their scores out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cosim.scoring import Comparison, by_joint, compare, predict_fmu
from cosim.study import Study, Twin
from fmu_src import export_fmu
from hesr_model.artifacts import provenance, write_json, write_model, write_rigid_body
from hesr_model.errors import ConfigError
from hesr_model.files import folder_written_whole
from hesr_model.friction.estimator import estimator, registry
from hesr_model.friction.fit import fit_models
from hesr_model.friction.law import FrictionModel
from hesr_model.residual import FrictionRecord, friction_records
from hesr_model.rigid_body import RigidBody, identify
from hesr_model.robot import RobotDescription, RobotModel
from hesr_model.robot_log import RobotLog

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a run made.

    Attributes
    ----------
    rigid_body : the identified rigid body.
    comparisons : scores of the FMUs on each test set.
    models : fitted model of each law.
    fmus : path of each law's FMU.
    """

    rigid_body: RigidBody
    comparisons: Mapping[str, Comparison]
    models: Mapping[str, FrictionModel]
    fmus: Mapping[str, Path]


def run_study(
    path: Path,
    output: Path,
    *,
    platforms: Sequence[str] = ("linux64",),
    progress: Progress | None = None,
) -> Outcome:
    """Run a study and write everything that it makes into a folder, or nothing on an error.

    The scores are those of the FMUs, driven through FMPy over the test logs.

    Parameters
    ----------
    path : study file.
    output : folder of the results.
    platforms : for which the FMUs hold a binary.
    progress : told how far the run has come.

    Raises
    ------
    HesrError
        If the study, a log or the data in it do not allow the run.
    """
    progress = progress or _silent
    study = Study.read(path)
    laws = study.laws or tuple(registry())
    for law in (*laws, *study.options):
        estimator(law)
    description = RobotDescription.read(study.robot)
    model = RobotModel(description)
    with folder_written_whole(output) as folder:
        files = _log_files(study, path, folder, progress)
        logs = {name: RobotLog.read(file, description) for name, file in files.items()}
        progress("identifying the rigid body", 0, 1)
        rigid_body = identify(
            [logs[name] for name in study.logs.identification],
            model,
            reversed_logs=[logs[name] for name in study.logs.reversed],
        )
        progress("identifying the rigid body", 1, 1)
        records = {name: friction_records(log, model, rigid_body) for name, log in logs.items()}
        about = [study.robot, description.model]
        identified = (*study.logs.identification, *study.logs.reversed)
        write_rigid_body(
            folder / "rigid_body.json",
            rigid_body,
            provenance(files=[*about, *(files[name] for name in identified)]),
        )
        models = fit_models(
            laws,
            by_joint([records[name] for name in study.logs.training]),
            robot=description.name,
            seed=study.seed,
            options=study.options,
            provenance=provenance(
                files=[*about, *(files[name] for name in _trained_on(study))], seed=study.seed
            ),
            progress=partial(progress, "fitting laws"),
        )
        for k, (law, fitted) in enumerate(models.items()):
            progress("building FMUs", k, len(models))
            write_model(folder / "laws" / f"{law}.json", fitted)
            export_fmu(fitted, folder / "fmus" / f"{law}.fmu", platforms=platforms)
        progress("building FMUs", len(models), len(models))
        comparisons = _compare(study, laws, records, folder / "fmus", progress)
        write_json(
            folder / "evaluation.json", {name: c.to_json() for name, c in comparisons.items()}
        )
    return Outcome(
        rigid_body=rigid_body,
        comparisons=comparisons,
        models=models,
        fmus={law: output / "fmus" / f"{law}.fmu" for law in laws},
    )


def _silent(what: str, done: int, total: int) -> None:
    """Tell nobody."""


def _trained_on(study: Study) -> list[str]:
    names = (*study.logs.identification, *study.logs.reversed, *study.logs.training)
    return list(dict.fromkeys(names))


def _log_files(study: Study, path: Path, folder: Path, progress: Progress) -> dict[str, Path]:
    """Return the file of every log of the study; the twin's are made now."""
    tested = (name for logs in study.logs.test.values() for name in logs)
    names = dict.fromkeys((*_trained_on(study), *tested))
    if study.twin is None:
        return {name: path.parent / name for name in names}
    made = _twin_logs(study.twin, folder / "logs", progress)
    for name in names:
        if name not in made:
            raise ConfigError(
                f"{path}: key 'logs' names '{name}', which is no motion of {study.twin.motions}; "
                f"its motions give {', '.join(made)}."
            )
    return {name: made[name] for name in names}


def _twin_logs(twin: Twin, folder: Path, progress: Progress) -> dict[str, Path]:
    # MuJoCo is loaded for a twin only, not for measured logs.
    from cosim.studies.excite import Motions, excite
    from fmu_src.arm.plant import Plant

    progress("running the arm", 0, 1)
    made = excite(Motions.read(twin.motions), Plant.read(twin.plant), folder)
    progress("running the arm", 1, 1)
    return made


def _compare(
    study: Study,
    laws: Sequence[str],
    records: Mapping[str, Sequence[FrictionRecord]],
    fmus: Path,
    progress: Progress,
) -> dict[str, Comparison]:
    comparisons = {}
    for k, (name, logs) in enumerate(study.logs.test.items()):
        progress("replaying the FMUs", k, len(study.logs.test))
        tested = by_joint([records[log] for log in logs])
        predictions = {law: predict_fmu(fmus / f"{law}.fmu", tested) for law in laws}
        comparisons[name] = compare(tested, predictions)
    progress("replaying the FMUs", len(study.logs.test), len(study.logs.test))
    return comparisons
