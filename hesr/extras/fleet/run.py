"""Run of a fleet; an interrupted run continues."""

from functools import partial
from pathlib import Path

from hesr.extras.fleet.comparison import changed, compared
from hesr.extras.fleet.parquet import write_table
from hesr.extras.fleet.result import Fleet
from hesr.extras.fleet.robot import look_at, read_result
from hesr.extras.fleet.study import FleetStudy, members
from hesr.extras.fleet.types import ROBOTS, write_types
from hesr.extras.sweep.store import taken
from hesr_model.friction.registry import estimator
from hesr_model.health.examine import CHECKS
from hesr_model.health.findings import require_known
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel
from hesr_model.support.progress import Stages, counted, silent

ABOUT, TABLE, PAGE = "fleet.json", "fleet.parquet", "fleet.html"


def run_fleet(
    path: Path, output: Path, *, workers: int | None = None, progress: Stages = silent
) -> Fleet:
    """Process incomplete robots, compare all, and write the results; 1 worker is this process."""
    study = FleetStudy.read(path)
    for law in study.laws:
        estimator(law)
    for robot in dict.fromkeys(kind.robot for kind in study.types.values()):
        Robot(RobotDescription.read(robot))
    for kind in study.types.values():
        require_known(kind.accept, CHECKS)
    robots = members(study, path)
    with taken(output, ROBOTS, ABOUT, {"key": study.name}):
        jobs = [partial(look_at, robot, study, output / ROBOTS / robot.name) for robot in robots]
        names = [robot.name for robot in robots]
        with parallel.results_of(jobs, workers, names=names) as done_before:
            each = counted(jobs, partial(progress, study.name))
            reused = sum(next(done_before) for _ in each)
        results = tuple(read_result(output / ROBOTS / robot.name) for robot in robots)
        z, deviants = compared(results, study.level)
        found = Fleet(
            name=study.name,
            robots=results,
            z=z,
            deviants=tuple(deviants),
            changes=tuple(changed(results, study.level, study.least_change)),
            fmus=write_types(study, results, output, progress) if study.fmu else {},
            folder=output,
            reused=reused,
        )
        write_table(output / TABLE, found)
        from hesr.extras.fleet.page import write_page  # slow import

        write_page(found, output / PAGE)
    return found
