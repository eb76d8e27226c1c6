"""Arguments of public functions: text, paths and objects become lists, logs, robots and laws.

The functions `list_names`, `list_paths`, `list_logs`, `list_laws` and `list_numbers` are the only
ones that distinguish one item from several. A public function calls them first, with the name of
its parameter for the error.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.support.files import PathArg, require_writable, to_path
from hesr_model.support.progress import Progress, Stages, report_progress, silent

if TYPE_CHECKING:
    from fmu_src.plant.plant_fmu import PlantBody
    from hesr_model.audit.properties import Subject
    from hesr_model.findings import Finding
    from hesr_model.fitting.estimator import Estimator
    from hesr_model.friction.model import FrictionModel
    from hesr_model.logs.long_log import LongLog
    from hesr_model.logs.robot_log import Log
    from hesr_model.logs.signals import Motion
    from hesr_model.rigid_body.friction_record import FrictionRecord
    from hesr_model.rigid_body.identification import RigidBody
    from hesr_model.robots.robot import Robot, RobotDescription, RobotLike

    # One item of an argument.
    RobotArg = RobotLike
    LogArg = Log | PathArg
    BodyArg = RigidBody | PathArg
    LawArg = FrictionModel | PathArg
    FittedLawArg = LawArg | type[Estimator]
    # One or several items.
    Logs = LogArg | Iterable[LogArg]
    Laws = LawArg | Iterable[LawArg]
    NamedLaws = Laws | Mapping[str, LawArg]
    # Items after `list_logs` and `list_laws`.
    LogSource = Log | Path
    LawSource = FrictionModel | Path

Names = str | Iterable[str]
Paths = PathArg | Iterable[PathArg]
PerJoint = float | Iterable[float]  # one number for each joint, or one for all

MAX_NUMBERS = 2**22  # numbers of logs that are held in memory
_NUMBER_BYTES = 8  # of a number in a file, roughly
MAX_ROWS = 10**6  # rows of a fit or test

_log = logging.getLogger(__name__)


def list_names(name: str, texts: Names, *, commas: bool = False) -> list[str]:
    """Return one or several texts as a list; with `commas`, a text may hold several names."""
    names: list[str] = list_items(name, texts, (str,), "text, or a sequence of texts")
    if not commas:
        return names
    parts = chain.from_iterable(text.split(",") for text in names)
    return list(filter(None, map(str.strip, parts)))


def list_paths(name: str, files: Paths) -> list[Path]:
    """Return one or several paths as a list."""
    expected = "a path, as text or as a Path, or a sequence of paths"
    return [Path(file) for file in list_items(name, files, (str, PathLike), expected)]


def to_optional_path(name: str, file: PathArg | None) -> Path | None:
    """Return text or a path as a Path, and None as None."""
    if file is None:
        return None
    return to_path(file, f"'{name}'")


def to_optional_output(name: str, file: PathArg | None) -> Path | None:
    """Return the path of a file to write, or None; raise ArtifactError if it cannot be written.

    Work that may take minutes follows.
    """
    path = to_optional_path(name, file)
    if path is not None:
        require_writable(path)
    return path


def list_logs(name: str, logs: Logs) -> list[LogSource]:
    """Return one or several logs as a list of objects and paths; no file is read."""
    from hesr_model.logs.robot_log import Log  # slow to import

    expected = "a Log or a path, or a sequence of these"
    return _to_sources(list_items(name, logs, (Log, str, PathLike), expected))


def list_laws(name: str, laws: Laws) -> list[LawSource]:
    """Return one or several laws as a list of objects and paths; no file is read."""
    from hesr_model.friction.model import FrictionModel  # slow to import

    expected = "a FrictionModel or a path, or a sequence of these"
    return _to_sources(list_items(name, laws, (FrictionModel, str, PathLike), expected))


def list_numbers(name: str, numbers: PerJoint) -> list[float]:
    """Return one or several numbers as a list."""
    expected = "a number, or a sequence of numbers"
    return [float(number) for number in list_items(name, numbers, (Real,), expected)]


def list_items(name: str, value: object, kinds: tuple[type, ...], expected: str) -> list[Any]:
    """Return the value of a parameter as a list, whether it is one item or several.

    Raises ArgumentError with the parameter's `name` for an item that is not of `kinds`.
    """
    if isinstance(value, kinds):
        return [value]
    # Iterating over text gives letters, over a mapping its keys.
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        raise _refuse_kind(name, value, expected)
    items = list(value)
    for item in items:
        if not isinstance(item, kinds):
            raise ArgumentError(
                f"'{name}' contains an item given as {type(item).__name__}; expected {expected}."
            )
    return items


def logs_unless_table(data: object) -> list[LogSource] | None:
    """Return one or several logs as a list, None for a table of motion."""
    from hesr_model.logs.robot_log import Log  # slow to import

    items: list[Any] = [data]
    if isinstance(data, list | tuple | Iterator):
        items = list(data)
    if not items or not all(isinstance(item, Log | str | PathLike) for item in items):
        return None
    return _to_sources(items)


def _to_sources(items: Iterable[Any]) -> list[Any]:
    """Return items with text and path objects as paths; others stay."""
    return [Path(item) if isinstance(item, str | PathLike) else item for item in items]


def require_items(name: str, items: Sequence[object]) -> None:
    """Raise ArgumentError for an empty list."""
    if not items:
        raise ArgumentError(f"'{name}' is empty; give at least one.")


def require_mapping(name: str, value: object) -> None:
    """Raise ArgumentError unless an argument is a mapping or None."""
    _require_kind(name, value, Mapping, "a mapping")


def require_text(name: str, value: object) -> None:
    """Raise ArgumentError unless an argument is text or None."""
    _require_kind(name, value, str, "text")


def require_number(name: str, value: object) -> None:
    """Raise ArgumentError unless an argument is a number or None."""
    _require_kind(name, value, Real, "a number")


def _require_kind(name: str, value: object, kind: type, expected: str) -> None:
    if value is not None and not isinstance(value, kind):
        raise _refuse_kind(name, value, expected)


def _refuse_kind(name: str, value: object, expected: str) -> ArgumentError:
    return ArgumentError(f"'{name}' is given as {type(value).__name__}; expected {expected}.")


def paths_among(*arguments: object) -> list[Path]:
    """Return the arguments that are paths; others are objects or None."""
    return [Path(argument) for argument in arguments if isinstance(argument, str | PathLike)]


@dataclass(frozen=True, kw_only=True)
class CheckedLogs:
    """Logs that passed the checks, with their robot and known files of both.

    `findings` has the warnings of the checks and the accepted errors.
    """

    logs: list[Log]
    robot: Robot
    findings: list[Finding]
    files: list[Path]
    long_logs: list[LongLog] = field(default_factory=list)  # `logs` are then some of their rows

    @property
    def lacks_torque(self) -> bool:
        """Whether friction must be found from commands and positions."""
        return not all(log.has_torque for log in self.logs)

    def find_body(self, body: BodyArg | None) -> RigidBody:
        """Return the given rigid body, by default one identified from the logs."""
        if body is None and self.long_logs:
            from hesr_model.rigid_body.accumulation import identify_long

            return identify_long(self.long_logs, self.robot)
        return find_body(body, self.logs, self.robot)

    def compute_records(self, body: RigidBody, seed: int = 0) -> list[list[FrictionRecord]]:
        """Return the friction in each part of the logs, [part][joint].

        Of long logs these are up to 10^6 rows, in pieces that cover speed, load and rest.
        """
        from hesr_model.rigid_body.residual import motion_records

        return [motion_records(motion, self.robot, body) for motion in self.collect_motions(seed)]

    def collect_motions(self, seed: int = 0) -> list[Motion]:
        """Return the smoothed parts of the logs; of long logs those of `compute_records`."""
        from hesr_model.logs.sample import MotionSample
        from hesr_model.logs.signals import smooth_logs

        if not self.long_logs:
            return smooth_logs(self.logs, self.robot)
        sample = MotionSample(MAX_ROWS, seed)
        row_count = 0
        for log in self.long_logs:
            for motion in log.motions():
                sample.add(motion, is_continuation=float(motion.t[0]) not in log.starts)
                row_count += len(motion.t)
        motions = sample.motions()
        used_count = sum(len(motion.t) for motion in motions)
        if used_count < row_count:
            _log.warning(
                "The logs have %d rows; %d are used, in whole pieces that cover speed, load and "
                "rest.",
                row_count,
                used_count,
            )
        return motions


def read_logs(
    sources: Sequence[LogSource], robot: RobotArg | None = None, progress: Progress = silent
) -> list[Log]:
    """Return logs, reading those that are paths, which needs a robot."""
    from hesr_model.logs.robot_log import Log

    robot_of_paths = robot
    if robot_of_paths is None:
        robot_of_paths = _find_first_robot(sources)
    logs = []
    for source in report_progress(sources, progress, _source_name):
        if isinstance(source, Log):
            logs.append(source)
            continue
        if robot_of_paths is None:
            raise ArgumentError(f"{source}: give 'robot' to read this log.")
        logs.append(Log.read(source, robot_of_paths))
    return logs


def _find_first_robot(sources: Iterable[LogSource]) -> RobotDescription | None:
    """Return the robot of the first log object that has one."""
    from hesr_model.logs.robot_log import Log

    robots = (source.robot for source in sources if isinstance(source, Log) and source.robot)
    return next(robots, None)


def _source_name(source: LogSource) -> str:
    if isinstance(source, Path):
        return str(source)
    return source.name


def find_robot(robot: RobotArg | None, logs: Sequence[Log]) -> Robot:
    """Return the given robot, by default that of the logs."""
    from hesr_model.robots.robot import to_robot

    if robot is not None:
        return to_robot(robot)
    robot_of_logs = _find_first_robot(logs)
    if robot_of_logs is None:
        raise ArgumentError("the logs do not name their robot; give 'robot'.")
    return to_robot(robot_of_logs)


def _open_long_logs(sources: Sequence[LogSource], robot: RobotArg | None) -> list[LongLog]:
    """Return all logs to be read in pieces, or none if they fit into memory together."""
    from hesr_model.logs.long_log import LongLog
    from hesr_model.robots.robot import to_robot

    number_count = 0.0
    for source in sources:
        if not isinstance(source, Path):
            number_count += 3 * source.q.size
        elif source.is_file():  # a missing file is refused by its reader
            number_count += source.stat().st_size / _NUMBER_BYTES
    robot_of_logs = robot or _find_first_robot(sources)
    if robot_of_logs is None or number_count <= MAX_NUMBERS:
        return []
    description = to_robot(robot_of_logs).description
    if description.log.columns.q_link or description.log.sort:  # need all rows at once
        return []
    return [LongLog(source, description) for source in sources]


def read_checked_logs(
    sources: Sequence[LogSource],
    robot: RobotArg | None,
    accept: Sequence[str],
    progress: Stages = silent,
    *,
    in_pieces: bool = False,
    from_commands: bool = False,
) -> CheckedLogs:
    """Read logs and check them on their robot; raise HealthError for errors not in `accept`.

    Only some rows of long logs are read and checked if the others can be read `in_pieces`. Logs
    without torque are refused, unless the caller takes the way `from_commands` for them.
    """
    from hesr_model.robots.robot import to_robot

    require_items("logs", sources)
    long_logs: list[LongLog] = []
    if in_pieces:
        long_logs = _open_long_logs(sources, robot)
    piece_logs: list[LogSource] = []
    for long_log in long_logs:
        piece_logs += long_log.checked_pieces
    stated_robot = None
    if robot is not None:
        stated_robot = to_robot(robot)
    logs = read_logs(piece_logs or sources, stated_robot, partial(progress, "reading logs"))
    checked_robot = stated_robot or find_robot(None, logs)
    require_one_way(logs, from_commands=from_commands)
    findings = require_healthy(logs, checked_robot, accept)
    for long_log in long_logs:
        findings += _report_gaps(long_log)
    log_paths = [log.path for log in logs if log.path]
    files = dict.fromkeys([*paths_among(robot), checked_robot.description.model, *log_paths])
    return CheckedLogs(
        logs=logs, robot=checked_robot, findings=findings, files=list(files), long_logs=long_logs
    )


def _report_gaps(long_log: LongLog) -> list[Finding]:
    """Log and return what the gaps of a long log mean; its pieces do not show them."""
    from hesr_model.findings import log_findings
    from hesr_model.health.examine import add_log_name
    from hesr_model.health.positions import report_gaps
    from hesr_model.health.referee import state

    if not long_log.gaps:
        return []
    gaps = report_gaps(
        long_log.gaps, long_log.longest_step, len(long_log.starts), long_log.short_rows
    )
    return log_findings(state(add_log_name(long_log.checked_pieces[0], [gaps])))


def require_one_way(logs: Sequence[Log], *, from_commands: bool) -> None:
    """Raise LogError for logs without torque where it is needed, and for logs of both kinds."""
    from hesr_model.errors import LogError

    without_torque = [log for log in logs if not log.has_torque]
    if not without_torque:
        return
    if not from_commands:
        raise LogError(
            f"{without_torque[0].where}: has no torque, which this command needs; without it, "
            "'hesr fit' and 'hesr identify' use commands and positions.",
            code="log.no_torque",
            where=without_torque[0].where,
            key="tau",
        )
    if len(without_torque) < len(logs):
        raise LogError(
            f"{without_torque[0].where}: has no torque, other logs have; use logs of one kind.",
            code="log.no_torque",
            where=without_torque[0].where,
            key="tau",
        )


def require_healthy(logs: Sequence[Log], robot: Robot, accept: Sequence[str]) -> list[Finding]:
    """Check logs on their robot: refuse errors, log and return warnings."""
    from hesr_model.findings import log_findings
    from hesr_model.health.examine import check_logs
    from hesr_model.logs.robot_log import require_different

    require_different(logs)
    return log_findings(check_logs(logs, robot, accept))


def find_body(body: BodyArg | None, logs: Sequence[Log], robot: Robot) -> RigidBody:
    """Return the given rigid body, by default one of the kind that predicts the logs best."""
    if body is not None:
        return read_body(body)
    from hesr_model.rigid_body.choice import identify_from_logs

    return identify_from_logs(logs, robot)


def read_body(body: BodyArg) -> RigidBody:
    """Return a rigid body; a path is read."""
    from hesr_model.rigid_body.identification import RigidBody

    if isinstance(body, RigidBody):
        return body
    return RigidBody.read(to_path(body, "'rigid_body'"))


def build_plant_body(robot: RobotArg, body: BodyArg | None) -> PlantBody:
    """Return a robot with a rigid body or the parameters of its model file."""
    from fmu_src.plant.plant_fmu import PlantBody
    from hesr_model.robots.robot import to_robot

    rigid_body = None
    if body is not None:
        rigid_body = read_body(body)
    return PlantBody.from_robot(to_robot(robot), rigid_body)


def read_model(law: LawArg) -> FrictionModel:
    """Return a friction model; a path or the name of a built-in model is read."""
    from hesr_model.friction.model import FrictionModel

    if isinstance(law, FrictionModel):
        return law
    return FrictionModel.read(law)


def read_laws(laws: NamedLaws) -> list[Subject]:
    """Return models, FMUs and built-in names as laws, each with a unique name."""
    if isinstance(laws, Mapping):
        subjects = []
        for name, law in laws.items():
            [source] = list_laws("laws", law)
            subjects.append(replace(_read_subject(source), name=str(name)))
        return subjects
    sources = list_laws("laws", laws)
    require_items("laws", sources)
    subjects = [_read_subject(source) for source in sources]
    names = _choose_law_names(sources, subjects)
    return [replace(subject, name=name) for name, subject in zip(names, subjects, strict=True)]


def _choose_law_names(sources: Sequence[LawSource], subjects: Sequence[Subject]) -> Sequence[str]:
    """Return the names of laws: their laws, else stems of their files, else the paths."""
    from fmu_src import BUILT_IN

    law_names = []
    stems = []
    paths = []
    for source, subject in zip(sources, subjects, strict=True):
        path = str(source) if isinstance(source, Path) else source.law
        stem = Path(path).stem
        law_name = stem
        if path in BUILT_IN:  # such a name is no file
            stem = path
            law_name = path
        elif subject.model and subject.fmu is None:
            law_name = subject.model.law
        law_names.append(law_name)
        stems.append(stem)
        paths.append(path)
    return choose_unique_names([law_names, stems, paths], "given")


def _read_subject(source: LawSource) -> Subject:
    from fmu_src import BUILT_IN
    from hesr_model.audit.properties import Subject

    if not isinstance(source, Path):
        return Subject(name="", model=source)
    suffix = source.suffix.lower()
    if suffix == ".fmu":
        from fmu_src.friction.embedded_model import read_embedded_model

        return Subject(name="", model=read_embedded_model(source), fmu=source)
    if suffix == ".xml":
        from hesr_model.friction.mujoco_friction import read_mujoco_friction

        return Subject(name="", model=read_mujoco_friction(source))
    if str(source) not in BUILT_IN and suffix != ".json":
        raise ConfigError(
            f"'{source}' is neither a friction model (.json), an FMU (.fmu), an MJCF (.xml), nor "
            f"one of {', '.join(BUILT_IN)}."
        )
    return Subject(name="", model=read_model(source))


def choose_unique_names(namings: Sequence[Sequence[str]], what: str) -> Sequence[str]:
    """Return the first row of `namings` (ways, things) whose names are unique.

    The error names a duplicate and uses `what`, a past participle ("given").
    """
    for names in namings:
        if len(set(names)) == len(names):
            return names
    raise ConfigError(f"'{Counter(namings[-1]).most_common(1)[0][0]}' is {what} twice.")


def require_choice(name: str, value: object, allowed: Iterable[object]) -> None:
    """Raise ArgumentError unless an option has an allowed value."""
    choices = tuple(allowed)
    if value not in choices:
        raise ArgumentError(f"'{name}' is {value}; allowed are {', '.join(map(str, choices))}.")


def expand_per_joint(name: str, values: PerJoint | None, joints: int) -> tuple[float, ...] | None:
    """Return one value per joint; a single value serves all."""
    if values is None:
        return None
    numbers = tuple(list_numbers(name, values))
    if len(numbers) == joints:
        return numbers
    if len(numbers) != 1:
        raise ArgumentError(
            f"'{name}': found {len(numbers)} values, but the model has {joints} joints; expected "
            "one per joint, or one for all."
        )
    return numbers * joints


def remember_trust(fmus: Iterable[Path], *, trust: bool) -> None:
    """Record FMUs as trusted if `trust` is set."""
    if trust:
        from fmu_src.run.trust import remember

        for fmu in fmus:
            if fmu.is_file():  # a missing file is refused by its reader
                remember(fmu)
