"""Run of a fleet, which continues after an interrupt, and the comparison of its robots."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.report.result_page import write_answer
from fmu_src import export_fmu
from fmu_src.friction.friction_component import is_exposed
from hesr.extras.adaptive.monitor import POINTS_TO, find_shared_signs
from hesr.extras.fleet.deviation import MIN_SAMPLE_SIZE, Deviation, Trend, compute_deviations
from hesr.extras.fleet.result import (
    BODY,
    Change,
    Deviant,
    FleetResult,
    JointResult,
    RobotResult,
    write_table,
)
from hesr.extras.fleet.robot import process_robot, read_result
from hesr.extras.fleet.study import FleetStudy, find_members
from hesr.extras.sweep.work import lock_folder
from hesr_model.findings import Finding
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.uncertainty import MAX_COEFFICIENTS
from hesr_model.friction.model import FrictionModel
from hesr_model.health.examine import CHECKS, require_known
from hesr_model.inference.comparison import adjust_by_holm
from hesr_model.logs.tables import import_arrow
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel
from hesr_model.support.files import written_together
from hesr_model.support.progress import Stages, report_progress, silent

_KINDS = {"level": "drift", "offset": "shift", "error": "error"}  # of change, by trend
_POINTS_TO = POINTS_TO | {"error": "play, damage, or a sensor: no friction law explains it"}


class NumberKey(NamedTuple):
    """A number of a robot: a coefficient or another result of a law and joint."""

    robot: str
    law: str
    joint: str
    name: str


class _Group(NamedTuple):
    """What numbers have in common that can be compared."""

    type: str
    law: str
    joint: str
    structure: str
    name: str


class _Sample(NamedTuple):
    """A number of a robot with its standard error, None if unknown."""

    robot: str
    value: float
    error: float | None


def compare_robots(
    robots: Sequence[RobotResult], level: float
) -> tuple[dict[tuple[str, str, str], dict[str, float]], list[Deviant]]:
    """Compare numbers of a type and law structure with at least `MIN_SAMPLE_SIZE` robots.

    Returns z by (robot, law, joint), then by name, and deviants at significance `level` (Holm).
    """
    types = {robot.robot: robot.type for robot in robots}
    deviations: dict[NumberKey, Deviation] = {}
    for group, samples in _group_numbers(robots).items():
        if len(samples) < MIN_SAMPLE_SIZE:
            continue
        group_deviations = compute_deviations(
            [sample.value for sample in samples], [sample.error for sample in samples]
        )
        for sample, deviation in zip(samples, group_deviations, strict=True):
            key = NumberKey(sample.robot, group.law, group.joint, group.name)
            deviations[key] = deviation
    adjusted_p = adjust_by_holm({key: deviation.p for key, deviation in deviations.items()})
    deviants = []
    z: dict[tuple[str, str, str], dict[str, float]] = {}
    for key, deviation in deviations.items():
        z.setdefault((key.robot, key.law, key.joint), {})[key.name] = deviation.z
        if adjusted_p[key] < level:
            deviant = Deviant(
                robot=key.robot,
                type=types[key.robot],
                law=key.law,
                joint=key.joint,
                name=key.name,
                value=deviation.value,
                median=deviation.median,
                z=deviation.z,
                p=adjusted_p[key],
            )
            deviants.append(deviant)
    return z, sorted(deviants, key=lambda d: (-abs(d.z), d.robot, d.law, d.joint, d.name))


def _group_numbers(robots: Sequence[RobotResult]) -> dict[_Group, list[_Sample]]:
    """Collect the numbers of robots that can be compared with each other."""
    groups: dict[_Group, list[_Sample]] = {}
    for robot in robots:
        for joint_result in robot.joints:
            law_name = joint_result.law
            structure = joint_result.structure
            for name, value in _list_numbers(joint_result):
                group = _Group(robot.type, law_name, joint_result.joint, structure, name)
                sample = _Sample(robot.robot, value, joint_result.errors.get(name))
                groups.setdefault(group, []).append(sample)
    return groups


def _list_numbers(joint_result: JointResult) -> Iterator[tuple[str, float]]:
    # The coefficients of networks mean nothing one by one.
    if len(joint_result.values) <= MAX_COEFFICIENTS or joint_result.law == BODY:
        yield from joint_result.values.items()
    if joint_result.law != BODY:
        yield "rmse", joint_result.rmse


def find_changes(
    robots: Sequence[RobotResult], level: float, smallest_share: float
) -> list[Change]:
    """Return changes of at least `smallest_share` of friction at significance `level` (Holm)."""
    robots_by_name = {robot.robot: robot for robot in robots}
    trends = _collect_trends(robots)
    adjusted_p = adjust_by_holm({key: trend.p for key, trend in trends.items()})
    significant = {
        key: trend
        for key, trend in trends.items()
        if adjusted_p[key] < level and abs(trend.change) >= smallest_share
    }
    shared_signs = _find_shared_drifts(robots_by_name, significant)
    changes = []
    for key, trend in significant.items():
        kind = _KINDS[key.name]
        if kind == "drift" and _sign(trend.change) in shared_signs[key.robot, key.law]:
            kind = "shared drift"
        change = Change(
            robot=key.robot,
            type=robots_by_name[key.robot].type,
            law=key.law,
            joint=key.joint,
            kind=kind,
            change=trend.change,
            per_day=trend.slope,
            p=adjusted_p[key],
            # An offset is worse in either direction, level and error only if they rise.
            worse=key.name == "offset" or trend.change > 0.0,
            points_to=_POINTS_TO[kind],
        )
        changes.append(change)
    return sorted(
        changes, key=lambda c: (not c.worse, -abs(c.change), c.robot, c.law, c.joint, c.kind)
    )


def _collect_trends(robots: Sequence[RobotResult]) -> dict[NumberKey, Trend]:
    """Return the trends of all robots by the number that has it."""
    trends = {}
    for robot in robots:
        for joint_result in robot.joints:
            for name, trend in joint_result.trends.items():
                key = NumberKey(robot.robot, joint_result.law, joint_result.joint, name)
                trends[key] = trend
    return trends


def _find_shared_drifts(
    robots: Mapping[str, RobotResult], trends: Mapping[NumberKey, Trend]
) -> dict[tuple[str, str], list[int]]:
    """Return the signs of drifts that most joints of a robot share, by (robot, law)."""
    drifts: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for key, trend in trends.items():
        if key.name == "level":
            drifts.setdefault((key.robot, key.law), []).append((key.joint, _sign(trend.change)))
    shared_signs = {}
    for (robot_name, law_name), law_drifts in drifts.items():
        joint_count = len(robots[robot_name].select_law(law_name))
        shared_signs[robot_name, law_name] = find_shared_signs(law_drifts, joint_count)
    return shared_signs


def _sign(number: float) -> int:
    return 1 if number > 0.0 else -1


ABOUT = "fleet.json"
TABLE = "fleet.parquet"
PAGE = "fleet.html"
ROBOTS = "robots"  # folder with a folder of each robot
TYPES = "types"  # folder of the FMUs


def run_fleet(
    path: Path, output: Path, *, workers: int | None = None, progress: Stages = silent
) -> FleetResult:
    """Process incomplete robots, compare all, and write the results; 1 worker is this process."""
    study = FleetStudy.read(path)
    for law_name in study.laws:
        estimator(law_name)
    for robot_path in dict.fromkeys(robot_type.robot for robot_type in study.types.values()):
        Robot(RobotDescription.read(robot_path))
    for robot_type in study.types.values():
        require_known(robot_type.accept, CHECKS)
    members = find_members(study, path)
    import_arrow()  # before the work
    with lock_folder(output, ROBOTS, ABOUT, {"key": study.name}):
        robot_folders = [output / ROBOTS / member.name for member in members]
        jobs = [
            partial(process_robot, member, study, robot_folder)
            for member, robot_folder in zip(members, robot_folders, strict=True)
        ]
        names = [member.name for member in members]
        reused = 0
        with parallel.results_of(jobs, workers, names=names) as is_reused:
            for _ in report_progress(jobs, partial(progress, study.name)):
                reused += next(is_reused)
        results = [read_result(robot_folder) for robot_folder in robot_folders]
        # The page of a continued run is that of an uninterrupted one, with no robot reused.
        fleet = _judge_fleet(study, results, output, progress)
        with written_together(output / PAGE) as file:
            write_table(file(output / TABLE), fleet)
            write_answer(fleet, file(output / PAGE))
    return replace(fleet, reused=reused, files=(output / PAGE, output / TABLE))


def _judge_fleet(
    study: FleetStudy, results: Sequence[RobotResult], output: Path, progress: Stages
) -> FleetResult:
    """Compare the robots with each other and over the days, and write the FMUs of their types."""
    z, deviants = compare_robots(results, study.level)
    changes = find_changes(results, study.level, study.least_change)
    fmus = {}
    if study.fmu:
        fmus = write_types(study, results, output, progress)
    findings = [
        Finding(check="logs", where=robot_result.robot, found=robot_result.sentences[0])
        for robot_result in results
        if robot_result.sentences
    ]
    return FleetResult(
        name=study.name,
        robots=tuple(results),
        z=z,
        deviants=tuple(deviants),
        changes=tuple(changes),
        fmus=fmus,
        folder=output,
        reused=0,
        findings=findings,
    )


class _StructureKey(NamedTuple):
    type: str
    law: str
    structure: str


def write_types(
    study: FleetStudy, robots: Sequence[RobotResult], output: Path, progress: Stages
) -> dict[tuple[str, str, str], Path]:
    """Write FMUs with median coefficients by (type, law, structure), rarer structures numbered."""
    groups: dict[_StructureKey, list[RobotResult]] = {}
    for robot in robots:
        for law_name in robot.laws:
            structure_key = _StructureKey(robot.type, law_name, robot.structure(law_name))
            groups.setdefault(structure_key, []).append(robot)
    numbers: Counter[tuple[str, str]] = Counter()
    fmus: dict[tuple[str, str, str], Path] = {}
    frequent_first = sorted(groups, key=lambda key: (-len(groups[key]), key))
    for done, key in enumerate(frequent_first):
        progress("FMUs of the types", done, len(groups))
        model = _build_typical_model(key, groups[key], output)
        if not all(map(is_exposed, model.laws)):
            continue
        numbers[key.type, key.law] += 1
        number = numbers[key.type, key.law]
        name = key.law
        if number > 1:
            name = f"{key.law}-{number}"
        path = output / TYPES / key.type / f"{name}.fmu"
        fmus[key] = export_fmu(model, path, platforms=study.platforms)
    return fmus


def _build_typical_model(
    group: _StructureKey, robots: Sequence[RobotResult], output: Path
) -> FrictionModel:
    """Return the model of the first robot with the medians of all of its group."""
    first_model = FrictionModel.read(output / ROBOTS / robots[0].robot / f"{group.law}.json")
    laws = []
    for j, law in enumerate(first_model.laws):
        values_by_robot = [robot.select_law(group.law)[j].values for robot in robots]
        medians = {}
        for name in law.values:
            medians[name] = float(np.median([values[name] for values in values_by_robot]))
        laws.append(replace(law, values=medians, standard_errors={}, covariance=None))
    provenance = {"type": group.type, "robots": len(robots)}
    return replace(first_model, robot=group.type, laws=tuple(laws), provenance=provenance)
