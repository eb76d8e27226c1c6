"""Run of a fleet, which continues after an interrupt, and the comparison of its robots."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.report.result_page import write_answer
from fmu_src import export_fmu
from fmu_src.friction.friction_component import is_exposed
from hesr.extras.adaptive.monitor import POINTS_TO, find_shared_signs
from hesr.extras.fleet.deviation import MIN_SAMPLE_SIZE, Deviation, compute_deviations
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

Key = tuple[str, str, str, str]  # robot, law, joint, and name of a number
_KINDS = {"level": "drift", "offset": "shift", "error": "error"}
_POINTS_TO = POINTS_TO | {"error": "play, damage, or a sensor: no friction law explains it"}


def compare_robots(
    robots: Sequence[RobotResult], level: float
) -> tuple[dict[tuple[str, str, str], dict[str, float]], list[Deviant]]:
    """Compare numbers of a type and law structure with at least `MIN_SAMPLE_SIZE` robots.

    Returns z by (robot, law, joint), then by name, and deviants at significance `level` (Holm).
    """
    groups: dict[tuple[str, ...], list[tuple[RobotResult, float, float | None]]] = {}
    for robot in robots:
        for joint_result in robot.joints:
            for number_name, value in _list_numbers(joint_result):
                group = (
                    robot.type,
                    joint_result.law,
                    joint_result.joint,
                    joint_result.structure,
                    number_name,
                )
                groups.setdefault(group, []).append(
                    (robot, value, joint_result.errors.get(number_name))
                )
    typed_deviations: dict[Key, tuple[str, Deviation]] = {}
    for (type_name, law_name, joint, _, number_name), entries in groups.items():
        if len(entries) >= MIN_SAMPLE_SIZE:
            group_deviations = compute_deviations(
                [value for _, value, _ in entries], [error for *_, error in entries]
            )
            for (robot, *_), deviation in zip(entries, group_deviations, strict=True):
                typed_deviations[robot.robot, law_name, joint, number_name] = (
                    type_name,
                    deviation,
                )
    adjusted_p = adjust_by_holm(
        {key: deviation.p for key, (_, deviation) in typed_deviations.items()}
    )
    deviants = []
    z: dict[tuple[str, str, str], dict[str, float]] = {}
    for (robot_name, law_name, joint, number_name), (
        type_name,
        deviation,
    ) in typed_deviations.items():
        z.setdefault((robot_name, law_name, joint), {})[number_name] = deviation.z
        numbers = vars(deviation) | {"p": adjusted_p[robot_name, law_name, joint, number_name]}
        if numbers["p"] < level:
            deviants.append(
                Deviant(
                    robot=robot_name,
                    type=type_name,
                    law=law_name,
                    joint=joint,
                    name=number_name,
                    **numbers,
                )
            )
    return z, sorted(deviants, key=lambda d: (-abs(d.z), d.robot, d.law, d.joint, d.name))


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
    trends = {
        (robot.robot, joint_result.law, joint_result.joint, number_name): (robot, trend)
        for robot in robots
        for joint_result in robot.joints
        for number_name, trend in joint_result.trends.items()
    }
    adjusted_p = adjust_by_holm({key: trend.p for key, (_, trend) in trends.items()})
    significant = {
        key: (robot, trend)
        for key, (robot, trend) in trends.items()
        if adjusted_p[key] < level and abs(trend.change) >= smallest_share
    }
    drifts: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for (robot_name, law_name, joint, number_name), (_, trend) in significant.items():
        if number_name == "level":
            drifts.setdefault((robot_name, law_name), []).append((joint, _sign(trend.change)))
    changes = []
    for key, (robot, trend) in significant.items():
        robot_name, law_name, joint, number_name = key
        kind = _KINDS[number_name]
        joints = sum(joint_result.law == law_name for joint_result in robot.joints)
        if kind == "drift" and _sign(trend.change) in find_shared_signs(
            drifts[robot_name, law_name], joints
        ):
            kind = "shared drift"
        changes.append(
            Change(
                robot=robot_name,
                type=robot.type,
                law=law_name,
                joint=joint,
                kind=kind,
                change=trend.change,
                per_day=trend.slope,
                p=adjusted_p[key],
                worse=number_name == "offset" or trend.change > 0.0,
                points_to=_POINTS_TO[kind],
            )
        )
    return sorted(
        changes, key=lambda c: (not c.worse, -abs(c.change), c.robot, c.law, c.joint, c.kind)
    )


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
        jobs = [
            partial(process_robot, member, study, output / ROBOTS / member.name)
            for member in members
        ]
        names = [member.name for member in members]
        with parallel.results_of(jobs, workers, names=names) as is_reused:
            reused = sum(
                next(is_reused) for _ in report_progress(jobs, partial(progress, study.name))
            )
        results = tuple(read_result(output / ROBOTS / member.name) for member in members)
        z, deviants = compare_robots(results, study.level)
        fleet = FleetResult(
            name=study.name,
            robots=results,
            z=z,
            deviants=tuple(deviants),
            changes=tuple(find_changes(results, study.level, study.least_change)),
            fmus=write_types(study, results, output, progress) if study.fmu else {},
            folder=output,
            reused=0,
            findings=[
                Finding(check="logs", where=robot_result.robot, found=robot_result.sentences[0])
                for robot_result in results
                if robot_result.sentences
            ],
        )
        # The page of a continued run is that of an uninterrupted one.
        with written_together(output / PAGE) as file:
            write_table(file(output / TABLE), fleet)
            write_answer(fleet, file(output / PAGE))
    return replace(fleet, reused=reused, files=(output / PAGE, output / TABLE))


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
            groups.setdefault(
                _StructureKey(robot.type, law_name, robot.structure(law_name)), []
            ).append(robot)
    numbers: Counter[tuple[str, str]] = Counter()
    fmus: dict[tuple[str, str, str], Path] = {}
    for done, kind in enumerate(sorted(groups, key=lambda kind: (-len(groups[kind]), kind))):
        progress("FMUs of the types", done, len(groups))
        model = _build_typical_model(kind, groups[kind], output)
        if not all(map(is_exposed, model.laws)):
            continue
        numbers[kind.type, kind.law] += 1
        number = numbers[kind.type, kind.law]
        name = kind.law if number == 1 else f"{kind.law}-{number}"
        fmus[kind] = export_fmu(
            model, output / TYPES / kind.type / f"{name}.fmu", platforms=study.platforms
        )
    return fmus


def _build_typical_model(
    group: _StructureKey, robots: Sequence[RobotResult], output: Path
) -> FrictionModel:
    first_model = FrictionModel.read(output / ROBOTS / robots[0].robot / f"{group.law}.json")
    laws = []
    for j, law in enumerate(first_model.laws):
        values_by_robot = [robot.select_law(group.law)[j].values for robot in robots]
        values = {
            name: float(np.median([robot_values[name] for robot_values in values_by_robot]))
            for name in law.values
        }
        laws.append(replace(law, values=values, standard_errors={}, covariance=None))
    provenance = {"type": group.type, "robots": len(robots)}
    return replace(first_model, robot=group.type, laws=tuple(laws), provenance=provenance)
