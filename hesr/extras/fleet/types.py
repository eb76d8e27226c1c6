"""One FMU per type, with a parameter set (SSP 1.0) for each robot."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fmu_src import export_fmu
from fmu_src.friction.friction_component import exposed
from hesr.extras.fleet.result import RobotResult
from hesr.extras.fleet.study import FleetStudy
from hesr_model.friction.model import FrictionModel
from hesr_model.support.progress import Stages

ROBOTS, TYPES = "robots", "types"
"""Folders of the robots, one each, and of the FMUs."""


class _Kind(NamedTuple):
    type: str
    law: str
    structure: str


def write_types(
    study: FleetStudy, robots: Sequence[RobotResult], output: Path, progress: Stages
) -> dict[tuple[str, str, str], Path]:
    """Write FMUs with the median coefficients of a type, by (type, law, structure).

    Rarer structures of a type are numbered.
    """
    groups: dict[_Kind, list[RobotResult]] = {}
    for robot in robots:
        for law in robot.laws:
            groups.setdefault(_Kind(robot.type, law, robot.structure(law)), []).append(robot)
    numbers: Counter[tuple[str, str]] = Counter()
    fmus: dict[tuple[str, str, str], Path] = {}
    for done, kind in enumerate(sorted(groups, key=lambda k: (-len(groups[k]), k))):
        progress("FMUs of the types", done, len(groups))
        of = groups[kind]
        typical = _typical(kind, of, output)
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
