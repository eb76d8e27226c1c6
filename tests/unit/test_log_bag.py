"""Logs from ROS bags, read without a ROS installation."""

import logging
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import Containing

from hesr_model.errors import LogError
from hesr_model.logs.left_over import IRRELEVANT, report_left_over
from hesr_model.logs.log_format import LogBag, LogColumns, LogFormat, LogUnits
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.files import sha256

N = 50
JOINTS = ("a", "b")
START = 1_700_000_000_123_456_789
"""First time stamp [ns]: as float seconds since 1970 it would be rounded to 0.2 us."""

STEP = 10_000_000
"""Period [ns]."""

pytest.importorskip("rosbags", reason="needs hesr[ros]")


def content() -> dict[str, np.ndarray]:
    position, velocity, effort = np.random.default_rng(3).normal(size=(3, N, 2))
    return {"position": position, "velocity": velocity, "effort": effort}


def message(k: int, names: Sequence[str] = JOINTS, **fields: Any) -> dict[str, Any]:
    """Message k of the topic with all fields of the joints; other fields are zero."""
    known = {name: column for column, name in enumerate(JOINTS)}
    values = {
        field: [series[k, known[name]] if name in known else 0.0 for name in names]
        for field, series in content().items()
    }
    return {"stamp": START + k * STEP, "names": names, **values, **fields}


def messages() -> list[dict[str, Any]]:
    return [message(k) for k in range(N)]


def write(
    folder: Path,
    written: Iterable[dict[str, Any]],
    *,
    storage: str = "SQLITE3",
    topic: str = "/joint_states",
) -> Path:
    """Write a ROS 2 bag with one topic of joint states and one of texts."""
    return write_topics(folder, {topic: written}, storage=storage)


def write_topics(
    folder: Path, topics: Mapping[str, Iterable[dict[str, Any]]], *, storage: str = "SQLITE3"
) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        texts = writer.add_connection("/note", text.__msgtype__, typestore=store)
        writer.write(texts, START, store.serialize_cdr(text(data="hello"), text.__msgtype__))
        kind = "sensor_msgs/msg/JointState"
        for topic, written in topics.items():
            states = writer.add_connection(topic, kind, typestore=store)
            for k, item in enumerate(written):
                raw = store.serialize_cdr(joint_state(store, item), kind)
                # Messages arrive late and unevenly, which must have no effect.
                writer.write(states, START + k * STEP + 3_000_000 + k % 7 * 100_000, raw)
    return folder


def joint_state(store: Any, item: dict[str, Any], **header: Any) -> Any:
    types = store.types
    seconds, nanoseconds = divmod(item["stamp"], 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types["sensor_msgs/msg/JointState"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **header),
        name=list(item["names"]),
        **{field: np.array(item[field], dtype=float) for field in content()},
    )


def robot(
    *,
    bag: LogBag | None = None,
    columns: LogColumns | None = None,
    joints: tuple[str, ...] = JOINTS,
    **more: Any,
) -> RobotDescription:
    log = LogFormat(bag=bag or LogBag(), columns=columns or LogColumns(), **more)
    # No test here opens the model.
    return RobotDescription(name="two", model=Path("two.urdf"), joints=joints, log=log)


def require_content(log: Log) -> None:
    assert log.dq is not None
    np.testing.assert_allclose(log.t, 0.01 * np.arange(N), rtol=1e-15, atol=0)
    np.testing.assert_array_equal(log.q, content()["position"])
    np.testing.assert_array_equal(log.dq, content()["velocity"])
    np.testing.assert_array_equal(log.tau, content()["effort"])


@pytest.mark.parametrize(("storage", "suffix"), [("SQLITE3", ".db3"), ("MCAP", ".mcap")])
def test_a_bag_is_read_from_a_folder_or_a_file(tmp_path: Path, storage: str, suffix: str) -> None:
    folder = write(tmp_path / "run", messages(), storage=storage)
    log = Log.read(folder, robot())
    require_content(log)
    assert (log.name, log.sha256) == ("run", sha256(folder))
    (file,) = folder.glob(f"*{suffix}")
    require_content(Log.read(file, robot()))


def test_an_older_ros_2_bag_without_message_definitions_is_read(tmp_path: Path) -> None:
    import sqlite3

    folder = write(tmp_path / "run", messages())
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    require_content(Log.read(folder, robot()))


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    with Writer(tmp_path / "run.bag") as writer:
        states = writer.add_connection("/joint_states", kind, typestore=store)
        for k, item in enumerate(messages()):
            raw = store.serialize_ros1(joint_state(store, item, seq=k), kind)
            writer.write(states, item["stamp"], raw)
    require_content(Log.read(tmp_path / "run.bag", robot()))


def test_joints_may_be_shuffled_mixed_or_missing_in_messages(tmp_path: Path) -> None:
    orders = (("a", "b"), ("b", "gripper", "a"), ("gripper", "b", "a"))
    mixed = []
    for k in range(N):
        mixed.append(message(k, orders[k % 3]))
        mixed.append(message(k, ("gripper",)))  # from another driver, at the same instant
    require_content(Log.read(write(tmp_path / "run", mixed), robot()))


def test_joints_of_messages_may_have_other_names(tmp_path: Path) -> None:
    bag = LogBag(topic="/arm/states", joints=("b", "a"))
    folder = write(tmp_path / "run", messages(), topic="/arm/states")
    log = Log.read(folder, robot(bag=bag, joints=("first", "second")))
    np.testing.assert_array_equal(log.q, content()["position"][:, ::-1])


def test_keys_that_refusals_print_make_them_go_away(tmp_path: Path) -> None:
    """A bag whose topic or joints have other names: each refusal names the key that maps them."""
    other_topic = write(tmp_path / "topic", messages(), topic="/arm/states")
    other_joints = write(tmp_path / "joints", messages())
    cases = (
        (other_topic, "name one under 'log.bag.", JOINTS, {"topic": "/arm/states"}),
        (other_joints, "map names under 'log.bag.", ("first", "second"), {"joints": JOINTS}),
    )
    for folder, words, joints, bag in cases:
        with pytest.raises(LogError) as refusal:
            Log.read(folder, robot(joints=joints))
        _, found, key = str(refusal.value).partition(words)
        assert found
        assert key.partition("'")[0] in bag
        changed = robot(joints=joints, bag=LogBag(**bag))
        assert len(Log.read(folder, changed).t) == N


def test_joints_may_be_spread_over_topics(tmp_path: Path) -> None:
    """Motors with drivers of their own: b is logged at half the rate and starts later."""
    topics = {"/a": [message(k, ("a",)) for k in range(N)]}
    topics["/b"] = [message(k, ("b",)) for k in range(4, N, 2)]
    bag = LogBag(topic=("/a", "/b"))
    log = Log.read(write_topics(tmp_path / "run", topics), robot(bag=bag))
    np.testing.assert_allclose(log.t, 0.02 * np.arange(N // 2 - 2), rtol=1e-15, atol=1e-15)
    for name, series in content().items():
        of_log = {"position": log.q, "velocity": log.dq, "effort": log.tau}[name]
        np.testing.assert_allclose(of_log, series[4::2], rtol=0, atol=1e-12)


def test_joints_of_one_topic_may_come_in_turns(tmp_path: Path) -> None:
    """Between messages a ramp is interpolated exactly; a gap of b is one of the log."""
    one = {"velocity": [1.0 / STEP * 1e9], "effort": [1.0]}
    turns = [
        {"stamp": START + k * STEP, "names": JOINTS[k % 2 :][:1], "position": [float(k)], **one}
        for k in range(400)
        if k % 2 == 0 or not 100 <= k < 200
    ]
    log = Log.read(write(tmp_path / "run", turns), robot())
    np.testing.assert_allclose(log.q[:, 0], log.q[:, 1], rtol=0, atol=1e-9)
    assert np.diff(log.t).max() == pytest.approx(1.02, abs=0.03)


@pytest.mark.parametrize("lost", [1, 200, 3_000, 6_000])
def test_a_truncated_mcap_is_read_up_to_its_end(
    tmp_path: Path, lost: int, caplog: pytest.LogCaptureFixture
) -> None:
    (file,) = write(tmp_path / "run", messages(), storage="MCAP").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-lost])
    log = Log.read(file, robot())
    rows = len(log.t)
    assert rows == N if lost <= 200 else 10 < rows < N
    np.testing.assert_array_equal(log.q, content()["position"][:rows])
    assert "run.mcap: the recording was cut off" in caplog.text


def test_message_units_are_converted_to_si(tmp_path: Path) -> None:
    units = LogUnits(t="ms", q="deg", dq="deg/s", tau="mN.m")  # t is for tables: stamps are in ns
    log = Log.read(write(tmp_path / "run", messages()), robot(units=units))
    assert log.dq is not None
    np.testing.assert_allclose(log.t, 0.01 * np.arange(N), rtol=1e-15)
    np.testing.assert_allclose(log.q, np.deg2rad(content()["position"]), rtol=1e-15)
    np.testing.assert_allclose(log.dq, np.deg2rad(content()["velocity"]), rtol=1e-15)
    np.testing.assert_allclose(log.tau, 1e-3 * content()["effort"], rtol=1e-15)


def test_effort_may_be_a_current(tmp_path: Path) -> None:
    folder = write(tmp_path / "run", messages())
    bag = LogBag(effort="current")
    gains = (10.0, -4.0)
    log = Log.read(folder, robot(bag=bag, torque_per_ampere=gains))
    np.testing.assert_array_equal(log.tau, content()["effort"] * gains)
    # Gains alone do not turn torques into currents.
    require_content(Log.read(folder, robot(torque_per_ampere=gains)))
    message = r"run: the efforts are currents \(log\.bag\.effort\)"
    with pytest.raises(LogError, match=message):
        Log.read(folder, robot(bag=bag))


def test_missing_velocity_is_derived_and_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write(tmp_path / "run", [message(k, velocity=[]) for k in range(N)])
    with caplog.at_level(logging.WARNING):
        assert Log.read(folder, robot()).dq is None
    assert "topic '/joint_states': has no velocity" in (caplog.text)
    caplog.clear()
    assert Log.read(folder, robot(columns=LogColumns(dq=""))).dq is None
    assert not caplog.text


def replaced(k: int, **fields: Any) -> list[dict[str, Any]]:
    return [message(j, **(fields if j == k else {})) for j in range(N)]


PROBLEMS = [
    ([], r"run: topic '/joint_states': has no messages\.$"),
    (
        [message(k, ("a", "x")) for k in range(N)],
        "'b'; its messages list a, x",
    ),
    (
        [message(k, JOINTS[k // (N // 2) :][:1]) for k in range(N)],
        "topic '/joint_states': the messages",
    ),
    (
        [message(k, stamp=0) for k in range(N)],
        r"time stamps \(all are 0\)",
    ),
    (
        [message(k, effort=[]) for k in range(N)],
        "record torques",
    ),
    (
        [message(k, position=[]) for k in range(N)],
        "positions are needed",
    ),
    (
        replaced(4, effort=[1.0]),
        r"topic '/joint_states', message 5: effort has 1 entries for 2 joints\.$",
    ),
    (
        replaced(4, effort=[1.0, np.nan]),
        "message 5: effort of joint 'b'",
    ),
    (
        replaced(4, velocity=[-np.inf, 1.0]),
        r"message 5: velocity .* is -inf",
    ),
    (
        replaced(4, stamp=START + 3 * STEP),
        r"topic '/joint_states', message 5.* 0\.03 s follows 0\.03 s; \[log\] duplicates = 'first'",
    ),
    (messages()[:1], "run: has 1 rows of data"),
]


@pytest.mark.parametrize(("written", "text"), PROBLEMS)
def test_an_error_names_the_topic_and_the_message(
    tmp_path: Path, written: list[dict[str, Any]], text: str
) -> None:
    folder = write(tmp_path / "run", written)
    with pytest.raises(LogError, match=text):
        Log.read(folder, robot())


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (
            "/states",
            "topic '/states'; topics of joint states",
        ),
        (
            "/note",
            r"run: topic '/note' has messages std_msgs/msg/String; expected "
            r"sensor_msgs/msg/JointState\.$",
        ),
    ],
)
def test_a_wrong_topic_is_named(tmp_path: Path, topic: str, message: str) -> None:
    folder = write(tmp_path / "run", messages())
    with pytest.raises(LogError, match=message):
        Log.read(folder, robot(bag=LogBag(topic=topic)))


@pytest.mark.parametrize("name", ["run.db3", "run.mcap", "run.bag"])
def test_other_files_are_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with pytest.raises(LogError, match=rf"{name}: no such log file\.$"):
        Log.read(path, robot())
    path.write_bytes(bytes(range(256)) * 8)
    with pytest.raises(LogError, match=rf"{name}: cannot be read as a ROS"):
        Log.read(path, robot())
    with pytest.raises(LogError, match=r"folder without 'metadata\.yaml'"):
        Log.read(tmp_path, robot())
    (tmp_path / "metadata.yaml").write_text("nothing: here\n", encoding="utf-8")
    with pytest.raises(LogError, match="read as a ROS bag"):
        Log.read(tmp_path, robot())


def test_without_rosbags_the_install_command_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.mcap").write_bytes(b"anything")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    message = r"run\.mcap: reading a ROS bag needs"
    with pytest.raises(LogError, match=message):
        Log.read(tmp_path / "run.mcap", robot())


def test_topics_and_joints_of_a_bag_are_left_over(tmp_path: Path) -> None:
    states = [message(k, (*JOINTS, "gripper")) for k in range(N)]
    topics = {"/joint_states": states, "/other_states": states, "/tf": states}
    log = Log.read(write_topics(tmp_path / "bag", topics), robot())
    require_content(log)
    assert log.left_over == ("/other_states", "/tf", "/note", "gripper")
    (finding,) = report_left_over(log)
    assert finding.found == Containing("3 items ", "'/other_states', '/note', 'gripper'")


def test_rows_of_a_bag_that_are_left_out_have_causes(tmp_path: Path) -> None:
    states = [message(k, JOINTS[:1] if k in (4, 9, 17) else JOINTS) for k in range(N)]
    log = Log.read(write(tmp_path / "some", states), robot())
    assert log.left_out == {"list only some of the joints": 3}
    # One joint a message: the last 20 rows of the one have none of the other.
    states = [message(k, JOINTS[k % 2 : k % 2 + 1]) for k in range(30)]
    states += [message(k, JOINTS[:1]) for k in range(30, N)]
    log = Log.read(write(tmp_path / "turns", states), robot())
    ((cause, count),) = log.left_out.items()
    assert cause == Containing("after the messages of other joints")
    assert 15 <= count <= 20
    assert log.dropped == count


def test_messages_of_irrelevant_topics_change_nothing(tmp_path: Path) -> None:
    topics = [name for name in IRRELEVANT if name.startswith("/")]
    assert len(topics) > 5
    contents = []
    for shift in (0.0, 1.0):
        others = [{**message(k), "position": [shift, shift]} for k in range(N)]
        written = {"/joint_states": messages(), **dict.fromkeys(topics, others)}
        log = Log.read(write_topics(tmp_path / f"bag{shift:g}", written), robot())
        require_content(log)
        assert set(topics) <= set(log.left_over)
        (finding,) = report_left_over(log)
        contents.append(finding.found)
    assert contents[0] == contents[1] == Containing("1 item ", "'/note'")


def test_messages_of_a_faster_joint_are_counted(tmp_path: Path) -> None:
    states = [message(k, JOINTS[k % 10 == 5 :][:1]) for k in range(N)]
    log = Log.read(write(tmp_path / "bag", states), robot())
    assert len(log.t) == 5
    # Of the nine messages between two of the slower joint, the outer ones are interpolated.
    assert log.left_out == {"lie between the messages of other joints": 28}
