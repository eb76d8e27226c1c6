"""One robot of a fleet; its logs are read one at a time."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cosim.study.scores import transpose_records
from fmu_src.friction.friction_component import is_exposed
from hesr.extras.fleet.deviation import fit_trend
from hesr.extras.fleet.result import BODY, JointResult, RobotResult
from hesr.extras.fleet.study import FleetStudy, Member
from hesr.extras.ssp.parameter_set import export_ssv
from hesr_model.errors import ArtifactError, FitError, HesrError, LogError
from hesr_model.findings import Finding
from hesr_model.fitting.days import solve_nuisances
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse
from hesr_model.health.examine import check_body, check_laws, examine, merge_findings
from hesr_model.logs.robot_log import Log
from hesr_model.logs.sample import MotionSample
from hesr_model.logs.signals import Motion, smooth
from hesr_model.rigid_body.accumulation import StreamedProblem
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import motion_records, transform_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import sha256
from hesr_model.support.typed_files import from_json, read_json, to_json, write_json

RESULT = "result.json"
RESULT_FORMAT = "hesr-fleet-robot-1"

_VERSIONED_PACKAGES = ("hesr", "numpy", "scipy", "sympy", "pin")


def process_robot(member: Member, study: FleetStudy, folder: Path) -> bool:
    """Process one robot into its folder; return whether it was complete before."""
    key = _compute_key(member, study)
    result_path = folder / RESULT
    with suppress(ArtifactError):  # missing or incomplete
        if read_result(folder).key == key:
            return True
    try:
        with threadpool_limits(1):
            result = _Robot(member, study, key).result(folder)
    except ArtifactError:
        raise  # a full disk is not an error of the robot
    except HesrError as error:
        result = RobotResult(key=key, robot=member.name, type=member.type, failure=str(error))
    # Written last: a killed process repeats this robot.
    write_json(result_path, {"format": RESULT_FORMAT, **to_json(result)})
    return False


def read_result(folder: Path) -> RobotResult:
    """Read the result of a robot; raises ArtifactError if missing or damaged."""
    result_path = folder / RESULT
    return from_json(
        RobotResult, read_json(result_path, RESULT_FORMAT), result_path, "a robot of a fleet"
    )


def _compute_key(member: Member, study: FleetStudy) -> str:
    robot_type = member.robot_type
    files = [robot_type.robot, *(path for _, path in member.logs)]
    if robot_type.robot.is_file():
        files.insert(1, RobotDescription.read(robot_type.robot).model)
    hashed_inputs = {
        "robot": (member.name, member.type, robot_type.accept),
        "names": [name for name, _ in member.logs],
        "files": [_compute_hash(file) for file in files],
        "study": study.model_dump(mode="json", include={"seed", "laws", "options", "rows"}),
        "versions": [version(name) for name in _VERSIONED_PACKAGES],
    }
    return hashlib.sha256(json.dumps(hashed_inputs, sort_keys=True).encode()).hexdigest()


def _compute_hash(file: Path) -> str | None:
    try:
        return sha256(file)
    except OSError:
        return None


@dataclass(frozen=True, kw_only=True)
class _Day:
    rows: int
    rmse: float
    tau_sum: float  # [N.m; N]
    tau_square_sum: float
    level: float
    offset: float


class _Robot:
    def __init__(self, member: Member, study: FleetStudy, key: str) -> None:
        self._member = member
        self._study = study
        self._key = key
        self._robot = Robot(RobotDescription.read(member.robot_type.robot))
        self._label = f"robot '{member.name}'"
        self._refused: dict[str, str] = {}
        self._findings: list[Finding] = []

    def result(self, folder: Path) -> RobotResult:
        member = self._member
        study = self._study
        if not member.logs:
            raise LogError(f"{self._label}: its folders contain no log.")
        stream, sample = self._collect(None)
        if not stream.is_consistent:  # a joint that is always slow
            stream, sample = self._collect(stream.min_speeds)
        body = stream.body(sample, self._label)
        records = transpose_records(
            [motion_records(motion, self._robot, body) for motion in sample]
        )
        provenance = {
            "robot": member.name,
            "fleet": study.name,
            "sample": sum(len(motion.t) for motion in sample),
            **self._robot.description.constants,
        }
        failures: dict[str, FitError] = {}  # of laws that the logs do not determine
        models = fit_models(
            study.laws,
            records,
            robot=member.name,
            seed=study.seed,
            options=study.options,
            provenance=provenance,
            workers=1,
            report_left_out=failures.__setitem__,
        )
        findings = [*check_body(body, self._robot, sample), *check_laws(models, records)]
        for law_name, model in models.items():
            model.write(folder / f"{law_name}.json")
            if all(map(is_exposed, model.laws)):
                export_ssv(model, folder / f"{law_name}.ssv")
        replace(body, provenance=provenance).write(folder / f"{BODY}.json")
        return RobotResult(
            key=self._key,
            robot=member.name,
            type=member.type,
            logs=len(member.logs) - len(self._refused),
            rows=stream.rows,
            refused=(*self._refused.values(), *map(str, failures.values())),
            findings=tuple(merge_findings([*self._findings, *findings])),
            joints=(_summarise_body(body), *self._evaluate_joints(models, body)),
        )

    def _collect(self, slow: Any) -> tuple[StreamedProblem, list[Motion]]:
        stream = StreamedProblem(self._robot, slow)
        sample = MotionSample(self._study.rows, self._study.seed)
        for parts in self._read_motions(check=slow is None):
            for part in parts:
                stream.add(part)
                sample.add(part)
        if not stream.rows:
            first_refusal = next(iter(self._refused.values()))
            raise LogError(
                f"none of its {len(self._refused)} logs can be used, the first: {first_refusal}"
            )
        return stream, sample.motions()

    def _read_motions(self, *, check: bool = False) -> Iterator[list[Motion]]:
        cutoff = self._robot.description.log.filter_cutoff
        for name, path in self._member.logs:
            if name in self._refused:
                continue
            try:
                log = replace(Log.read(path, self._robot.description), name=name)
                if check:
                    self._check(log)
                parts = [smooth(part, cutoff) for part in log.parts()]
            except LogError as error:
                if not check:
                    raise
                self._refused[name] = str(error)
                continue
            yield parts

    def _check(self, log: Log) -> None:
        accept = self._member.robot_type.accept
        findings = examine([log], self._robot.description, self._robot).findings
        reasons = [
            f"{finding.sentence.removesuffix('.')} [{finding.check}]"
            for finding in findings
            if finding.severity == "error" and finding.check not in accept
        ]
        if reasons:
            raise LogError("; ".join(reasons))
        self._findings = merge_findings([*self._findings, *findings])

    def _evaluate_joints(
        self, models: Mapping[str, FrictionModel], body: RigidBody
    ) -> list[JointResult]:
        """Evaluate all laws on each joint and log; the order is that of the laws."""
        bare_body = replace(body, covariance=None)
        days_by_law: dict[tuple[str, int], dict[str, _Day]] = {}
        for parts in self._read_motions():
            log_name = parts[0].name
            records = [
                transform_records(motion_records(part, self._robot, bare_body)) for part in parts
            ]
            for law_name, model in models.items():
                for j, law in enumerate(model.laws):
                    joint_records = [part_records[j] for part_records in records]
                    log_days = days_by_law.setdefault((law_name, j), {})
                    log_days[log_name] = _evaluate_day(law, joint_records)
        day_numbers = self._member.days
        joint_results = []
        for (law_name, j), log_days in days_by_law.items():
            log_day_numbers = [day_numbers[name] for name in log_days]
            joint_results.append(_summarise_joint(models[law_name], j, log_days, log_day_numbers))
        return joint_results


def _evaluate_day(law: FrictionLaw, records: Sequence[FrictionRecord]) -> _Day:
    """Compare the law of a joint with the parts of a log."""
    tau_predicted = np.concatenate([predict_record(law, record) for record in records])
    tau = np.concatenate([record.tau for record in records])
    nuisances = solve_nuisances(tau_predicted, tau, ("level", "offset"))
    return _Day(
        rows=len(tau),
        rmse=rmse(tau_predicted - tau),
        tau_sum=float(tau.sum()),
        tau_square_sum=float(tau @ tau),
        level=nuisances.level,
        offset=nuisances.offset,
    )


def _summarise_joint(
    model: FrictionModel, j: int, days_by_log: Mapping[str, _Day], day_numbers: Sequence[float]
) -> JointResult:
    law = model.laws[j]
    log_days = list(days_by_log.values())
    rows = sum(day.rows for day in log_days)
    mean_rmse = float(np.sqrt(sum(day.rows * day.rmse**2 for day in log_days) / rows))
    mean_tau = sum(day.tau_sum for day in log_days) / rows
    mean_tau_square = sum(day.tau_square_sum for day in log_days) / rows
    # The difference of a constant torque may be below 0 by round-off.
    tau_std = float(np.sqrt(max(mean_tau_square - mean_tau**2, 0.0)))
    scale = tau_std or 1.0
    courses = {
        "level": [day.level for day in log_days],
        "offset": [day.offset / scale for day in log_days],
        "error": [day.rmse / scale for day in log_days],
    }
    trends = {}
    for name, values in courses.items():
        trend = fit_trend(day_numbers, values)
        if trend is not None:
            trends[name] = trend
    return JointResult(
        law=model.law,
        joint=model.joints[j],
        structure=json.dumps(law.structure, sort_keys=True),
        values=law.values,
        errors=law.standard_errors,
        rmse=mean_rmse,
        tau_std=tau_std,
        trends=trends,
    )


def _summarise_body(body: RigidBody) -> JointResult:
    names = [body.names[k] for k in body.base]
    return JointResult(
        law=BODY,
        joint="",
        structure=json.dumps(names),
        values=dict(zip(names, body.parameters[list(body.base)].tolist(), strict=True)),
        errors=dict(zip(names, body.standard_errors.tolist(), strict=True)),
    )
