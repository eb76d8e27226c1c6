"""Entries evaluated, scored and ranked within classes of inputs."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim.workflow.arguments import telling_apart
from fmu_src.friction.embedded_model import embedded_model
from fmu_src.friction.replay import replay
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.trust import is_ours
from hesr.extras.leaderboard import board_file
from hesr.extras.properties.battery import measure
from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import standing_inertia
from hesr_model.audit.properties import Properties, Subject
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.support import parallel
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256
from hesr_model.support.progress import Progress, counted, silent

FORMAT = "hesr-arena-1"
_OPTIONAL = ("q", "tau_load")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An FMU with its name and robot."""

    name: str
    fmu: Path
    robot: str


@dataclass(frozen=True, kw_only=True)
class Tried:
    """Evaluation of an entry."""

    entry: Entry
    inputs: tuple[str, ...]  # that change the torque
    torques: Sequence[Array]  # (N, n) [N.m] per part
    seconds: float  # per step
    ours: bool  # exported here, so that it runs in this process
    model: FrictionModel | None
    properties: Properties | None


def tried(entry: Entry, ground: board_file.Ground, *, properties: bool) -> Tried:
    """Replay an entry over all logs of its robot."""
    ours = is_ours(entry.fmu) if entry.fmu.is_file() else False
    with FmuInstance(entry.fmu) as instance:
        joints = FrictionBench(instance).joints
        if joints != ground.model.n:
            raise SimulationError(
                f"{entry.fmu}: is for {joints} joints; the robot '{entry.robot}' has "
                f"{ground.model.n}."
            )
        columns: list[dict[str, Any]] = [
            {"t": part[0].t}
            | {
                x: np.column_stack([getattr(record, x) for record in part])
                for x in ("dq", *_OPTIONAL)
            }
            for part in ground.records
        ]
        begin = time.perf_counter()
        torques = [replay(instance, **part) for part in columns]
        seconds = time.perf_counter() - begin
        steps = sum(len(part) for part in torques)
        used = ["dq"]
        for name in _OPTIONAL:
            without = (replay(instance, **part | {name: None}) for part in columns)
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


@dataclass(frozen=True, kw_only=True)
class ScoredLog:
    """A log with its origin and licence."""

    name: str
    robot: str
    sha256: str
    source: str
    licence: str


@dataclass(frozen=True, kw_only=True)
class ScoredRobot:
    """A robot with its friction, standard deviation by joint [N.m; N]."""

    name: str
    joints: tuple[str, ...]
    sliding: tuple[bool, ...]
    tau_std: tuple[float, ...]
    rigid_body: str


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Scores of an entry, with 95 % intervals (simultaneous for `ratio`)."""

    name: str
    robot: str
    sha256: str
    law: str
    group: str
    inputs: tuple[str, ...]
    relative: Mapping[board_file.Kind, board_file.Interval | None]  # error over size of friction
    joints: Mapping[board_file.Kind, tuple[float | None, ...]]  # RMSE [N.m; N]
    ratio: board_file.Interval | None  # to the leader
    leads: bool  # no entry of the class is significantly better
    properties: Properties | None
    step: float | None  # [s]
    foreign: bool  # in a process of its own, which takes longer


@dataclass(frozen=True, kw_only=True)
class Leaderboard:
    """Standings by robot and class, the smallest error first."""

    arena: str
    warm_up: float
    block: float
    classes: Mapping[str, tuple[str, ...]]
    robots: tuple[ScoredRobot, ...]
    logs: tuple[ScoredLog, ...]
    standings: tuple[Standing, ...]


def entries_of(given: Sequence[str], rules: board_file.BoardFile) -> list[Entry]:
    """Return entries given as FILE or ROBOT=FILE."""
    robots = [robot.name for robot in rules.robots]
    found = []
    for text in given:
        robot, equals, file = text.partition("=")
        if not (equals and robot in robots):
            if len(robots) > 1:
                raise ConfigError(
                    f"'{text}': the leaderboard has {len(robots)} robots; give ROBOT=FILE with one "
                    f"of {', '.join(robots)}."
                )
            robot = robots[0]
            file = text
        found.append((robot, Path(file)))
    namings = [[fmu.stem for _, fmu in found], [f"{r}={fmu}" for r, fmu in found]]
    names = telling_apart(namings, "entered")
    return [Entry(name=n, fmu=fmu, robot=r) for n, (r, fmu) in zip(names, found, strict=True)]


def run_leaderboard(
    rules: board_file.BoardFile,
    entries: Sequence[Entry],
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> Leaderboard:
    """Score entries in separate processes; `workers` changes measured times only."""
    if not entries:
        raise ConfigError("the leaderboard has no entries; give at least one FMU.")
    grounds = board_file.read_grounds(rules)
    wanted = "properties" in rules.scores
    jobs = [partial(tried, e, grounds[e.robot], properties=wanted) for e in entries]
    with parallel.results_of(jobs, workers, names=[entry.name for entry in entries]) as results:
        done = [next(results) for _ in counted(jobs, progress)]
    judges = {
        name: board_file.Judge(ground, warm_up=rules.warm_up, block=rules.block)
        for name, ground in grounds.items()
    }
    groups: dict[tuple[str, str], list[Tried]] = {}
    for one in done:
        groups.setdefault((one.entry.robot, _group(rules, one)), []).append(one)
    order = [(robot.name, name) for robot in rules.robots for name in rules.classes]
    return Leaderboard(
        arena=rules.name,
        warm_up=rules.warm_up,
        block=rules.block,
        classes=dict(rules.classes),
        robots=tuple(
            ScoredRobot(
                name=name,
                joints=ground.model.description.joints,
                sliding=ground.model.slides,
                tau_std=tuple(map(float, judges[name].tau_std)),
                rigid_body=ground.body.robot,
            )
            for name, ground in grounds.items()
        ),
        logs=tuple(
            ScoredLog(
                name=log.file.stem,
                robot=log.robot or rules.robots[0].name,
                sha256=log.sha256,
                source=log.source,
                licence=log.licence,
            )
            for log in rules.logs
        ),
        standings=tuple(
            standing
            for key in order
            if key in groups
            for standing in _rank_entries(rules, key[1], groups[key], judges[key[0]])
        ),
    )


def _group(rules: board_file.BoardFile, one: Tried) -> str:
    holding = [n for n, may in rules.classes.items() if set(one.inputs) <= {*may, "dq"}]
    if not holding:
        raise ConfigError(
            f"{one.entry.fmu}: its torque depends on {', '.join(one.inputs)}, which no class "
            f"allows; the classes are {'; '.join(rules.classes)}."
        )
    return min(holding, key=lambda name: len(rules.classes[name]))


def _rank_entries(
    rules: board_file.BoardFile, group: str, members: Sequence[Tried], judge: board_file.Judge
) -> list[Standing]:
    errors = {one.entry.name: judge.errors(one.torques) for one in members}
    size = {
        name: float(np.mean(np.square(np.vstack(of_entry) / judge.tau_std)))
        for name, of_entry in errors.items()
    }
    ranked = sorted(members, key=lambda one: size[one.entry.name])
    leader = ranked[0].entry
    kinds = [kind for kind in board_file.KINDS if kind in rules.scores]
    found = []
    for one in ranked:
        entry = one.entry
        own = errors[one.entry.name]
        ratio = None
        if entry != leader:
            ratio = judge.ratio(own, errors[leader.name], len(members) - 1)
        found.append(
            Standing(
                name=entry.name,
                robot=entry.robot,
                sha256=sha256(entry.fmu),
                law=one.model.law if one.model else "",
                group=group,
                inputs=one.inputs,
                relative={kind: judge.relative(own, kind) for kind in kinds},
                joints={kind: judge.by_joint(own, kind) for kind in kinds},
                ratio=ratio,
                leads=ratio is None or ratio.low <= 1.0,
                properties=one.properties,
                step=one.seconds if "time" in rules.scores else None,
                foreign=not one.ours,
            )
        )
    return found
