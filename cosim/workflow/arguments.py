"""Arguments of workflow functions: text, paths and objects become logs, robots, bodies and laws."""

import logging
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src import BUILT_IN, model_file
from hesr_model.audit.properties import Subject
from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.findings import Finding, log_findings
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.long_log import LongLog
from hesr_model.logs.robot_log import Log, parts_of, require_different
from hesr_model.logs.sample import Sample
from hesr_model.rigid_body.accumulation import identify_long
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import FrictionRecord, friction_records, motion_records
from hesr_model.robots.robot import Robot, RobotLike, model_of
from hesr_model.support.files import PathArg, path_of
from hesr_model.support.progress import Progress, Stages, counted, silent

if TYPE_CHECKING:
    from fmu_src.plant.plant_fmu import PlantBody

_log = logging.getLogger(__name__)

RobotArg = RobotLike
LogArg = Log | PathArg
Logs = LogArg | Sequence[LogArg]
BodyArg = RigidBody | PathArg
LawArg = FrictionModel | PathArg
Laws = LawArg | Sequence[LawArg] | Mapping[str, LawArg]
FmuArgs = PathArg | Sequence[PathArg]
ResultArgs = PathArg | Sequence[PathArg]
PerJoint = float | Sequence[float]  # one number for each joint, or one for all

MOST_CELLS = 2**22
_CELL = 8  # numbers of logs held in memory, and their size [B]
MOST_ROWS = 10**6  # rows of a fit or test


@dataclass(frozen=True, kw_only=True)
class CheckedLogs:
    """Logs that passed the checks, with their robot and known files of both.

    `findings` has the warnings of the checks and the accepted errors.
    """

    logs: list[Log]
    robot: Robot
    findings: list[Finding]
    files: list[Path]
    longs: list[LongLog] = field(default_factory=list)  # `logs` are then some of their rows

    def body(self, body: BodyArg | None) -> RigidBody:
        """Return the given rigid body, by default one identified from the logs."""
        if body is None and self.longs:
            return identify_long(self.longs, self.robot)
        return body_of(body, self.logs, self.robot)

    def records(self, body: RigidBody, seed: int = 0) -> list[list[FrictionRecord]]:
        """Return the friction in each part of the logs, [part][joint].

        Of long logs these are up to 10^6 rows, in stretches that cover speed, load and rest.
        """
        if not self.longs:
            return [friction_records(part, self.robot, body) for part in parts_of(self.logs)]
        sample = Sample(MOST_ROWS, seed)
        rows = 0
        for log in self.longs:
            for motion in log.motions():
                sample.add(motion, follows=float(motion.t[0]) not in log.starts)
                rows += len(motion.t)
        motions = sample.motions()
        used = sum(len(motion.t) for motion in motions)
        if used < rows:
            _log.warning(
                "The logs have %d rows; %d are used, in whole stretches that cover speed, load and "
                "rest.",
                rows,
                used,
            )
        return [motion_records(motion, self.robot, body) for motion in motions]


def logs_of(logs: Logs, robot: RobotArg | None = None, progress: Progress = silent) -> list[Log]:
    """Return logs, reading those that are paths, which needs a robot."""
    several = listed(logs)
    known = robot
    if known is None:
        known = next((g.robot for g in several if isinstance(g, Log) and g.robot), None)
    read = []
    for log in counted(
        several, progress, lambda log: log.name if isinstance(log, Log) else str(log)
    ):
        if isinstance(log, Log):
            read.append(log)
            continue
        path = path_of(log, "a log")
        if known is None:
            raise ArgumentError(f"{path}: give 'robot' to read this log.")
        read.append(Log.read(path, known))
    return read


def robot_of(robot: RobotArg | None, logs: Sequence[Log]) -> Robot:
    """Return the given robot, by default that of the logs."""
    found = robot if robot is not None else next((log.robot for log in logs if log.robot), None)
    if found is None:
        raise ArgumentError("the logs do not name their robot; give 'robot'.")
    return model_of(found)


def _long_logs(logs: Sequence[LogArg], robot: RobotArg | None) -> list[LongLog]:
    """Return all logs to be read in pieces, or none if they fit into memory together."""
    sources = [log if isinstance(log, Log) else path_of(log, "a log") for log in logs]
    cells = [
        3 * log.q.size if isinstance(log, Log) else log.stat().st_size / _CELL
        for log in sources
        if isinstance(log, Log) or log.is_file()  # a missing file is refused by its reader
    ]
    own = robot or next((log.robot for log in sources if isinstance(log, Log) and log.robot), None)
    if own is None or sum(cells) <= MOST_CELLS:
        return []
    description = model_of(own).description
    if description.log.columns.q_link or description.log.sort:  # need all rows at once
        return []
    return [LongLog(source, description) for source in sources]


def checked_logs(
    logs: Logs,
    robot: RobotArg | None,
    accept: Sequence[str],
    progress: Stages = silent,
    *,
    in_pieces: bool = False,
) -> CheckedLogs:
    """Read logs and check them on their robot; raise HealthError for errors not in `accept`.

    Only some rows of long logs are read and checked if the others can be read `in_pieces`.
    """
    longs = _long_logs(listed(logs), robot) if in_pieces else []
    logs = [part for log in longs for part in log.stretches] or logs
    known = model_of(robot) if robot is not None else None
    read = logs_of(logs, known, partial(progress, "reading logs"))
    model = known or robot_of(None, read)
    findings = require_healthy(read, model, accept)
    for log in longs:
        if log.gaps:
            from hesr_model.health.examine import of_log
            from hesr_model.health.positions import of_gaps

            finding = of_gaps(log.gaps, log.longest_step, len(log.starts))
            findings += log_findings(of_log(log.stretches[0], [finding]))
    own = [Path(robot)] if isinstance(robot, str | PathLike) else []
    paths = dict.fromkeys([*own, model.description.model, *(g.path for g in read if g.path)])
    return CheckedLogs(logs=read, robot=model, findings=findings, files=list(paths), longs=longs)


def require_healthy(logs: Sequence[Log], model: Robot, accept: Sequence[str]) -> list[Finding]:
    """Check logs on their robot: refuse errors, log and return warnings."""
    require_different(logs)
    from hesr_model.health.examine import checked  # slow to import

    return log_findings(checked(logs, model, accept))


def body_of(body: BodyArg | None, logs: Sequence[Log], robot: Robot) -> RigidBody:
    """Return the given rigid body, by default one identified from the logs."""
    if body is None:
        return identify(logs, robot)
    return body if isinstance(body, RigidBody) else RigidBody.read(path_of(body, "a rigid body"))


def plant_body(robot: RobotArg, body: BodyArg | None) -> "PlantBody":
    """Return a robot with a rigid body or the parameters of its model file."""
    from fmu_src.plant.plant_fmu import PlantBody

    model = model_of(robot)
    return PlantBody.of(model, None if body is None else body_of(body, (), model))


def model_given(model: LawArg) -> FrictionModel:
    """Return a friction model; a path or the name of a built-in model is read."""
    if isinstance(model, FrictionModel):
        return model
    return FrictionModel.read(model_file(str(path_of(model, "a friction model"))))


def laws_of(laws: Laws) -> list[Subject]:
    """Return models, FMUs and built-in names as laws, each with a unique name."""
    if isinstance(laws, Mapping):
        return [replace(_law(law), name=str(name)) for name, law in laws.items()]
    several = listed(laws)
    read = [_law(law) for law in several]
    paths = [law.law if isinstance(law, FrictionModel) else str(law) for law in several]
    stems = [path if path in BUILT_IN else Path(path).stem for path in paths]
    by_law = [
        one.model.law if one.model and not one.fmu and path not in BUILT_IN else stem
        for path, stem, one in zip(paths, stems, read, strict=True)
    ]
    names = telling_apart([by_law, stems, paths], "given")
    return [replace(one, name=name) for name, one in zip(names, read, strict=True)]


def _law(law: LawArg) -> Subject:
    if isinstance(law, FrictionModel):
        return Subject(name="", model=law)
    path = path_of(law, "a law")
    suffix = path.suffix.lower()
    if suffix == ".fmu":
        from fmu_src.friction.embedded_model import embedded_model

        return Subject(name="", model=embedded_model(path), fmu=path)
    if str(path) not in BUILT_IN and suffix != ".json":
        raise ConfigError(
            f"'{path}' is neither a friction model (.json), nor an FMU (.fmu), nor one of "
            f"{', '.join(BUILT_IN)}."
        )
    return Subject(name="", model=model_given(path))


def telling_apart(namings: Sequence[Sequence[str]], what: str) -> Sequence[str]:
    """Return the first row of `namings` (ways, things) whose names are unique.

    The error names a duplicate and uses `what`, a past participle ("given").
    """
    for names in namings:
        if len(set(names)) == len(names):
            return names
    raise ConfigError(f"'{Counter(namings[-1]).most_common(1)[0][0]}' is {what} twice.")


def require_choice(name: str, value: object, allowed: Iterable[object]) -> None:
    """Raise ArgumentError unless an option has an allowed value."""
    if value not in (known := tuple(allowed)):
        raise ArgumentError(f"'{name}' is {value}; allowed are {', '.join(map(str, known))}.")


def per_joint(name: str, values: PerJoint | None, joints: int) -> tuple[float, ...] | None:
    """Return one value per joint; a single value serves all."""
    if values is None:
        return None
    several = tuple(values) if isinstance(values, Sequence) else (float(values),)
    if len(several) == joints:
        return several
    if len(several) > 1:
        raise ArgumentError(
            f"'{name}': found {len(several)} values, but the model has {joints} joints; expected "
            "one per joint, or one for all."
        )
    return several * joints


def listed(given: Any) -> list[Any]:
    """Return an iterable as a list, anything else as the only item of one."""
    several = isinstance(given, Iterable) and not isinstance(given, str | PathLike)
    return list(given) if several else [given]


def joint_names(joints: Sequence[str]) -> list[str]:
    """Return joint names, splitting texts with several names at commas."""
    return [name.strip() for joint in joints for name in joint.split(",") if name.strip()]


def paths_of(files: PathArg | Sequence[PathArg], what: str) -> list[Path]:
    """Return one or several paths as a list; the error calls one of them `what`."""
    return [path_of(file, what) for file in listed(files)]


def remember_trust(fmus: Iterable[Path], *, trust: bool) -> None:
    """Record FMUs as trusted if `trust` is set."""
    if trust:
        from fmu_src.run.trust import remember

        for fmu in fmus:
            if fmu.is_file():  # a missing file is refused by its reader
                remember(fmu)
