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
from fmu_src.friction.friction_component import exposed
from hesr.extras.adaptive.monitor import POINTS_TO, shared_signs
from hesr.extras.fleet.deviation import ENOUGH, Deviation, deviations
from hesr.extras.fleet.result import (
    BODY,
    Change,
    Deviant,
    FleetResult,
    JointResult,
    RobotResult,
    write_table,
)
from hesr.extras.fleet.robot import look_at, read_result
from hesr.extras.fleet.study import FleetStudy, members
from hesr.extras.sweep.work import taken
from hesr_model.findings import Finding
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.uncertainty import MOST_COEFFICIENTS
from hesr_model.friction.model import FrictionModel
from hesr_model.health.examine import CHECKS, require_known
from hesr_model.inference.comparison import holm
from hesr_model.logs.tables import arrow
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel
from hesr_model.support.files import written_together
from hesr_model.support.progress import Stages, counted, silent

Key = tuple[str, str, str, str]  # robot, law, joint, and name of a number
_KINDS = {"level": "drift", "offset": "shift", "error": "error"}
_POINTS_TO = POINTS_TO | {"error": "play, damage, or a sensor: no friction law explains it"}


def compared(
    robots: Sequence[RobotResult], level: float
) -> tuple[dict[tuple[str, str, str], dict[str, float]], list[Deviant]]:
    """Compare numbers of a type and law structure with at least `ENOUGH` robots.

    Returns z by (robot, law, joint), then by name, and deviants at significance `level` (Holm).
    """
    groups: dict[tuple[str, ...], list[tuple[RobotResult, float, float | None]]] = {}
    for robot in robots:
        for one in robot.joints:
            for name, value in _numbers(one):
                group = (robot.type, one.law, one.joint, one.structure, name)
                groups.setdefault(group, []).append((robot, value, one.errors.get(name)))
    found: dict[Key, tuple[str, Deviation]] = {}
    for (type_, law, joint, _, name), of in groups.items():
        if len(of) >= ENOUGH:
            each = deviations([value for _, value, _ in of], [error for *_, error in of])
            for (robot, *_), apart in zip(of, each, strict=True):
                found[robot.robot, law, joint, name] = type_, apart
    p = holm({key: apart.p for key, (_, apart) in found.items()})
    deviants = []
    z: dict[tuple[str, str, str], dict[str, float]] = {}
    for (name, law, joint, what), (type_, apart) in found.items():
        z.setdefault((name, law, joint), {})[what] = apart.z
        numbers = vars(apart) | {"p": p[name, law, joint, what]}
        if numbers["p"] < level:
            deviants.append(
                Deviant(robot=name, type=type_, law=law, joint=joint, name=what, **numbers)
            )
    return z, sorted(deviants, key=lambda d: (-abs(d.z), d.robot, d.law, d.joint, d.name))


def _numbers(one: JointResult) -> Iterator[tuple[str, float]]:
    if len(one.values) <= MOST_COEFFICIENTS or one.law == BODY:  # except coefficients of networks
        yield from one.values.items()
    if one.law != BODY:
        yield "rmse", one.rmse


def changed(robots: Sequence[RobotResult], level: float, least: float) -> list[Change]:
    """Return changes of at least the share `least` of friction at significance `level` (Holm)."""
    trends = {
        (robot.robot, one.law, one.joint, name): (robot, found)
        for robot in robots
        for one in robot.joints
        for name, found in one.trends.items()
    }
    p = holm({key: found.p for key, (_, found) in trends.items()})
    counting = {
        key: (robot, found)
        for key, (robot, found) in trends.items()
        if p[key] < level and abs(found.change) >= least
    }
    drifts: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for (name, law, joint, what), (_, found) in counting.items():
        if what == "level":
            drifts.setdefault((name, law), []).append((joint, _sign(found.change)))
    changes = []
    for key, (robot, found) in counting.items():
        name, law, joint, what = key
        kind = _KINDS[what]
        joints = sum(one.law == law for one in robot.joints)
        if kind == "drift" and _sign(found.change) in shared_signs(drifts[name, law], joints):
            kind = "shared drift"
        changes.append(
            Change(
                robot=name,
                type=robot.type,
                law=law,
                joint=joint,
                kind=kind,
                change=found.change,
                per_day=found.slope,
                p=p[key],
                worse=what == "offset" or found.change > 0.0,
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
ROBOTS = "robots"
TYPES = "types"  # folders of the robots, one each, and of the FMUs


def run_fleet(
    path: Path, output: Path, *, workers: int | None = None, progress: Stages = silent
) -> FleetResult:
    """Process incomplete robots, compare all, and write the results; 1 worker is this process."""
    study = FleetStudy.read(path)
    for law in study.laws:
        estimator(law)
    for robot in dict.fromkeys(kind.robot for kind in study.types.values()):
        Robot(RobotDescription.read(robot))
    for kind in study.types.values():
        require_known(kind.accept, CHECKS)
    robots = members(study, path)
    arrow()  # before the work
    with taken(output, ROBOTS, ABOUT, {"key": study.name}):
        jobs = [partial(look_at, robot, study, output / ROBOTS / robot.name) for robot in robots]
        names = [robot.name for robot in robots]
        with parallel.results_of(jobs, workers, names=names) as done_before:
            reused = sum(next(done_before) for _ in counted(jobs, partial(progress, study.name)))
        results = tuple(read_result(output / ROBOTS / robot.name) for robot in robots)
        z, deviants = compared(results, study.level)
        found = FleetResult(
            name=study.name,
            robots=results,
            z=z,
            deviants=tuple(deviants),
            changes=tuple(changed(results, study.level, study.least_change)),
            fmus=write_types(study, results, output, progress) if study.fmu else {},
            folder=output,
            reused=0,
            findings=[
                Finding(check="logs", where=one.robot, found=one.sentences[0])
                for one in results
                if one.sentences
            ],
        )
        # The page of a continued run is that of an uninterrupted one.
        with written_together(output / PAGE) as file:
            write_table(file(output / TABLE), found)
            write_answer(found, file(output / PAGE))
    return replace(found, reused=reused, files=(output / PAGE, output / TABLE))


class _Kind(NamedTuple):
    type: str
    law: str
    structure: str


def write_types(
    study: FleetStudy, robots: Sequence[RobotResult], output: Path, progress: Stages
) -> dict[tuple[str, str, str], Path]:
    """Write FMUs with median coefficients by (type, law, structure), rarer structures numbered."""
    groups: dict[_Kind, list[RobotResult]] = {}
    for robot in robots:
        for law in robot.laws:
            groups.setdefault(_Kind(robot.type, law, robot.structure(law)), []).append(robot)
    numbers: Counter[tuple[str, str]] = Counter()
    fmus: dict[tuple[str, str, str], Path] = {}
    for done, kind in enumerate(sorted(groups, key=lambda k: (-len(groups[k]), k))):
        progress("FMUs of the types", done, len(groups))
        typical = _typical(kind, groups[kind], output)
        if not all(map(exposed, typical.laws)):
            continue
        numbers[kind.type, kind.law] += 1
        count = numbers[kind.type, kind.law]
        name = kind.law if count == 1 else f"{kind.law}-{count}"
        fmus[kind] = export_fmu(
            typical, output / TYPES / kind.type / f"{name}.fmu", platforms=study.platforms
        )
    return fmus


def _typical(kind: _Kind, robots: Sequence[RobotResult], output: Path) -> FrictionModel:
    first = FrictionModel.read(output / ROBOTS / robots[0].robot / f"{kind.law}.json")
    laws = []
    for joint, law in enumerate(first.laws):
        of = [robot.of_law(kind.law)[joint].values for robot in robots]
        values = {name: float(np.median([one[name] for one in of])) for name in law.values}
        laws.append(replace(law, values=values, standard_errors={}, covariance=None))
    provenance = {"type": kind.type, "robots": len(robots)}
    return replace(first, robot=kind.type, laws=tuple(laws), provenance=provenance)
