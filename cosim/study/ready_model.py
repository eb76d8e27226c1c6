"""Ready models: the laws of measured robots that ship with HESR, for exports by name.

The laws are chosen and fitted on the training logs of the shipped study, once for all processes of
a user, as `hesr run` does without its FMUs and scores.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cosim.study.law_choice import fit_chosen_laws
from cosim.study.steps import Job
from cosim.study.study import Study
from fmu_src.export.cache import software
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth_logs
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.cache import compute_once
from hesr_model.support.files import provenance, scratch_folder
from hesr_model.support.progress import Stages


@dataclass(frozen=True, kw_only=True)
class ReadyModel:
    """Laws of a shipped study, the body that separated their friction, and the logs.

    Attributes
    ----------
    model : law of each joint, fitted to `training`.
    body : rigid body of the robot.
    robot : robot file.
    training, tests : logs of the fit, and further ones.
    """

    model: FrictionModel
    body: RigidBody
    robot: Path
    training: tuple[Log, ...]
    tests: tuple[Log, ...]


def build_ready_model(path: Path, progress: Stages) -> ReadyModel:
    """Return the laws of a shipped study; its first call on a machine takes a minute or two.

    Parameters
    ----------
    path : file of a study with measured logs.
    progress : called with stage, steps done and steps in total.
    """
    study = Study.read(path)
    job = Job(study=study, path=path, progress=progress)
    robot = Robot(job.robot)
    files = job.log_files(path.parent)
    log_files = sorted(set(files.values()))
    logs = {name: job.read(name, file) for name, file in files.items()}
    training = tuple(logs[name] for name in study.logs.training)
    tests = tuple(log for name, log in logs.items() if name not in job.trained_on)

    def make() -> bytes:
        body, _ = job.rigid_body(logs, robot)
        model, _ = fit_chosen_laws(
            smooth_logs(training, robot),
            robot,
            body,
            identifies_body=True,
            laws=job.laws,
            seed=study.seed,
            provenance=provenance(files=[*log_files, study.robot], seed=study.seed),
            progress=progress,
        )
        return _pack(model, body)

    sources = [path, study.robot, job.robot.model, *log_files]
    model, body = _unpack(compute_once("ready", _list_content(sources), make))
    return ReadyModel(model=model, body=body, robot=study.robot, training=training, tests=tests)


def _list_content(files: Iterable[Path | None]) -> list[str | bytes]:
    return [software(), *(file.read_bytes() for file in files if file is not None)]


def _pack(model: FrictionModel, body: RigidBody) -> bytes:
    """Return model and body as one JSON text."""
    with scratch_folder() as folder:
        texts = {}
        for name, value in (("model", model), ("body", body)):
            file = folder / f"{name}.json"
            value.write(file)
            texts[name] = file.read_text(encoding="utf-8")
    return json.dumps(texts).encode()


def _unpack(data: bytes) -> tuple[FrictionModel, RigidBody]:
    with scratch_folder() as folder:
        for name, text in json.loads(data).items():
            (folder / f"{name}.json").write_text(text, encoding="utf-8")
        return FrictionModel.read(folder / "model.json"), RigidBody.read(folder / "body.json")
