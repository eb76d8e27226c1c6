"""Saved results of a run: `run.json`, `health.json` and torque traces."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import ConfigDict

from cosim.study.sample_logs import is_sample
from cosim.study.scores import Comparison, LogRecords, Predictions, name_inputs
from cosim.study.study import Study, TimeBand
from hesr_model.findings import Finding
from hesr_model.forward.output_error import RefinementResult
from hesr_model.friction.model import FrictionModel
from hesr_model.inference.choice import LawChoice
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.logs.readers.arrays import load_table
from hesr_model.logs.robot_log import Log
from hesr_model.logs.tables import read_table, write_table
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256
from hesr_model.support.typed_files import from_json, read_json, to_json, write_json

RUN = "run.json"
COMMAND_RUN = "command_run.json"  # of logs without torque
TRACES = "traces"
TRUTHS = "truths.json"
HEALTH = "health.json"
RUN_FORMAT = "hesr-run-1"
HEALTH_FORMAT = "hesr-health-1"
MAX_TRACE_ROWS = 20_000  # rows per trace


@dataclass(frozen=True, kw_only=True)
class SavedLog:
    """A log of a run."""

    name: str
    file: str  # without its folder
    sha256: str
    roles: tuple[str, ...]  # "identification", "training", or test sets
    rows: int
    duration: float  # [s]
    rate: float  # [Hz]
    trace: str = ""  # file in `traces/`, if any
    sample: bool = False  # made by `hesr new`


@dataclass(frozen=True, kw_only=True)
class SavedRun:
    """Description of a run."""

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid")

    study: str
    command: str  # command that repeats the run
    robot: str
    model: str  # model file
    joints: tuple[str, ...]
    gear_ratio: tuple[float, ...]  # motor turns per joint turn
    twin: bool
    quick: bool
    seed: int
    logs: tuple[SavedLog, ...]
    bands: tuple[TimeBand, ...]
    inputs: Mapping[str, str]  # by law
    variants: Mapping[str, str]  # their laws
    controller: Mapping[str, Any]  # closed loop
    versions: Mapping[str, str]
    left_out: Mapping[str, str] = field(default_factory=dict)  # reasons by law
    truth: str = ""  # alternative plant
    written: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of each other file

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read `run.json`; raise ArtifactError if it is damaged."""
        return from_json(cls, read_json(path, RUN_FORMAT), path, "the description of a run")


@dataclass(frozen=True, kw_only=True)
class ScoredRun:
    """Results of a run up to the scores on the test logs."""

    study: Study
    robot: Robot
    rigid_body: RigidBody
    files: Mapping[str, Path]
    logs: Mapping[str, Log]
    records: LogRecords  # [part][joint] by log
    models: Mapping[str, FrictionModel]
    left_out: Mapping[str, str]  # reasons by law
    left_out_errors: LeftOutErrors
    choice: LawChoice
    source: Mapping[str, Any]  # provenance
    fmus: Mapping[str, Path]
    comparisons: Mapping[str, Comparison]
    predictions: Predictions  # FMU torques
    refined: Mapping[str, RefinementResult] = field(default_factory=dict)  # by output error


@dataclass(frozen=True, kw_only=True)
class _Findings:
    findings: tuple[Finding, ...]


def save_run(folder: Path, run: ScoredRun, *, command: str, quick: bool) -> None:
    """Write `run.json`, and the torques of training logs and of the first log of each role."""
    study = run.study
    description = run.robot.description
    versions = dict(run.source["versions"])
    if study.twin:
        versions["mujoco"] = version("mujoco")
    versions["fmpy"] = version("fmpy")
    controller: Mapping[str, Any] = {}
    if study.tracking:
        controller = study.tracking.model_dump(mode="json")
    saved = SavedRun(
        study=study.name,
        command=command,
        robot=description.name,
        model=description.model.name,
        joints=description.joints,
        gear_ratio=description.gear_ratio or (),
        twin=study.twin is not None,
        truth=study.truth,
        quick=quick,
        seed=study.seed,
        logs=tuple(_describe_logs(run, _save_torques(folder / TRACES, run))),
        bands=study.bands,
        inputs={law_name: name_inputs(model) for law_name, model in run.models.items()},
        variants={name: variant.law for name, variant in study.variants.items()},
        left_out=run.left_out,
        controller=controller,
        versions=versions,
    )
    write_json(folder / RUN, {"format": RUN_FORMAT, **to_json(saved)})


def _describe_logs(run: ScoredRun, traces: Mapping[str, str]) -> Iterator[SavedLog]:
    """Yield the description of each log; `traces` are files by log."""
    logs = run.study.logs
    names_by_role = {
        "identification": (*logs.identification, *logs.reversed),
        "training": logs.training,
        **logs.judged,
    }
    stem_counts = Counter(log.name for log in run.logs.values())
    for name, log in run.logs.items():
        file = run.files[name]
        yield SavedLog(
            name=log.name if stem_counts[log.name] == 1 else name,
            file=_file(name, file),
            sha256=sha256(file),
            roles=tuple(role for role, names in names_by_role.items() if name in names),
            rows=len(log.t),
            duration=float(log.t[-1] - log.t[0]),
            rate=float(1.0 / np.median(np.diff(log.t))),
            trace=traces.get(name, ""),
            sample=is_sample(file),
        )


def record_files(folder: Path, results: Path | None = None) -> None:
    """Write the hashes of all files of a folder to its `run.json`, an updated one of `results`."""
    saved_run = read_json((results or folder) / RUN)
    hashes = {
        file.relative_to(folder).as_posix(): sha256(file)
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file != folder / RUN
    }
    saved_run["written"] = {**saved_run.get("written", {}), **hashes}
    write_json(folder / RUN, saved_run)


def _file(name: str, file: Path) -> str:
    inside = PurePath(name)
    if file.match(name) and not inside.is_absolute() and ".." not in inside.parts:
        return inside.as_posix()
    return file.name


def _save_torques(folder: Path, run: ScoredRun) -> dict[str, str]:
    logs = run.study.logs
    torques_by_log: dict[str, dict[str, list[Array]]] = {
        name: {} for name in (logs.identification[0], *logs.training)
    }
    for test, names in logs.judged.items():
        first_log_torques = {}
        for law_name, law_torques in run.predictions[test].items():
            first_log_torques[law_name] = [joint_torques[0] for joint_torques in law_torques]
        torques_by_log[names[0]] = first_log_torques
    traces = {}
    for k, (name, predicted) in enumerate(torques_by_log.items(), start=1):
        traces[name] = f"torques_{k}.npz"
        write_torques(folder / traces[name], run.records[name][0], predicted)
    return traces


def write_torques(
    path: Path, log_records: Sequence[FrictionRecord], predicted: Mapping[str, Sequence[Array]]
) -> None:
    """Write the torques [N.m] of one log as arrays: measured, rigid body, and every law.

    Columns are t, and for joint k of 1..n q{k}, dq{k}, tau{k}, tau_rb{k} and {law}.tau_f{k}; of a
    cylinder also tau_load{k}.
    """
    rows = slice(0, MAX_TRACE_ROWS)
    columns: dict[str, Array] = {"t": log_records[0].t[rows] - log_records[0].t[0]}
    for k, record in enumerate(log_records, start=1):
        columns |= {
            f"q{k}": record.q[rows],
            f"dq{k}": record.dq[rows],
            f"tau{k}": record.measured[rows],
            f"tau_rb{k}": record.of_bodies[rows],
        }
        if record.tau_body is not None:
            columns[f"tau_load{k}"] = record.tau_load[rows]
        for law_name, torques in predicted.items():
            columns[f"{law_name}.tau_f{k}"] = torques[k - 1][rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    # Single precision exceeds the resolution of any figure.
    write_table(path, {name: values.astype(np.float32) for name, values in columns.items()})


def read_torques(path: Path) -> dict[str, Array]:
    """Read the columns (N,) of `write_torques`; older results have Parquet files."""
    table = load_table(path) if path.suffix == ".npz" else read_table(path)
    return dict(zip(table.names, table.numbers(table.names).T, strict=True))


def write_findings(folder: Path, findings: Sequence[Finding]) -> None:
    """Write findings into a folder of results."""
    saved_findings = to_json(_Findings(findings=tuple(findings)))
    write_json(folder / HEALTH, {"format": HEALTH_FORMAT, **saved_findings})


def read_findings(folder: Path) -> list[Finding]:
    """Read the findings of a run; results of earlier versions have none."""
    path = folder / HEALTH
    if not path.is_file():
        return []
    data = read_json(path, HEALTH_FORMAT)
    return list(from_json(_Findings, data, path, "what checks found").findings)


@dataclass(frozen=True, kw_only=True)
class Spread:
    """A mean over draws and its 95 % interval."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class SeedScores:
    """Errors of laws on one test set over draws, by law, one per joint."""

    rmse: Mapping[str, tuple[Spread, ...]]  # mean [N.m]
    ratios: Mapping[str, tuple[Spread, ...]]  # geometric mean over the reference


@dataclass(frozen=True, kw_only=True)
class Seeds:
    """Scores over draws."""

    seeds: int
    joints: tuple[str, ...]
    reference: str  # reference of the ratios
    tests: Mapping[str, SeedScores]
