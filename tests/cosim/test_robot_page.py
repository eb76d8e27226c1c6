"""hesr inspect without logs: tables and picture of a robot, and doubts about its model file."""

import json
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from small_study import Hesr, hesr_here

import hesr as api
from cosim.report.figures.motions import picture
from cosim.report.tables.laws import robot_tables
from hesr_model.errors import ArgumentError
from hesr_model.robots.robot import Robot

INERTIAL = (
    '<inertial><mass value="2"/><origin xyz="0.1 0 0"/>'
    '<inertia ixx=".01" iyy=".02" izz=".025" ixy="0" ixz=".001" iyz="0"/></inertial>'
)
ARM = f"""<robot name="arm"><link name="base"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 2"/>
<origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/>
<limit lower="0" upper="0.5" velocity="1" effort="9"/></joint><link name="a">{INERTIAL}</link>
<joint name="bend" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="-90" upper="90" velocity="0" effort="0"/></joint><link name="b">{INERTIAL}</link>
</robot>"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture
def arm_file(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM, encoding="utf-8")
    return path


def test_a_robot_is_shown_without_logs(arm_file: Path, hesr: Hesr) -> None:
    page, file = arm_file.with_name("robot.html"), arm_file.with_name("robot.toml")
    answer = hesr("inspect", "--robot", arm_file, "-o", page, "--write", file, "--json", "-")
    assert (answer.code, answer.err) == (0, "")
    doubt = "'bend': its limits -90 and 90"
    (finding,) = json.loads(answer.out)["findings"]
    assert (finding["check"], finding["joints"]) == ("odd-limits", ["bend"])
    assert "limits -90 and 90 rad" in finding["found"]
    text = page.read_text("utf-8")
    assert doubt.replace("'", "&#39;") in text
    assert text.count('id="figure-arm"') == 1
    assert [title in text for title in ("Motion and torque", "What this log")] == [False, False]
    shown = hesr("inspect", "--robot", file)
    assert shown.out.count("[odd-limits]\n") == 1
    assert f"warning: {arm_file}, joint {doubt}" in shown.out
    assert "lift [m]" in shown.out
    api_answer = api.inspect(robot=file)
    assert api_answer.passed
    assert [found.sentence for found in api_answer.findings] == [
        OneSentence(f"{arm_file}, joint {doubt}")
    ]


def test_tables_give_the_numbers_of_the_model_file(arm_file: Path) -> None:
    joints, links = robot_tables(Robot(arm_file))
    rows = [(row.head, *(cell.text for cell in row.cells)) for row in joints.rows]
    assert rows == [
        ("lift [m]", "0 -1 0", "0 to 0.5", "1", "9", "arm.urdf", "–"),
        ("bend [rad]", "0 0 1", "-90 to 90", "–", "–", "arm.urdf", "–"),
    ]
    numbers = [[float(cell.text) for cell in row.cells] for row in links.rows]
    expected = [2, 0.1, 0, 0, 0.01, 0.02, 0.025, 0, 0.001, 0]
    np.testing.assert_allclose(numbers, [expected] * 2, atol=1e-15)


def test_the_picture_has_two_poses(arm_file: Path) -> None:
    first, second = picture(Robot(arm_file)).axes
    ends = [np.array(axis.lines[-2].get_data_3d())[:, -1] for axis in (first, second)]
    np.testing.assert_allclose(ends[0], [0.1, 0.0, 1.0], atol=1e-12)  # tip's centre at q = 0
    turned = [0.1 * np.cos(0.8), 0.1 * np.sin(0.8) - 0.375, 1.0]  # lifted along -y
    np.testing.assert_allclose(ends[1], turned, atol=1e-12)
    assert len(first.texts) == len(second.texts) == 2


def test_meaningless_torques_are_an_error(arm_file: Path, hesr: Hesr) -> None:
    head, _, tail = ARM.rpartition(INERTIAL)
    arm_file.write_text(head + tail, encoding="utf-8")
    answer = hesr("inspect", "--robot", arm_file)
    assert answer.code == 1
    assert f"error: {arm_file}, joint 'bend': moves an inertia of 0 kg.m2" in answer.out
    assert "correct the <inertial> of the links after it. [no-inertia]" in answer.out


def test_a_bench_is_shown_without_doubts(tmp_path: Path, hesr: Hesr) -> None:
    hesr("new", tmp_path / "bench", "--bench", "rotary")
    answer = hesr("inspect", "--robot", tmp_path / "bench" / "robot.toml")
    assert (answer.code, answer.err) == (0, "")
    assert "Nothing wrong or unusual was found.\n" in answer.out
    assert "not stated" in answer.out


def test_logs_are_needed_for_a_study_and_without_a_robot(arm_file: Path) -> None:
    message = "without logs give 'robot'"
    for more in (
        {},
        {"robot": arm_file, "torque_constants": True},
        {"robot": arm_file, "write": "robot.toml", "study": "study.toml"},
    ):
        with pytest.raises(ArgumentError) as caught:
            api.inspect(**more)
        assert str(caught.value) == OneSentence(message)
