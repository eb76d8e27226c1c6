"""Saved results of a run: `run.json`, `health.json` and torque traces, read by reports."""

import logging
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import ConfigDict

from cosim.study.sample_logs import is_sample
from cosim.study.scores import Comparison, LogRecords, Predictions, inputs_of
from cosim.study.study import Study, TimeBand
from hesr_model.findings import Finding
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import RobotLog
from hesr_model.logs.tables import read_table, write_table
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.robots.robot import RobotModel
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json

RUN, TRACES, TRUTHS, HEALTH = "run.json", "traces", "truths.json", "health.json"
RUN_FORMAT, HEALTH_FORMAT = "hesr-run-1", "hesr-health-1"
MOST_ROWS = 20_000
"""Maximum number of rows of a trace; the rest of a longer log is not shown."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class SavedLog:
    """A log of a run.

    Attributes
    ----------
    name, file : name of the log, and its file without the folder.
    sha256 : hash of the file.
    roles : uses of the log: "identification", "training", or names of test sets.
    rows : number of samples.
    duration : length [s].
    rate : sample rate [Hz].
    trace : file in `traces/`; empty if its torques are not saved.
    sample : whether it is a simulated log made by `hesr new`.
    """

    name: str
    file: str
    sha256: str
    roles: tuple[str, ...]
    rows: int
    duration: float
    rate: float
    trace: str = ""
    sample: bool = False


@dataclass(frozen=True, kw_only=True)
class SavedRun:
    """Description of a run.

    Attributes
    ----------
    study : name of the study.
    command : command that repeats the run.
    robot, model : name of the robot and of its model file.
    joints : names of the joints.
    gear_ratio : motor turns per turn of each joint; empty if unknown.
    twin : whether the logs come from the digital twin.
    truth : friction of the twin instead of that of its MJCF; empty for none.
    quick : whether it was a quick run.
    seed : seed of every fit.
    logs : all logs.
    bands : parts of test sets with scores of their own.
    inputs : inputs of each law.
    variants : law behind each variant.
    controller : parameters of the closed loop; empty without one.
    versions : versions of the programs.
    left_out : reason for each law of the study that was not fitted.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid")

    study: str
    command: str
    robot: str
    model: str
    joints: tuple[str, ...]
    gear_ratio: tuple[float, ...]
    twin: bool
    quick: bool
    seed: int
    logs: tuple[SavedLog, ...]
    bands: tuple[TimeBand, ...]
    inputs: Mapping[str, str]
    variants: Mapping[str, str]
    controller: Mapping[str, Any]
    versions: Mapping[str, str]
    left_out: Mapping[str, str] = field(default_factory=dict)
    truth: str = ""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read `run.json`.

        Raises
        ------
        ArtifactError
            If the file is damaged, naming the file and the key.
        """
        return from_json(cls, read_json(path, RUN_FORMAT), path, "the description of a run")


@dataclass(frozen=True, kw_only=True)
class Scored:
    """Results of a run up to the scores on the test logs.

    Attributes
    ----------
    study : the study.
    robot : model of the robot.
    rigid_body : the identified rigid body.
    files, logs, records : of every log by name; records by part of the log and joint.
    models : fitted model of each law.
    left_out : reason for each law of the study that was not fitted.
    source : provenance of the laws.
    fmus : path of each law's FMU.
    comparisons : scores of the FMUs on each test set.
    predictions : torques of the FMUs there.
    """

    study: Study
    robot: RobotModel
    rigid_body: RigidBody
    files: Mapping[str, Path]
    logs: Mapping[str, RobotLog]
    records: LogRecords
    models: Mapping[str, FrictionModel]
    left_out: Mapping[str, str]
    source: Mapping[str, Any]
    fmus: Mapping[str, Path]
    comparisons: Mapping[str, Comparison]
    predictions: Predictions


@dataclass(frozen=True, kw_only=True)
class _Findings:
    findings: tuple[Finding, ...]


def save_run(folder: Path, run: Scored, *, command: str, quick: bool) -> None:
    """Write `run.json`, and the torques of the first log of each role."""
    study, robot, files = run.study, run.robot.description, run.files
    traces = _save_torques(folder / TRACES, run)
    stems = Counter(log.name for log in run.logs.values())
    twin = {"mujoco": version("mujoco")} if study.twin else {}
    saved = SavedRun(
        study=study.name,
        command=command,
        robot=robot.name,
        model=robot.model.name,
        joints=robot.joints,
        gear_ratio=robot.gear_ratio or (),
        twin=study.twin is not None,
        truth=(study.twin and study.twin.truth) or "",
        quick=quick,
        seed=study.seed,
        logs=tuple(
            SavedLog(
                name=log.name if stems[log.name] == 1 else name,
                file=_file(name, files[name]),
                sha256=sha256(files[name]),
                roles=_roles(study, name),
                rows=len(log.t),
                duration=float(log.t[-1] - log.t[0]),
                rate=float(1.0 / np.median(np.diff(log.t))),
                trace=traces.get(name, ""),
                sample=is_sample(files[name]),
            )
            for name, log in run.logs.items()
        ),
        bands=study.bands,
        inputs={law: inputs_of(model) for law, model in run.models.items()},
        variants={name: variant.law for name, variant in study.variants.items()},
        left_out=run.left_out,
        controller=study.tracking.model_dump(mode="json") if study.tracking else {},
        versions={**run.source["versions"], **twin, "fmpy": version("fmpy")},
    )
    write_json(folder / RUN, {"format": RUN_FORMAT, **to_json(saved)})


def _file(name: str, file: Path) -> str:
    """Return a log's file as the study names it, without folders of the machine."""
    inside = PurePath(name)
    known = file.match(name) and not inside.is_absolute() and ".." not in inside.parts
    return inside.as_posix() if known else file.name


def _roles(study: Study, name: str) -> tuple[str, ...]:
    logs = study.logs
    of_role = {
        "identification": (*logs.identification, *logs.reversed),
        "training": logs.training,
        **logs.test,
    }
    return tuple(role for role, names in of_role.items() if name in names)


def _save_torques(folder: Path, run: Scored) -> dict[str, str]:
    """Write the torques of the first log of each role, up to a gap; return their files by log."""
    logs = run.study.logs
    first: dict[str, dict[str, list[Array]]] = {logs.identification[0]: {}}
    for test, names in logs.test.items():
        first[names[0]] = {
            law: [of_joint[0] for of_joint in predicted]
            for law, predicted in run.predictions[test].items()
        }
    traces = {}
    for k, (name, predicted) in enumerate(first.items(), start=1):
        traces[name] = f"torques_{k}.parquet"
        write_torques(folder / traces[name], run.records[name][0], predicted)
    return traces


def write_torques(
    path: Path, records: Sequence[FrictionRecord], predicted: Mapping[str, Sequence[Array]]
) -> None:
    """Write the torques of one log to Parquet: measured, rigid body, and every law.

    Parameters
    ----------
    path : file with the columns t, then for joint k of 1..n: q{k}, dq{k}, tau{k} (measured),
        tau_rb{k} (rigid body) and {law}.tau_f{k} (friction).
    records : one per joint.
    predicted : friction torque (N,) of each law and joint [N.m].
    """
    rows = slice(0, MOST_ROWS)
    columns: dict[str, Array] = {"t": records[0].t[rows] - records[0].t[0]}
    for k, record in enumerate(records, start=1):
        columns |= {
            f"q{k}": record.q[rows],
            f"dq{k}": record.dq[rows],
            f"tau{k}": (record.tau + record.tau_load)[rows],
            f"tau_rb{k}": record.tau_load[rows],
        }
        for law, torques in predicted.items():
            columns[f"{law}.tau_f{k}"] = torques[k - 1][rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    # Single precision is more than any picture shows.
    write_table(path, {name: values.astype(np.float32) for name, values in columns.items()})


def read_torques(path: Path) -> dict[str, Array]:
    """Read the columns (N,) of `write_torques`.

    Raises
    ------
    LogError
        If the file is missing, damaged, or not finite.
    """
    table = read_table(path)
    return dict(zip(table.names, table.numbers(table.names).T, strict=True))


def log_findings(findings: Iterable[Finding]) -> list[Finding]:
    """Log findings as warnings and return them."""
    listed = list(findings)
    for finding in listed:
        _log.warning("warning: %s [%s]", finding.sentence, finding.check)
    return listed


def write_findings(folder: Path, findings: Sequence[Finding]) -> None:
    """Write findings into a folder of results."""
    found = to_json(_Findings(findings=tuple(findings)))
    write_json(folder / HEALTH, {"format": HEALTH_FORMAT, **found})


def read_findings(folder: Path) -> list[Finding]:
    """Read the findings of a run; results of earlier versions have none.

    Raises
    ------
    ArtifactError
        If the file is damaged.
    """
    path = folder / HEALTH
    if not path.is_file():
        return []
    data = read_json(path, HEALTH_FORMAT)
    return list(from_json(_Findings, data, path, "what checks found").findings)
