"""ROS bags of sensor_msgs/msg/JointState, read without ROS."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.readers.samples import LogSamples
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array

_TYPE = "sensor_msgs/msg/JointState"
_SUFFIXES = (".db3", ".mcap", ".bag")

_log = logging.getLogger(__name__)


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS bag."""
    return path.is_dir() or path.suffix.lower() in _SUFFIXES


def read_bag(path: Path, robot: RobotDescription) -> LogSamples:
    """Read the joint states from one topic of a bag; raises LogError."""
    bag = robot.log.bag
    joints = bag.joints or robot.joints
    messages = list(_messages(path, bag.topic))
    used = [message for message in messages if set(joints) <= set(message.names)]
    where = f"{path}: topic '{bag.topic}'"
    if not used:
        raise _missing_joints(where, joints, messages)
    stamps = [message.stamp for message in used]
    if not any(stamps):
        raise LogError(f"{where}: its messages have no time stamps (all are 0).")
    drop = robot.log.missing == "drop"
    effort = _values(where, used, joints, "effort", missing=drop)
    if effort is None:
        raise LogError(
            f"{where}: its messages have no effort; record torques or currents as effort."
        )
    q = _values(where, used, joints, "position", missing=drop)
    if q is None:
        raise LogError(f"{where}: its messages have no position; positions are needed.")
    dq = None
    if robot.log.columns.dq:
        dq = _values(where, used, joints, "velocity", missing=drop)
        if dq is None:
            _log.warning("%s: has no velocity; it is derived from the position.", where)
    return LogSamples(
        t=np.array([stamp - stamps[0] for stamp in stamps]) * 1e-9,
        q=q,
        dq=dq,
        effort=effort,
        is_current=bag.effort == "current",
        time=f"topic '{bag.topic}'",
        place=lambda k: f"message {used[k].number}",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Message:
    """A message, its number from 1, and its stamp [ns]."""

    number: int
    stamp: int
    names: Sequence[str]
    position: Array
    velocity: Array
    effort: Array


def _messages(path: Path, topic: str) -> Iterator[_Message]:
    if not (path.is_file() or path.is_dir()):  # a pipe may have no end
        raise LogError(f"{path}: no such log file.")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise LogError(
            f"{path}: a folder without 'metadata.yaml' is not a ROS bag; give a file or a "
            "bag's folder."
        )
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise LogError(
            f"{path}: reading a ROS bag needs the package rosbags: pip install 'hesr[ros]'."
        ) from error
    try:
        # bags older than ROS 2 Iron lack definitions
        reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
        with reader:
            connections = _connections(path, reader, topic)
            for number, (connection, _, raw) in enumerate(reader.messages(connections), start=1):
                message: Any = reader.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp
                yield _Message(
                    number=number,
                    stamp=stamp.sec * 1_000_000_000 + stamp.nanosec,
                    names=message.name,
                    position=message.position,
                    velocity=message.velocity,
                    effort=message.effort,
                )
    except LogError:
        raise
    except Exception as error:  # many kinds
        reason = " ".join(str(error).split()).rstrip(".")
        raise LogError(f"{path}: cannot be read as a ROS bag ({reason}).") from error


def _connections(path: Path, reader: Any, topic: str) -> list[Any]:
    connections = [c for c in reader.connections if c.topic == topic]
    if not connections:
        states = sorted({c.topic for c in reader.connections if c.msgtype == _TYPE})
        others = f"topics of joint states are {', '.join(states)}" if states else f"none is {_TYPE}"
        raise LogError(
            f"{path}: has no topic '{topic}'; {others}; name one under 'log.bag.topic' of the "
            "robot file."
        )
    for connection in connections:
        if connection.msgtype != _TYPE:
            raise LogError(
                f"{path}: topic '{topic}' has messages {connection.msgtype}; expected {_TYPE}."
            )
    return connections


def _missing_joints(where: str, joints: Sequence[str], messages: Sequence[_Message]) -> LogError:
    if not messages:
        return LogError(f"{where}: has no messages.")
    listed = dict.fromkeys(name for message in messages for name in message.names)
    for joint in joints:
        if joint not in listed:
            return LogError(
                f"{where}: has no joint '{joint}'; its messages list {', '.join(listed)}; map "
                "names under 'log.bag.joints' of the robot file."
            )
    return LogError(f"{where}: no message lists all of {', '.join(joints)} together.")


def _values(
    where: str, messages: Sequence[_Message], joints: Sequence[str], field: str, *, missing: bool
) -> Array | None:
    """Return one field of all joints (N, n), if any message has it."""
    if not any(len(getattr(message, field)) for message in messages):
        return None
    values = np.empty((len(messages), len(joints)))
    for row, message in zip(values, messages, strict=True):
        given = getattr(message, field)
        if len(given) != len(message.names):
            raise LogError(
                f"{where}, message {message.number}: {field} has {len(given)} entries for "
                f"{len(message.names)} joints."
            )
        row[:] = [given[message.names.index(joint)] for joint in joints]
    bad = np.isinf(values) if missing else ~np.isfinite(values)
    if np.any(bad):
        k, joint = np.argwhere(bad)[0]
        raise LogError(
            f"{where}, message {messages[k].number}: {field} of joint '{joints[joint]}' is "
            f"{values[k, joint]:g}; a finite number is needed."
        )
    return values
