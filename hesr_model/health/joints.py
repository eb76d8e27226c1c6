"""Joints of a robot that logs contain, and joints that rest in them."""

import re
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError, RobotError
from hesr_model.health.evidence import LEAST_TRAVEL, Motionwise
from hesr_model.logs.guess import guess
from hesr_model.logs.log_format import column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.robots.description import RobotDescription
from hesr_model.robots.model_file import arm, joints_of, locked
from hesr_model.robots.robot import RobotLike, description_of, description_of_model


def is_model(robot: RobotLike) -> bool:
    """Return whether a robot is the path of a model file."""
    return isinstance(robot, str | PathLike) and Path(robot).suffix.lower() != ".toml"


def with_joints(
    robot: RobotLike, joints: Sequence[str], table: LogTable | None = None
) -> RobotDescription:
    """Return a robot with these joints, by default its own; a table may have columns of others."""
    description = description_of(robot)
    if joints and is_model(robot) and not (table and _positions(table) == len(description.joints)):
        return description_of_model(description.model, joints)
    for name in joints:
        if name not in description.joints:
            raise RobotError(
                f"robot '{description.name}' has no joint '{name}'; it has "
                f"{', '.join(description.joints)}."
            )
    others = set(description.joints) - set(joints or description.joints)
    rest = locked(joints_of(description.model), joints) if others else {}
    return without(description, {name: rest[name] for name in others}) if others else description


def select_joints_of_table(
    description: RobotDescription, table: LogTable
) -> tuple[RobotDescription, str]:
    """Return a robot with the joints that a table has, and how they were recognised."""
    edges = r"(?<![A-Za-z0-9]){}(?![A-Za-z0-9])"
    text = "\n".join(table.names)
    named = [name for name in description.joints if re.search(edges.format(re.escape(name)), text)]
    if named and len(named) < len(description.joints):
        return description_of_model(description.model, named), "named in the columns"
    own = [joint.name for joint in arm(description.model)]
    if len(own) == _positions(table) < len(description.joints):
        return description_of_model(description.model, own), f"the log has {len(own)} positions"
    return description, ""


def _positions(table: LogTable) -> int:
    try:
        return len(guess(table).columns["q"])
    except LogError:
        return 0


def chosen(robot: RobotLike, joints: Sequence[str]) -> tuple[RobotDescription, str]:
    """Return a robot to inspect without logs, and why joints of a model file are locked."""
    if joints or not is_model(robot):
        return with_joints(robot, joints), ""
    path = description_of(robot).model
    description = description_of_model(path, [joint.name for joint in arm(path)])
    return description, "fingers and joints outside the longest chain are locked" * bool(
        description.locked
    )


def resting(description: RobotDescription, parts: Sequence[Motionwise]) -> dict[str, float]:
    """Return the positions [rad or m] of joints that stay at one place in all parts."""
    if not parts or description.transmission:
        return {}
    q = np.concatenate([part.q for part in parts])
    rests = np.ptp(q, axis=0) <= LEAST_TRAVEL
    places = np.median(q, axis=0)
    found = {description.joints[j]: float(f"{places[j]:.4g}") for j in np.flatnonzero(rests)}
    return found if len(found) < len(description.joints) else {}


def changed(description: RobotDescription, changes: Mapping[str, Any]) -> RobotDescription:
    """Return a description with new values for keys as ``log.units.q``."""
    data = description.model_dump()
    for key, value in changes.items():
        place = data
        *path, last = key.split(".")
        for part in path:
            place = place[part]
        place[last] = value
    return RobotDescription.model_validate(data)


def without(
    description: RobotDescription, rest: Mapping[str, float], *, temperatures: bool = False
) -> RobotDescription:
    """Return a description without the joints that `rest` locks [rad or m], and their columns."""
    if description.transmission:
        raise RobotError(
            f"robot '{description.name}' has a [transmission], whose motors turn joints that "
            "would be "
            "locked; remove these joints from its 'joints' and from the matrix."
        )
    kept = [k for k, joint in enumerate(description.joints) if joint not in rest]
    lists = {**description.lists, "joints": description.joints}
    known = description.known and tuple(
        k for k in description.known if k.rpartition(".")[0] not in rest
    )
    springs = {
        key: tuple(joint for joint in getattr(description, key) if joint not in rest)
        for key in ("springs", "balancers")
    }
    for key in ["q", "dq", "q_link", "tau", "current", *(["temperature"] if temperatures else [])]:
        pattern = getattr(description.log.columns, key)
        if pattern and "{name}" not in pattern:
            lists[f"log.columns.{key}"] = tuple(column_names(pattern, description.joints))
    changes = {
        key: tuple(entries[k] for k in kept)
        for key, entries in lists.items()
        if isinstance(entries, tuple)
    }
    changes |= springs
    return changed(
        description, {**changes, "known": known, "locked": {**description.locked, **rest}}
    )
