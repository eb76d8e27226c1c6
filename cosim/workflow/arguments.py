"""What calls in Python are given: logs, robots, bodies and models, each itself or its file."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.study.results import log_findings
from fmu_src import model_file
from hesr_model.errors import ConfigError, RobotError
from hesr_model.findings import Finding
from hesr_model.friction.model import FrictionModel
from hesr_model.health.examine import checked
from hesr_model.logs.robot_log import RobotLog, parts_of, require_different
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import FrictionRecord, friction_records
from hesr_model.robots.robot import RobotLike, RobotModel, model_of
from hesr_model.support.files import PathArg as PathArg
from hesr_model.support.files import path_of
from hesr_model.support.progress import Progress, counted, silent

if TYPE_CHECKING:
    from fmu_src.pages.live.body import PageBody

AnyPath = str | PathLike[str]
FmuArgs = AnyPath | Sequence[AnyPath]
Log = RobotLog | AnyPath
Body = RigidBody | AnyPath
Model = FrictionModel | AnyPath


def logs_of(
    logs: Log | Sequence[Log], robot: RobotLike | None, progress: Progress = silent
) -> list[RobotLog]:
    """Return logs, those read that are given by their paths.

    Raises
    ------
    RobotError
        If a log is to be read and no robot is known.
    """
    several = listed(logs)
    known = robot if robot is not None else next(
        (log.robot for log in several if isinstance(log, RobotLog) and log.robot), None
    )  # fmt: skip
    read = []
    for log in counted(several, progress):
        if isinstance(log, RobotLog):
            read.append(log)
            continue
        path = path_of(log, "a log")
        if known is None:
            raise RobotError(f"{path}: to read this log its robot must be known; give 'robot'.")
        read.append(RobotLog.read(path, known))
    return read


def robot_of(robot: RobotLike | None, logs: Sequence[RobotLog]) -> RobotModel:
    """Return the robot that is given, or that of the logs.

    Raises
    ------
    RobotError
        If neither is known.
    """
    found = robot if robot is not None else next((log.robot for log in logs if log.robot), None)
    if found is None:
        raise RobotError("the logs do not say of which robot they are; give 'robot'.")
    return model_of(found)


def body_of(body: Body | None, logs: Sequence[RobotLog], robot: RobotModel) -> RigidBody:
    """Return the rigid body that is given, or that which the logs tell of."""
    if body is None:
        return identify(logs, robot)
    return body if isinstance(body, RigidBody) else RigidBody.read(path_of(body, "a rigid body"))


def page_body(robot: RobotLike, body: Body) -> "PageBody":
    """Return a rigid body as the page of an FMU takes it.

    Raises
    ------
    RobotError
        If the body is of another robot.
    """
    from fmu_src.pages.live.body import PageBody

    model = model_of(robot)
    return PageBody.of(model, body_of(body, (), model))


def listed(given: Any) -> list[Any]:
    """Return what is given as a list, of one where it is none."""
    several = isinstance(given, Iterable) and not isinstance(given, str | PathLike)
    return list(given) if several else [given]


def records_of(
    logs: Log | Sequence[Log],
    robot: RobotLike | None,
    rigid_body: Body | None,
    accept: Sequence[str],
    progress: Progress = silent,
) -> tuple[list[list[FrictionRecord]], RobotModel, list[Finding]]:
    """Return the friction in each log [log][joint], the robot, and what is odd in the logs."""
    read = logs_of(logs, robot, progress)
    model = robot_of(robot, read)
    findings = examined(read, model, accept)
    body = body_of(rigid_body, read, model)
    return [friction_records(part, model, body) for part in parts_of(read)], model, findings


def examined(logs: Sequence[RobotLog], model: RobotModel, accept: Sequence[str]) -> list[Finding]:
    """Check logs on their robot; what cannot be right raises, what is odd is told and returned."""
    require_different(logs)
    return log_findings(checked(logs, model, accept))


def telling_apart(namings: Sequence[Sequence[str]], what: str) -> Sequence[str]:
    """Return the first of several ways to name things that gives each a name of its own.

    Parameters
    ----------
    namings : (ways, things) names.
    what : has been done with the things, for the error.

    Raises
    ------
    ConfigError
        If none does, naming what is there twice.
    """
    for names in namings:
        if len(set(names)) == len(names):
            return names
    raise ConfigError(f"'{Counter(namings[-1]).most_common(1)[0][0]}' is {what} twice.")


def model_given(model: Model) -> FrictionModel:
    """Return a friction model, read where it is given by its file or built-in name."""
    if isinstance(model, FrictionModel):
        return model
    return FrictionModel.read(model_file(str(path_of(model, "a friction model"))))


def named(models: Any) -> dict[str, FrictionModel]:
    """Return friction models by name: by their law, or as a mapping says.

    Raises
    ------
    ConfigError
        If two have the same law, or there is none.
    """
    if isinstance(models, Mapping):
        return {str(name): model_given(model) for name, model in models.items()}
    read = [model_given(model) for model in listed(models)]
    found = {model.law: model for model in read}
    if len(found) != len(read) or not read:
        raise ConfigError(
            f"{len(read)} friction models have {len(found)} names; give a mapping that names each."
        )
    return found


def paths_of(files: PathArg | Sequence[PathArg], what: str) -> list[Path]:
    """Return one or several paths as a list; `what` names one in the error."""
    return [path_of(file, what) for file in listed(files)]


def remember_trust(fmus: Iterable[Path], *, trust: bool) -> None:
    """Record FMUs as trusted if `trust` is set."""
    if trust:
        from fmu_src.run.trust import remember

        for fmu in fmus:
            if fmu.is_file():  # a missing file is refused where it is read
                remember(fmu)
