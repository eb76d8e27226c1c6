"""ROS bags of joint states.

The library makes Python code of the definitions in a bag, and opens the files that its metadata
name.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.parsers.items import build_item
from hesr_model.support.child_main import Item
from hesr_model.support.text import on_one_line

JOINT_STATE = "sensor_msgs/msg/JointState"
_BATCH_MESSAGES = 50_000  # of an item
_FIELDS = ("position", "velocity", "effort")


def parse(path: Path, *, shown: str, topics: Sequence[str]) -> Iterator[Item]:
    """Yield the joint states of topics in order; raises LogError that names the path `shown`."""
    from rosbags.highlevel import AnyReader  # slow to import, and optional
    from rosbags.typesys import Stores, get_typestore

    try:
        # bags older than ROS 2 Iron lack definitions
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            # A first item without messages lists the topics.
            topic_types = {(c.topic, c.msgtype) for c in reader.connections}
            yield build_item([], names=sorted(map(list, topic_types)))
            connections: list[Any] = []
            for topic in topics:
                connections += _find_connections(shown, reader, topic)
            states = (
                reader.deserialize(raw, connection.msgtype)
                for connection, _, raw in reader.messages(connections)
            )
            while batch := list(islice(states, _BATCH_MESSAGES)):
                yield _build_item(batch)
    except LogError:
        raise
    except Exception as error:  # many kinds
        raise LogError(
            f"{shown}: cannot be read as a ROS bag ({on_one_line(error)}).",
            code="file.unreadable",
            where=shown,
        ) from error


def _build_item(states: Sequence[Any]) -> Item:
    """Return stamps [ns], the indices of lists of names, and numbers one after another."""
    stamps = [state.header.stamp for state in states]
    name_lists: dict[tuple[str, ...], int] = {}
    names = [name_lists.setdefault(tuple(state.name), len(name_lists)) for state in states]
    columns = [
        ("stamp", np.array([stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps])),
        ("names", np.array(names)),
    ]
    for field in _FIELDS:
        values = [np.asarray(getattr(state, field), dtype=float) for state in states]
        columns.append((f"{field}_count", np.array([len(numbers) for numbers in values])))
        columns.append((field, np.concatenate(values)))
    return build_item(columns, names=[list(names) for names in name_lists])


def _find_connections(path: str, reader: Any, topic: str) -> list[Any]:
    connections = [c for c in reader.connections if c.topic == topic]
    if not connections:
        states = sorted({c.topic for c in reader.connections if c.msgtype == JOINT_STATE})
        topic_list = f"none is {JOINT_STATE}"
        if states:
            topic_list = f"topics of joint states are {', '.join(states)}"
        raise LogError(
            f"{path}: has no topic '{topic}'; {topic_list}; name one under 'log.bag.topic' of the "
            "robot file.",
            code="bag.topic",
            where=path,
            key="log.bag.topic",
        )
    for connection in connections:
        if connection.msgtype != JOINT_STATE:
            raise LogError(
                f"{path}: topic '{topic}' has messages {connection.msgtype}; expected "
                f"{JOINT_STATE}.",
                code="bag.type",
                where=path,
                key="log.bag.topic",
            )
    return connections
