"""Lines that findings print are lines of a robot file, and make their statements go away."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from printed_lines import execute, read_settings, write_line
from remedy_texts import read_texts

from hesr_model import health
from hesr_model.errors import LogError
from hesr_model.health.examine import examine
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import robot_text
from hesr_model.logs import robot_log
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.text import format_settings

Array = np.ndarray
DEGREE = np.pi / 180.0


def scale(values: Array | None, *factors: float) -> Array:
    assert values is not None
    return values * np.array(factors)


def swap(values: Array | None, *order: int) -> Array:
    assert values is not None
    return values[:, list(order)]


# Mistakes whose findings print lines, and the check of one of them.
MISTAKES: dict[str, tuple[Callable[[Log], Log], str]] = {
    "degrees": (lambda log: replace(log, q=log.q / DEGREE), "velocity-scale"),
    "degrees of both": (
        lambda log: replace(log, q=log.q / DEGREE, dq=scale(log.dq, *[1 / DEGREE] * 3)), "limits",
    ),
    "rpm": (lambda log: replace(log, dq=scale(log.dq, *[30 / np.pi] * 3)), "velocity-scale"),
    "rpm of one joint": (
        lambda log: replace(log, dq=scale(log.dq, 1.0, 30 / np.pi, 1.0)), "velocity-scale",
    ),
    "a velocity backwards": (
        lambda log: replace(log, dq=scale(log.dq, 1.0, 1.0, -1.0)), "velocity-sign",
    ),
    "swapped velocities": (
        lambda log: replace(log, dq=swap(log.dq, 0, 2, 1)), "velocity-columns",
    ),
    "no velocity": (lambda log: replace(log, dq=scale(log.dq, 0, 0, 0)), "velocity-constant"),
    "milliseconds": (lambda log: replace(log, t=1e3 * log.t), "time-unit"),
    "half the rate": (lambda log: replace(log, t=2.0 * log.t), "velocity-scale"),
    "a torque backwards": (
        lambda log: replace(log, tau=scale(log.tau, 1.0, -1.0, 1.0)), "torque-sign",
    ),
    "all torques backwards": (
        lambda log: replace(log, tau=-log.tau), "torque-sign",
    ),
    "a position backwards": (
        lambda log: replace(log, q=scale(log.q, 1, -1, 1), dq=scale(log.dq, 1, -1, 1)),
        "position-sign",
    ),
    "swapped torques": (
        lambda log: replace(log, tau=swap(log.tau, 0, 2, 1)), "torque-columns",
    ),
    "millinewtons": (lambda log: replace(log, tau=1e3 * log.tau), "torque-scale"),
    "another order": (
        lambda log: replace(
            log, q=swap(log.q, 2, 0, 1), dq=swap(log.dq, 2, 0, 1), tau=swap(log.tau, 2, 0, 1)
        ), "joint-order",
    ),
    "a zero off by a quarter": (
        lambda log: replace(log, q=log.q + np.array([0.0, 0.5 * np.pi, 0.0])), "zero",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_printed_lines_make_the_statement_go_away(
    mistake: str, make_motion: Callable[..., Motion], arm: RobotDescription, tmp_path: Path
) -> None:
    spoil, check = MISTAKES[mistake]
    motion = make_motion(name="run", friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    log = Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise)
    path = tmp_path / "run.csv"
    spoil(log).write(path)
    robot_path = tmp_path / "robot.toml"
    arm = apply_changes(arm, {"log.sample_rate": None})
    text = robot_text(arm, robot_path, "A robot.")
    robot_path.write_text(text, encoding="utf-8")

    def find() -> dict[tuple[str, str], str]:
        robot = Robot(robot_path)
        findings = examine([Log.read(path, robot)], robot.description, robot).findings
        return {(f.check, joint): f.sentence for f in findings for joint in f.joints or ("",)}

    sentences = find()
    printed = {place: text for place, text in sentences.items() if "; set " in text}
    assert check in {place[0] for place in printed}, sentences
    for place, sentence in printed.items():
        robot_path.write_text(execute(text, sentence), encoding="utf-8")
        assert robot_path.read_text(encoding="utf-8") != text
        assert place not in find(), sentence
        robot_path.write_text(text, encoding="utf-8")


def test_settings_are_lines_of_toml() -> None:
    changes = {
        "log.units.q": ("deg", "it's", 0.5),
        "log.columns.dq": "",
        "gravity": (0.0, 0.0, -9.81),
        "log.sort": True,
    }
    text = format_settings(changes)
    assert text.startswith("[log.units] q = ['deg', \"it's\", 0.5], [log.columns] dq = ''")
    settings = {
        f"{table}.{key}".lstrip("."): value for table, key, value in read_settings(f"; set {text}")
    }
    assert settings["log.units.q"] == ["deg", "it's", 0.5]
    assert settings["gravity"] == [0.0, 0.0, -9.81]


TIMES = 0.01 * np.arange(600)
TURNS = np.sin(2.0 * np.pi * 0.5 * TIMES)


def write_bench(path: Path, robot_lines: str = "", **columns: Array) -> None:
    """Write a log of one joint next to a robot file without its model."""
    signals = {"t": TIMES, "q1": TURNS, "tau1": 0.3 * np.sign(TURNS), **columns}
    if "dq1" not in signals:
        signals["dq1"] = np.gradient(signals["q1"], signals["t"])
    rows = np.column_stack(list(signals.values()))
    np.savetxt(path / "run.csv", rows, "%.9g", ",", header=",".join(signals), comments="")
    robot_text = f'name = "bench"\nmodel = "bench.urdf"\njoints = ["j1"]\n{robot_lines}'
    (path / "robot.toml").write_text(robot_text, encoding="utf-8")


def read_checks(path: Path) -> dict[str, str]:
    """Return the sentences of a log by check, of which a refusal is one by its code."""
    description = RobotDescription.read(path / "robot.toml")
    try:
        log = Log.read(path / "run.csv", description)
    except LogError as refusal:
        return {refusal.code: str(refusal)}
    robot = Robot(description) if description.model.is_file() else None
    return {f.check: f.sentence for f in examine([log], description, robot).findings}


def add_line(path: Path, table: str, key: str, value: str) -> None:
    text = (path / "robot.toml").read_text(encoding="utf-8")
    (path / "robot.toml").write_text(write_line(text, table, key, value), encoding="utf-8")


def count_of_an_encoder(path: Path) -> Iterator[str]:
    """Positions in counts: the sentence names the key of their size."""
    write_bench(path, q1=np.rint(1000.0 * TURNS), dq1=np.gradient(TURNS, TIMES))
    yield (sentence := read_checks(path)["coarse"])
    key, table = re.findall(r"'(\w+)' of \[([\w.]+)\]", sentence)[0]
    add_line(path, table, key, "0.001")
    yield read_checks(path).get("coarse", "")


def repeated_stamps(path: Path) -> Iterator[str]:
    """Rows that repeat a time stamp: the refusal prints the line that leaves them out."""
    rows = np.sort([*range(500), 77, 78])
    signals = {"q1": TURNS, "tau1": np.sign(TURNS), "dq1": np.gradient(TURNS, TIMES)}
    write_bench(path, t=TIMES[rows], **{name: column[rows] for name, column in signals.items()})
    yield (sentence := read_checks(path)["log.order"])
    ((table, key, value),) = re.findall(r"\[(\w+)\] (\w+) = ('\w+')", sentence)
    add_line(path, table, key, value)
    yield read_checks(path).get("log.order", "")


def columns_of_motors(path: Path) -> Iterator[str]:
    """Positions of motors before a gear: the sentence names two keys of a table."""
    model = """<robot name="one"><link name="base"/><joint name="j1" type="revolute">
        <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
        <limit lower="-1.5" upper="1.5" effort="9" velocity="9"/></joint>
        <link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
        ixz="0" iyz="0"/></inertial></link></robot>"""
    (path / "bench.urdf").write_text(model, encoding="utf-8")
    motors = {"motor_position": 50.0 * TURNS, "motor_velocity": 50.0 * np.gradient(TURNS, TIMES)}
    columns = '[log.columns]\nq = ["motor_position"]\ndq = ["motor_velocity"]\n'
    write_bench(path, columns, **motors)
    yield (sentence := read_checks(path)["limits"])
    matrix, table = re.findall(r"'(\w+)' in \[(\w+)\]", sentence)[0]
    add_line(path, table, matrix, "[[50.0]]")
    ((key, value),) = re.findall(r"(\w+) = ('\w+')$", sentence.rstrip("."))
    add_line(path, table, key, value)
    yield read_checks(path).get("limits", "")


# Sentences that print a command or a line without an attached change, by words of them.
EXECUTED: dict[str, Callable[[Path], Iterator[str]]] = {
    "of [log.units], or log more": count_of_an_encoder,
    "in [transmission], with logs": columns_of_motors,
    "[log] duplicates": repeated_stamps,
}
# Lines that another test executes as printed: of counters and clocks in `test_time_stamps`, of
# checks that are accepted in `test_mistakes`, and of changes in the test above.
EXECUTED_ELSEWHERE = {
    "[log] wrap", "[log] restart", "[log] sort", "accept=", "; set {}", "hesr inspect tries",
}  # fmt: skip
LINE = re.compile(
    r"\bhesr [a-z]+\b|(?<!\w)--[a-z]|\[[a-z.]+\] \w+ = |\w+ = '|' (?:of|in) \[|; set |accept="
)
NO_REMEDIES = {"Proposed by 'hesr inspect'"}


@pytest.mark.parametrize("words", EXECUTED)
def test_a_line_without_a_change_makes_its_sentence_go_away(words: str, tmp_path: Path) -> None:
    before, after = EXECUTED[words](tmp_path)
    assert words in before
    assert after == ""


def test_every_command_and_line_of_a_check_is_executed() -> None:
    paths = [*Path(health.__file__).parent.glob("*.py"), Path(robot_log.__file__)]
    printed = {text for path in paths for text in read_texts(path) if LINE.search(text)}
    listed = (*EXECUTED, *EXECUTED_ELSEWHERE, *NO_REMEDIES)
    assert [text for text in printed if not any(words in text for words in listed)] == []
    unused = [words for words in listed if not any(words in text for text in printed)]
    assert unused == []
