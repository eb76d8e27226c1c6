"""ROS bags of sensor_msgs/msg/JointState, read without ROS."""

import logging
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import SEEK_END
from pathlib import Path
from struct import pack, unpack
from typing import BinaryIO, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hesr_model.errors import LogError
from hesr_model.logs.parsed_file import ParsedItem, has_module, parse_file
from hesr_model.logs.parsers.ros_bag import JOINT_STATE
from hesr_model.logs.readers.samples import LogSamples, count_unused, find_neighbours
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array
from hesr_model.support.child import INVALID_ANSWER
from hesr_model.support.extras import install_command
from hesr_model.support.files import scratch_folder
from hesr_model.support.ledger import find_close_names, format_suggestion
from hesr_model.support.text import quote

FIELDS = ("position", "velocity", "effort")
"""Fields of a joint state with numbers."""

_SUFFIXES = (".db3", ".mcap", ".bag")
_log = logging.getLogger(__name__)
_MAGIC = b"\x89MCAP0\r\n"
# An empty section "end of data" and a footer without a summary, so that readers scan the records.
_END = pack("<BQI", 0x0F, 4, 0) + pack("<BQQQI", 0x02, 20, 0, 0, 0) + _MAGIC


@contextmanager
def open_complete(path: Path) -> Iterator[Path]:
    """Yield a bag, or a copy of a truncated MCAP file with its complete records."""
    if path.suffix.lower() != ".mcap" or not _is_truncated(path):
        yield path
        return
    with scratch_folder() as folder:
        copy = folder / path.name
        with path.open("rb") as file, copy.open("wb") as copy_file:
            file_size = path.stat().st_size
            outer_end = _find_last_record(file, len(_MAGIC), file_size)
            file.seek(outer_end)
            chunk_head = file.read(9 + 28 + 4 + 8)
            is_uncompressed = (
                len(chunk_head) == 49 and chunk_head[:1] == b"\x06" and not any(chunk_head[37:41])
            )
            inner_start = outer_end + len(chunk_head) if is_uncompressed else outer_end
            inner_end = _find_last_record(file, inner_start, file_size)
            for first_byte, last_byte, target_offset in (
                (0, outer_end, 0),
                (inner_start, inner_end, outer_end),
            ):
                file.seek(first_byte)
                copy_file.seek(target_offset)
                shutil.copyfileobj(file, copy_file)
                copy_file.truncate(target_offset + last_byte - first_byte)
            copy_file.seek(0, SEEK_END)
            copy_file.write(_END)
        lost_bytes = file_size - max(outer_end, inner_end)
        _log.warning(
            "%s: the recording was cut off; its last %d bytes are ignored.", path, lost_bytes
        )
        yield copy


def _is_truncated(path: Path) -> bool:
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return False
        file.seek(-len(_MAGIC), SEEK_END)
        return file.read() != _MAGIC


def _find_last_record(file: BinaryIO, start: int, file_size: int) -> int:
    """Return where the last complete record from `start` on ends."""
    end = start
    while end + 9 <= file_size:
        file.seek(end)
        (length,) = unpack("<xQ", file.read(9))
        if end + 9 + length > file_size:
            break
        end += 9 + length
    return end


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS bag."""
    return path.is_dir() or path.suffix.lower() in _SUFFIXES


def read_bag(path: Path, description: RobotDescription) -> LogSamples:
    """Read the joint states from the topics of a bag; raises LogError.

    Joints that no message lists together are interpolated at the stamps of the slowest one.
    """
    bag = description.log.bag
    joints = bag.joints or description.joints
    where = f"{path}: topic{'s' * (len(bag.topics) > 1)} {', '.join(map(repr, bag.topics))}"
    recording = _read_messages(path, bag.topics)
    messages = recording.messages
    groups = _group_messages(where, joints, messages)
    joint_series = []
    for group_joints, group in groups.items():
        joint_series.append(
            _Series.from_messages(
                where, group_joints, group, allows_missing=description.log.allows_missing
            )
        )
    slowest_series = min(joint_series, key=lambda series: len(series.messages))
    is_covered = [series.covers(slowest_series.t) for series in joint_series]
    rows = np.flatnonzero(np.logical_and.reduce(is_covered))
    if not len(rows):
        raise LogError(
            f"{where}: the messages of the joints do not overlap in time.",
            code="bag.overlap",
            where=where,
        )
    t = slowest_series.t[rows]
    fields = {field: _join_series(joint_series, field, t) for field in FIELDS}
    q, effort = _require_fields(where, fields)
    dq = fields["velocity"] if description.log.columns.dq else None
    if description.log.columns.dq and dq is None:
        _log.warning("%s: has no velocity; it is derived from the position.", where)
    all_joints = _list_joints(messages)
    return LogSamples(
        t=(t - t[0]) * 1e-9,
        q=q,
        dq=dq,
        effort=effort,
        is_current=bag.effort == "current",
        time=where.removeprefix(f"{path}: "),
        place=lambda k: f"message {slowest_series.messages[rows[k]].number}",
        left_out=_count_left_out(messages, groups, joint_series, slowest_series, len(rows)),
        left_over=(
            *recording.other_topics,
            *(joint for joint in all_joints if joint not in joints),
        ),
    )


def _require_fields(where: str, fields: Mapping[str, Array | None]) -> tuple[Array, Array]:
    """Return positions and efforts (N, n); raises LogError if messages lack one."""
    if fields["effort"] is None:
        raise LogError(
            f"{where}: its messages have no effort; record torques or currents as effort.",
            code="bag.effort",
            where=where,
            key="effort",
        )
    if fields["position"] is None:
        raise LogError(
            f"{where}: its messages have no position; positions are needed.",
            code="bag.position",
            where=where,
            key="position",
        )
    return fields["position"], fields["effort"]


class _JointState(NamedTuple):
    name: list[str]
    position: Array
    velocity: Array
    effort: Array


class _Message(NamedTuple):
    number: int  # from 1
    stamp: int  # [ns]
    state: _JointState


class _Recording(NamedTuple):
    messages: list[_Message]
    other_topics: list[str]  # those of joint states first


@dataclass(frozen=True, kw_only=True, eq=False)
class _Series:
    """Fields (N, n) of joints that share messages, at their stamps (N,) [ns] since the first."""

    t: NDArray[np.int64]
    messages: Sequence[_Message]
    values: Mapping[str, Array | None]

    @classmethod
    def from_messages(
        cls,
        where: str,
        joints: Sequence[str],
        messages: Sequence[_Message],
        *,
        allows_missing: bool,
    ) -> Self:
        """Read the fields of joints; raises LogError."""
        stamps = np.array([message.stamp for message in messages])
        if not stamps.any():
            raise LogError(
                f"{where}: its messages have no time stamps (all are 0).",
                code="bag.stamps",
                where=where,
                key="header.stamp",
            )
        return cls(
            t=stamps,
            messages=messages,
            values={
                field: _read_field(where, messages, joints, field, allows_missing=allows_missing)
                for field in FIELDS
            },
        )

    def covers(self, t: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether messages surround times [ns] closely, with at most ten median steps between."""
        stamps = np.sort(self.t)
        after = np.searchsorted(stamps, t)
        before = np.searchsorted(stamps, t, side="right") - 1
        is_inside = (after < len(stamps)) & (before >= 0)
        steps = np.zeros(len(t))
        steps[is_inside] = stamps[after[is_inside]] - stamps[before[is_inside]]
        if len(stamps) < 2:
            return is_inside
        return np.asarray(is_inside & (steps <= 10 * np.median(np.diff(stamps))))

    def interpolate(self, field: str, t: NDArray[np.int64]) -> Array | None:
        """Return a field at times [ns], interpolated where no message has them."""
        values = self.values[field]
        if values is None:
            return None
        if np.array_equal(t, self.t):
            return values
        stamps, rows = np.unique(self.t, return_index=True)
        origin = stamps[0]
        return np.column_stack(
            [np.interp(t - origin, stamps - origin, column) for column in values[rows].T]
        )


def _group_messages(
    where: str, joints: Sequence[str], messages: Sequence[_Message]
) -> dict[tuple[str, ...], Sequence[_Message]]:
    """Return the messages of all joints together, or of each joint; raises LogError."""
    if not messages:
        raise LogError(f"{where}: has no messages.", code="bag.empty", where=where)
    shared_messages = [message for message in messages if set(joints) <= set(message.state.name)]
    if shared_messages:
        return {tuple(joints): shared_messages}
    groups: dict[tuple[str, ...], Sequence[_Message]] = {}
    for joint in joints:
        groups[joint,] = [message for message in messages if joint in message.state.name]
        if not groups[joint,]:
            all_joints = _list_joints(messages)
            suggestion = format_suggestion(find_close_names(joint, all_joints))
            raise LogError(
                f"{where}: has no joint '{joint}'; its messages list {', '.join(all_joints)}; map "
                f"names under 'log.bag.joints' of the robot file{'; ' if suggestion else ''}"
                f"{suggestion.removesuffix('?')}.",
                code="bag.joint",
                where=where,
                key="log.bag.joints",
            )
    return groups


def _list_joints(messages: Sequence[_Message]) -> list[str]:
    joints: dict[str, None] = {}
    for message in messages:
        joints |= dict.fromkeys(message.state.name)
    return list(joints)


def _count_left_out(
    messages: Sequence[_Message],
    groups: Mapping[tuple[str, ...], Sequence[_Message]],
    joint_series: Sequence[_Series],
    slowest_series: _Series,
    row_count: int,
) -> dict[str, int]:
    """Return the numbers of messages of the joints that give no row, by cause."""
    left_out: dict[str, int] = {}
    if len(groups) == 1:
        ((joints, shared_messages),) = groups.items()
        listing = [
            message for message in messages if not set(joints).isdisjoint(message.state.name)
        ]
        left_out["list only some of the joints"] = len(listing) - len(shared_messages)
    uncovered_count = len(slowest_series.t) - row_count
    left_out["have no messages of the other joints near them"] = uncovered_count
    for series in joint_series:
        everything = np.ones(len(series.t), dtype=bool)
        is_used = find_neighbours(series.t, everything, slowest_series.t)
        for cause, count in count_unused(series.t, is_used, slowest_series.t).items():
            cause = f"{cause} messages of other joints"
            left_out[cause] = max(left_out.get(cause, 0), count)
    return {cause: count for cause, count in left_out.items() if count}


def _join_series(joint_series: Sequence[_Series], field: str, t: NDArray[np.int64]) -> Array | None:
    """Return a field of all joints at times [ns], or None if some joints lack it."""
    columns = [series.interpolate(field, t) for series in joint_series]
    known_columns = [column for column in columns if column is not None]
    return np.column_stack(known_columns) if len(known_columns) == len(columns) else None


def _require_plain_files(path: Path) -> None:
    """Refuse links and pipes, which the reader would follow or wait for; raises LogError."""
    for file in path.rglob("*"):  # it does not enter linked folders
        if file.is_symlink() or not (file.is_file() or file.is_dir()):
            name = file.relative_to(path).as_posix()
            raise LogError(
                f"{path}: {quote(name)} is a link, a pipe or a device; a bag has plain files.",
                code="log.other_file",
                where=path,
                key=name,
            )


def _read_messages(path: Path, topics: Sequence[str]) -> _Recording:
    if not (path.is_file() or path.is_dir()):  # a pipe may have no end
        raise LogError(f"{path}: no such log file.", code="file.missing", where=path)
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise LogError(
            f"{path}: a folder without 'metadata.yaml' is not a ROS bag; give a file or a "
            "bag's folder.",
            code="bag.folder",
            where=path,
        )
    if path.is_dir():
        _require_plain_files(path)
    if not has_module("rosbags.highlevel"):
        raise LogError(
            f"{path}: reading a ROS bag needs the package rosbags: {install_command('ros')}.",
            code="log.package",
            where=path,
        )
    with open_complete(path) as complete_path:
        options = {"shown": str(path), "topics": list(topics)}
        items = parse_file(
            complete_path, "a ROS bag", "ros_bag:parse", ["rosbags.highlevel"], options
        )
        recording = _Recording([], [])
        for item in items:
            try:
                if not item.columns:
                    recording.other_topics.extend(_list_other_topics(item, topics))
                    continue
                messages = _list_messages(item, len(recording.messages))
                recording.messages.extend(messages)
            except (KeyError, ValueError, IndexError, TypeError) as error:
                raise LogError(
                    f"{path}: cannot be read as a ROS bag (its reader {INVALID_ANSWER}).",
                    code="file.unreadable",
                    where=path,
                ) from error
    return recording


def _list_other_topics(item: ParsedItem, topics: Sequence[str]) -> list[str]:
    """Return the topics that are not read, those of joint states first; ValueError if invalid."""
    others = [(kind, topic) for topic, kind in item.names if topic not in topics]
    return [topic for _, topic in sorted(others, key=lambda pair: pair[0] != JOINT_STATE)]


def _list_messages(item: ParsedItem, number: int) -> Iterator[_Message]:
    """Yield the messages of an item after a `number` of others; ValueError for an invalid one."""
    arrays = item.arrays
    stamps = arrays["stamp"].tolist()
    name_lists = arrays["names"].tolist()
    fields: dict[str, list[Array]] = {}
    for field in FIELDS:
        counts = arrays[f"{field}_count"]
        if len(counts) != len(stamps) or np.any(counts < 0) or counts.sum() != arrays[field].size:
            raise ValueError("lengths differ")
        fields[field] = np.split(arrays[field], np.cumsum(counts)[:-1])
    for k, (stamp, names) in enumerate(zip(stamps, name_lists, strict=True)):
        state = _JointState(item.names[names], *(fields[field][k] for field in FIELDS))
        yield _Message(number + k + 1, int(stamp), state)


def _read_field(
    where: str,
    messages: Sequence[_Message],
    joints: Sequence[str],
    field: str,
    *,
    allows_missing: bool,
) -> Array | None:
    """Return one field of all joints (N, n), if any message has it."""
    if not any(len(getattr(message.state, field)) for message in messages):
        return None
    values = np.empty((len(messages), len(joints)))
    for row, message in zip(values, messages, strict=True):
        names = message.state.name
        entries = getattr(message.state, field)
        if len(entries) != len(names):
            raise LogError(
                f"{where}, message {message.number}: {field} has {len(entries)} entries for "
                f"{len(names)} joints.",
                code="bag.entries",
                where=where,
                key=field,
            )
        row[:] = [entries[names.index(joint)] for joint in joints]
    is_bad = np.isinf(values)
    if not allows_missing:
        is_bad |= np.isnan(values)
    if np.any(is_bad):
        k, joint = np.argwhere(is_bad)[0]
        raise LogError(
            f"{where}, message {messages[k].number}: {field} of joint '{joints[joint]}' is "
            f"{values[k, joint]:g}; a finite number is needed.",
            code="log.finite",
            where=where,
            key=field,
        )
    return values
