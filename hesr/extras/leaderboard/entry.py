"""Evaluation of one entry."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.properties.battery import Subject, measure
from cosim.properties.bench import FrictionBench
from cosim.properties.scale import standing_inertia
from fmu_src.friction.embedded_model import embedded_model
from fmu_src.run.fmu import FmuInstance, is_ours
from fmu_src.run.replay import replay
from hesr.extras.leaderboard.board_file import Ground
from hesr_model.audit.properties import Properties
from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array

_OPTIONAL = ("q", "tau_load")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An FMU with its name and robot."""

    name: str
    fmu: Path
    robot: str


@dataclass(frozen=True, kw_only=True)
class Tried:
    """Evaluation of an entry: `inputs` that change the torque, torques (N, n) [N.m] per part.

    `seconds` are per step; `ours` was exported here and runs in this process.
    """

    entry: Entry
    inputs: tuple[str, ...]
    torques: Sequence[Array]
    seconds: float
    ours: bool
    model: FrictionModel | None
    properties: Properties | None


def tried(entry: Entry, ground: Ground, *, properties: bool) -> Tried:
    """Replay an entry over all logs of its robot."""
    ours = is_ours(entry.fmu) if entry.fmu.is_file() else False
    with FmuInstance(entry.fmu) as component:
        joints = FrictionBench(component).joints
        if joints != ground.model.n:
            raise SimulationError(
                f"{entry.fmu}: is for {joints} joints; the robot '{entry.robot}' has "
                f"{ground.model.n}."
            )
        columns = [_columns(part) for part in ground.records]
        begin = time.perf_counter()
        torques = [replay(component, **part) for part in columns]
        seconds = time.perf_counter() - begin
        steps = sum(len(part) for part in torques)
        used = ["dq"]
        for name in _OPTIONAL:
            without = (replay(component, **part | {name: None}) for part in columns)
            if any(np.any(one != torque) for one, torque in zip(without, torques, strict=True)):
                used.append(name)
    # The torque of a foreign FMU need not be that of its embedded law.
    model = embedded_model(entry.fmu) if ours else None
    found = None
    if properties:
        inertia = standing_inertia(ground.model, ground.body, model) if model else None
        found = measure(Subject(name=entry.name, model=model, fmu=entry.fmu, inertia=inertia))
    return Tried(
        entry=entry,
        inputs=tuple(used),
        torques=torques,
        seconds=seconds / steps,
        ours=ours,
        model=model,
        properties=found,
    )


def _columns(part: Sequence[FrictionRecord]) -> dict[str, Any]:
    names = ("dq", *_OPTIONAL)
    return {"t": part[0].t} | {x: np.column_stack([getattr(r, x) for r in part]) for x in names}
