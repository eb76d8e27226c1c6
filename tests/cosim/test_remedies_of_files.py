"""Keys and lines that refusals print are written as printed: the refusals go away."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from printed_lines import write_line
from rotor import URDF, signals
from small_study import Hesr, hesr_here

# The remedy stands behind such a word; what is refused, before it.
REMEDY = re.compile(r"(?:[;,] (?:name|state|add|list|leave|or state|for the)|needs)\b")
KEY = re.compile(r"'([a-z_]+(?:\.[a-z_]+)*)'")

ROBOT = """name = "bench"
model = "bench.urdf"
joints = ["motor"]
known = []
rotor_inertia = false
"""
ARM = """<robot name="arm"><link name="base"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="50"{velocity}/></joint>
<link name="a"><inertial><origin xyz="0 0 0.2"/><mass value="{mass}"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j2" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="50" velocity="3"/>{follows}</joint>
<link name="b"><inertial><mass value="{mass}"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


@dataclass(frozen=True, kw_only=True)
class FileRefusal:
    """A log or a robot file that is refused, and lines by the keys that the refusal prints.

    Attributes
    ----------
    lines : lines of the robot file by key: table, key and value of each.
    columns : signals of `rotor` by column of the log.
    robot : lines of the robot file; `{}` stands for the name of the model file.
    model : text of the model file.
    command : refused command.
    file : file that the lines are written to.
    next_refusal : words of what the log is refused for then; empty if it is accepted.
    """

    lines: dict[str, tuple[tuple[str, str, str], ...]]
    columns: dict[str, str] = field(
        default_factory=lambda: {"t": "t", "q1": "q", "dq1": "dq", "tau1": "tau"}
    )
    robot: str = ROBOT
    model: str = URDF
    command: str = "identify run.csv --robot robot.toml"
    file: str = "robot.toml"
    next_refusal: str = ""


FIRST_LINE = ("", "rotor_inertia", "false")  # as it is

REFUSALS = {
    "state 'log.rate' [Hz]": FileRefusal(
        columns={"alpha": "t", "q1": "q", "dq1": "dq", "tau1": "tau"},
        command="inspect run.csv --robot robot.toml",
        lines={
            "log.columns.t": (("log.columns", "t", "'alpha'"),),
            "log.rate": (("log", "rate", "200.0"),),
        },
    ),
    "no columns look like positions": FileRefusal(
        columns={"t": "t", "alpha": "q", "beta": "dq", "gamma": "tau"},
        command="inspect run.csv --robot robot.toml",
        lines={
            "log.columns": (
                ("log.columns", "q", "['alpha']"),
                ("log.columns", "dq", "['beta']"),
                ("log.columns", "tau", "['gamma']"),
            )
        },
    ),
    "are not whole seconds": FileRefusal(
        columns={"sec": "t", "nanosec": "us", "q1": "q", "dq1": "dq", "tau1": "tau"},
        robot=ROBOT + "[log.columns]\nt = ['sec', 'nanosec']\n",
        lines={"log.columns.t": (("log.columns", "t", "'sec'"),)},
    ),
    "add 'log.torque_per_ampere'": FileRefusal(
        columns={"t": "t", "q1": "q", "dq1": "dq", "i1": "amperes"},
        lines={"log.torque_per_ampere": (("log", "torque_per_ampere", "[0.11]"),)},
    ),
    "columns to use under 'log.columns'": FileRefusal(
        columns={"t": "t", "q1": "q", "q2": "q", "dq1": "dq", "tau1": "tau"},
        lines={"log.columns": (("log.columns", "q", "['q1']"),)},
    ),
    "joints in the table [limits]": FileRefusal(
        robot='name = "arm"\nmodel = "bench.urdf"\njoints = ["j1", "j2"]\n',
        model=ARM.format(velocity="", mass="1", follows=""),
        command="excite robot.toml -o motion.csv --settings settings.toml",
        lines={"velocity": (("limits", "velocity", "[2.0, 2.0]"),)},
        file="settings.toml",
    ),
    "list it in 'springs'.": FileRefusal(
        robot='name = "arm"\nmodel = "bench.urdf"\njoints = ["j1", "j2"]\nbalancers = ["j2"]\n',
        model=ARM.format(velocity=' velocity="2"', mass="1", follows=""),
        command="excite robot.toml -o motion.csv --settings settings.toml",
        lines={"springs": (("", "springs", "['j2']"), ("", "balancers", "[]"))},
    ),
    "needs 'rotor_inertia' and excludes": FileRefusal(
        columns={"t": "t", "q1": "q", "dq1": "dq", "tau1": "tau", "link": "q"},
        robot=ROBOT + "[log.columns]\nq_link = ['link']\n",
        lines={"rotor_inertia": (("", "rotor_inertia", "true"),)},
        next_refusal="show the twist of a gear",
    ),
    "out of 'joints' and 'locked'": FileRefusal(
        robot='name = "arm"\nmodel = "bench.urdf"\njoints = ["j1", "j2"]\n',
        model=ARM.format(velocity=' velocity="2"', mass="1", follows='<mimic joint="j1"/>'),
        command="excite robot.toml -o motion.csv --settings settings.toml",
        lines={"joints": (("", "joints", "['j1']"),), "locked": (("", "joints", "['j1']"),)},
    ),
}


@pytest.fixture
def run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Hesr:
    monkeypatch.chdir(tmp_path)
    return hesr_here(capsys, monkeypatch)


def write_files(refusal: FileRefusal, folder: Path) -> None:
    values = signals()
    rows = np.column_stack([values[signal] for signal in refusal.columns.values()])
    np.savetxt(folder / "run.csv", rows, "%.9g", ",", header=",".join(refusal.columns), comments="")
    (folder / "bench.urdf").write_text(refusal.model, encoding="utf-8")
    (folder / "robot.toml").write_text(refusal.robot, encoding="utf-8")
    (folder / "settings.toml").write_text("harmonics = 3\n", encoding="utf-8")


@pytest.mark.parametrize("words", REFUSALS)
def test_a_key_that_a_refusal_prints_makes_it_go_away(
    words: str, run: Hesr, tmp_path: Path
) -> None:
    refusal = REFUSALS[words]
    write_files(refusal, tmp_path)
    answer = run(*refusal.command.split())
    assert answer.code == 2
    assert words in answer.err, answer.err
    remedy = REMEDY.search(answer.err)
    assert remedy, answer.err
    printed_keys = set(KEY.findall(answer.err[remedy.start() :]))
    assert refusal.lines.keys() <= printed_keys, printed_keys
    path = tmp_path / refusal.file
    text = path.read_text(encoding="utf-8")
    for lines in refusal.lines.values():
        changed = text
        for table, key, value in lines:
            changed = write_line(changed, table, key, value)
        path.write_text(changed, encoding="utf-8")
        after = run(*refusal.command.split())
        if refusal.next_refusal:
            assert refusal.next_refusal in after.err
        else:
            assert after.code == 0, (lines, after)
