"""Files of planned motions: tables, URScript by its grammar, ROS 2 messages by their definition."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from rosbags.typesys import Stores, get_typestore

from hesr.cli.app import app
from hesr.extras.excite.motion import PlannedMotion
from hesr.extras.excite.plan import HEAD, write_motion
from hesr_model.errors import ConfigError, HesrError
from hesr_model.logs.tables import read_table
from hesr_model.support.files import models_folder

ROBOT = models_folder() / "uf850" / "robot.toml"
SETTINGS = "[limits]\nvelocity = [1.25, 1.25, 1.25]\nacceleration = [3.4, 3.4, 3.4]\n"
JOINTS = tuple(f"joint'{k}" for k in range(6))
TOKEN = re.compile(
    r'\s*(?:(?P<number>-?\d+(?:\.\d+)?)|(?P<text>"[^"]*")|(?P<name>[A-Za-z_]\w*)'
    r"|(?P<sign>[()\[\],=<>:+-]))"
)
CALLS = {"movej": 1, "servoj": 1, "stopj": 1, "popup": 1, "write_output_integer_register": 2}


class Script:
    """Parser of the URScript that HESR writes: statements, blocks, calls, lists, comparisons."""

    def __init__(self, text: str) -> None:
        lines = [line for line in text.split("\n") if line and not line.lstrip().startswith("#")]
        self.lines = [self.tokens(line) for line in lines]
        self.calls: list[tuple[str, list[Any], dict[str, Any]]] = []
        self.names: dict[str, Any] = {}
        name = re.fullmatch(r"def (\w+)\(\):", lines[0].strip())
        assert name, lines[0]
        rest = self.block(1)
        assert rest == len(self.lines), "text after the last end"

    @staticmethod
    def tokens(line: str) -> list[tuple[str, str]]:
        at, found = 0, []
        while at < len(line.rstrip()):
            match = TOKEN.match(line, at)
            assert match, f"not URScript: {line[at:]}"
            assert match.lastgroup
            found.append((match.lastgroup, match[match.lastgroup]))
            at = match.end()
        return found

    def block(self, at: int) -> int:
        """Read statements up to the end of a block; return the line after it."""
        while True:
            self.row, self.place = self.lines[at], 0
            head = self.row[0][1]
            if head == "end":
                assert len(self.row) == 1
                return at + 1
            if head in ("while", "if"):
                self.place = 1
                self.value()
                assert self.take() in (">", "<")
                self.value()
                assert self.take() == ":"
                assert self.place == len(self.row)
                at = self.block(at + 1)
                continue
            if head == "halt":
                self.place = 1
            elif self.row[1][1] == "=":
                self.place = 2
                self.names[head] = self.value()
            else:
                self.value()
            assert self.place == len(self.row), self.row
            at += 1

    def take(self) -> str:
        self.place += 1
        return self.row[self.place - 1][1]

    def value(self) -> Any:
        left = self.operand()
        while self.place < len(self.row) and self.row[self.place][1] in "+-":
            self.take()
            self.operand()
            left = None
        return left

    def operand(self) -> Any:
        kind, text = self.row[self.place]
        self.take()
        if kind == "number":
            return float(text)
        if kind == "text":
            return text[1:-1]
        if text == "[":
            items = []
            while True:
                items.append(self.value())
                if (sign := self.take()) == "]":
                    return items
                assert sign == ","
        assert kind == "name", text
        following = self.row[self.place][1] if self.place < len(self.row) else ""
        if following == "[":
            assert text in self.names
            self.operand()
            return None
        if following != "(":
            assert text in ("True", "False") or text in self.names, text
            return self.names.get(text, text == "True")
        self.take()
        ordered: list[Any] = []
        named: dict[str, Any] = {}
        while self.row[self.place][1] != ")":
            if self.row[self.place + 1][1] == "=":
                name = self.take()
                self.take()
                named[name] = self.value()
            else:
                assert not named, "an argument without a name after one with a name"
                ordered.append(self.value())
            if self.row[self.place][1] == ",":
                self.take()
        self.take()
        self.calls.append((text, ordered, named))
        return None


@pytest.fixture(scope="module")
def motion() -> PlannedMotion:
    rows = np.zeros((251, 6))
    s = np.linspace(0.0, 1.0, 251)
    rows[:] = np.arange(6) / 3.0
    rows[:, 1] += 0.5 * np.sin(np.pi * s) ** 4
    return PlannedMotion(rate=125.0, rows=rows)


def test_urscript_follows_its_grammar_and_sends_every_setpoint(
    motion: PlannedMotion, tmp_path: Path
) -> None:
    path = write_motion(tmp_path / "m.csv", motion, JOINTS, "urscript")
    assert path.suffix == ".script"
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"# {HEAD}")
    script = Script(text)
    names = [name for name, *_ in script.calls]
    assert set(names) <= {*CALLS, "norm", "get_actual_joint_positions"}
    for name, ordered, _ in script.calls:
        assert len(ordered) == CALLS.get(name, len(ordered))
    sent = [(ordered[0], named) for name, ordered, named in script.calls if name == "servoj"]
    np.testing.assert_array_equal([q for q, _ in sent], motion.rows)
    assert {named["t"] for _, named in sent} == {1.0 / 125.0}
    # The guard: to the start first, then a check, then the register for RTDE around the motion.
    np.testing.assert_array_equal(script.names["start"], motion.rows[0])
    first, last = names.index("servoj"), len(names) - 1 - names[::-1].index("servoj")
    assert names.index("movej") < names.index("popup") < first
    registers = [(k, c[1][1]) for k, c in enumerate(script.calls) if "register" in c[0]]
    assert [value for _, value in registers] == [0.0, 1.0, 0.0]
    assert registers[1][0] == first - 1
    assert registers[2][0] == last + 1


@pytest.mark.parametrize(
    "broken",
    [
        "def f():\n  servoj([0.0, t=0.002)\nend\n",
        "def f():\n  movej(start)\nend\n",
        "def f():\n  while 1 > 0:\n  halt\nend\n",
        "def f():\n  stopj(1e-3)\nend\n",
    ],
)
def test_the_parser_refuses_other_text(broken: str) -> None:
    with pytest.raises((AssertionError, IndexError)):
        Script(broken)


def test_ros2_trajectory_is_valid_by_its_definition(motion: PlannedMotion, tmp_path: Path) -> None:
    path = write_motion(tmp_path / "m", motion, JOINTS, "ros2")
    assert path.read_text(encoding="utf-8").startswith(f"# {HEAD}")
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types

    def message(kind: str, fields: dict[str, Any]) -> Any:
        assert set(fields) == {n for n in kinds[kind].__annotations__ if n != "__msgtype__"}
        return kinds[kind](**fields)

    def duration(of: dict[str, Any], kind: str) -> Any:
        return message(f"builtin_interfaces/msg/{kind}", of)

    points = [
        message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            {
                name: duration(value, "Duration")
                if name == "time_from_start"
                else np.array(value, dtype=np.float64)
                for name, value in point.items()
            },
        )
        for point in data.pop("points")
    ]
    head = data.pop("header")
    header = message("std_msgs/msg/Header", {**head, "stamp": duration(head["stamp"], "Time")})
    kind = "trajectory_msgs/msg/JointTrajectory"
    whole = message(kind, {**data, "header": header, "points": points})
    back = store.deserialize_cdr(store.serialize_cdr(whole, kind), kind)
    assert tuple(back.joint_names) == JOINTS
    np.testing.assert_array_equal([p.positions for p in back.points], motion.rows)
    t, _, dq, ddq = motion.setpoints()
    np.testing.assert_array_equal([p.velocities for p in back.points], dq)
    np.testing.assert_array_equal([p.accelerations for p in back.points], ddq)
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in back.points]
    np.testing.assert_allclose(times, t, rtol=0, atol=5e-10)
    assert times[0] == 0.0
    assert times[-1] == 2.0


def test_tables_keep_every_digit(motion: PlannedMotion, tmp_path: Path) -> None:
    for kind, suffix in (("csv", ".csv"), ("parquet", ".parquet")):
        path = write_motion(tmp_path / "m", motion, JOINTS, kind)
        assert path.suffix == suffix
        table = read_table(path)
        t, q, dq, ddq = motion.setpoints()
        np.testing.assert_array_equal(table.numbers(table.names), np.column_stack([t, q, dq, ddq]))
    assert (tmp_path / "m.csv").read_text(encoding="utf-8").startswith(f"# {HEAD} 125 Hz.\n")


def test_urscript_needs_six_joints(motion: PlannedMotion, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="URScript is for 6 joints"):
        write_motion(tmp_path / "m", motion, JOINTS[:2], "urscript")
    assert not any(tmp_path.iterdir())


def test_the_command_writes_motions_for_all_purposes_and_a_page(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text(f"harmonics = 3\nstarts = 1\n{SETTINGS}", encoding="utf-8")
    command = ["excite", str(ROBOT), "--settings", str(settings), "-o", str(tmp_path / "m.csv")]
    done = CliRunner().invoke(app, [*command, "--for", "all", "--time", "110"])
    assert done.exit_code == 0, done.output
    lengths = {}
    for name in ("body", "friction", "test"):
        table = read_table(tmp_path / f"m_{name}.csv")
        rows = table.numbers(table.names)
        lengths[name] = rows[-1, 0]
        np.testing.assert_array_equal(rows[0, 1:4], rows[-1, 1:4])
    assert sum(lengths.values()) == pytest.approx(110.0, abs=0.02)
    assert lengths["body"] < lengths["test"] < lengths["friction"]
    assert "friction, pose 2: " in done.output
    assert HEAD in done.output
    page = (tmp_path / "m.html").read_text(encoding="utf-8")
    for text in (
        "not run on a controller",
        "capsules around the links",
        'id="motion-for-friction"',
    ):
        assert text in page
    for more, message in (
        (["--for", "friction", "--time", "12"], "s are too short for strokes"),
        (["--for", "test", "--time", "0"], "'time' gives the motion for test 0 s"),
        (["--for", "test", "--format", "kuka"], "motion format 'kuka' is unknown; known are csv"),
    ):
        done = CliRunner().invoke(app, [*command[:-1], str(tmp_path / "no" / "m.csv"), *more])
        assert isinstance(done.exception, HesrError)
        assert message in str(done.exception)
    assert not (tmp_path / "no").exists()
