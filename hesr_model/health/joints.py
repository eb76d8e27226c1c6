"""Joints of a robot that logs contain, and joints that rest in them."""

import re
from collections.abc import Collection, Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from hesr_model.errors import LogError, RobotError
from hesr_model.health.evidence import SmoothPart
from hesr_model.logs.guess import guess_columns
from hesr_model.logs.log_format import column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.rest import find_travelling
from hesr_model.robots.description import RobotDescription
from hesr_model.robots.model_file import find_arm, find_rest_positions, read_joints
from hesr_model.robots.robot import (
    RobotLike,
    describe_model,
    find_robot_file,
    to_description,
)


def is_model_path(robot: RobotLike) -> bool:
    """Return whether a robot is the path of a model file."""
    return isinstance(robot, str | PathLike) and find_robot_file(robot).suffix.lower() != ".toml"


def select_joints(
    robot: RobotLike, joints: Sequence[str], table: LogTable | None = None
) -> RobotDescription:
    """Return a robot with these joints, by default its own; a table may have columns of others."""
    description = to_description(robot)
    if joints and is_model_path(robot) and not _has_all_joints(table, description):
        return describe_model(description.model, joints)
    for joint in joints:
        if joint not in description.joints:
            raise RobotError(
                f"robot '{description.name}' has no joint '{joint}'; it has "
                f"{', '.join(description.joints)}."
            )
    removed_joints = set(description.joints) - set(joints or description.joints)
    if not removed_joints:
        return description
    rest_positions = find_rest_positions(read_joints(description.model), joints)
    return remove_joints(description, {joint: rest_positions[joint] for joint in removed_joints})


def _has_all_joints(table: LogTable | None, description: RobotDescription) -> bool:
    """Return whether a table has a position for each joint of a robot."""
    if not table:
        return False
    return _count_positions(table) == len(description.joints)


def select_joints_of_table(
    description: RobotDescription, table: LogTable
) -> tuple[RobotDescription, str]:
    """Return a robot with the joints that a table has, and how they were recognised."""
    name_pattern = r"(?<![A-Za-z0-9]){}(?![A-Za-z0-9])"
    text = "\n".join(table.names)
    named_joints = [
        joint
        for joint in description.joints
        if re.search(name_pattern.format(re.escape(joint)), text)
    ]
    if named_joints and len(named_joints) < len(description.joints):
        return describe_model(description.model, named_joints), "named in the columns"
    arm_joints = [joint.name for joint in find_arm(description.model)]
    if len(arm_joints) == _count_positions(table) < len(description.joints):
        reason = f"the log has {len(arm_joints)} positions"
        return describe_model(description.model, arm_joints), reason
    return description, ""


def _count_positions(table: LogTable) -> int:
    try:
        return guess_columns(table).joint_count
    except LogError:
        return 0


def choose_joints(robot: RobotLike, joints: Sequence[str]) -> tuple[RobotDescription, str]:
    """Return a robot to inspect without logs, and why joints of a model file are locked."""
    if joints or not is_model_path(robot):
        return select_joints(robot, joints), ""
    model_path = to_description(robot).model
    description = describe_model(model_path, [joint.name for joint in find_arm(model_path)])
    reason = ""
    if description.locked:
        reason = "fingers and joints outside the longest chain are locked"
    return description, reason


def find_resting_joints(
    description: RobotDescription, parts: Sequence[SmoothPart]
) -> dict[str, float]:
    """Return the positions [rad or m] of joints that stay at one place in all parts."""
    if not parts or description.transmission:
        return {}
    q = np.concatenate([part.q for part in parts])
    is_resting = ~find_travelling([np.concatenate([part.log.q for part in parts])])
    positions = np.median(q, axis=0)
    resting_positions = {
        description.joints[j]: float(f"{positions[j]:.4g}") for j in np.flatnonzero(is_resting)
    }
    if len(resting_positions) == len(description.joints):
        return {}  # a log at rest says nothing
    return resting_positions


def apply_changes(description: RobotDescription, changes: Mapping[str, Any]) -> RobotDescription:
    """Return a description with new values for keys as ``log.units.q``."""
    document = description.model_dump()
    for key, value in changes.items():
        table = document
        *table_names, last_name = key.split(".")
        for table_name in table_names:
            table = table[table_name]
        table[last_name] = value
    return RobotDescription.model_validate(document)


def remove_joints(
    description: RobotDescription, locked: Mapping[str, float], optional: Collection[str] = ()
) -> RobotDescription:
    """Return a description without the joints that `locked` locks [rad or m], and their columns.

    `optional` are the quantities that logs may lack and these have.
    """
    if description.transmission:
        raise RobotError(
            f"robot '{description.name}' has a [transmission], whose motors turn joints that "
            "would be locked; remove these joints from its 'joints' and from the matrix."
        )
    entries_by_key = {**description.lists, "joints": description.joints}
    for key in ("q", "dq", "q_link", "tau", "current", "current_size", *optional):
        pattern = getattr(description.log.columns, key)
        if pattern and "{name}" not in pattern:
            entries_by_key[f"log.columns.{key}"] = tuple(column_names(pattern, description.joints))
    changes: dict[str, Any] = {}
    for key, entries in entries_by_key.items():
        if isinstance(entries, tuple):
            changes[key] = _select_entries(entries, description.joints, locked)
    for key in ("springs", "balancers"):
        changes[key] = _remove_names(getattr(description, key), locked)
    if description.known is not None:
        changes["known"] = _remove_parameters(description.known, locked)
    changes["locked"] = {**description.locked, **locked}
    changes["scale.inertia_added"] = {
        log: _remove_keys(inertias, locked)
        for log, inertias in description.scale.inertia_added.items()
    }
    return apply_changes(description, changes)


def _select_entries(
    entries: Sequence[Any], joints: Sequence[str], locked: Collection[str]
) -> tuple[Any, ...]:
    """Return the entries by joint of those that are not locked."""
    return tuple(entries[j] for j, joint in enumerate(joints) if joint not in locked)


def _remove_names(joints: Sequence[str], locked: Collection[str]) -> tuple[str, ...]:
    return tuple(joint for joint in joints if joint not in locked)


def _remove_parameters(parameters: Sequence[str], locked: Collection[str]) -> tuple[str, ...]:
    """Return names as ``joint.parameter`` without those of locked joints."""
    return tuple(name for name in parameters if name.rpartition(".")[0] not in locked)


def _remove_keys(values: Mapping[str, float], locked: Collection[str]) -> dict[str, float]:
    return {joint: value for joint, value in values.items() if joint not in locked}
