"""hesr inspect --torque-constants: output in the terminal and as JSON, and its error messages."""

import json
from pathlib import Path

import pytest
from small_study import Hesr, hesr_here

from hesr_model.logs.robot_log import Log

ROBOT = """
name = "arm"
model = "arm.xml"
joints = ["j1", "j2", "j3"]
[log]
torque_per_ampere = [2.0, 2.0, 2.0]
"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def write(folder: Path, log: Log) -> tuple[Path, Path]:
    robot, file = folder / "robot.toml", folder / "run.csv"
    robot.write_text(ROBOT, encoding="utf-8")
    log.write(file)
    file.write_text(file.read_text(encoding="utf-8").replace("tau", "i", 3), encoding="utf-8")
    return robot, file


def test_constants_are_printed_and_written(hesr: Hesr, tmp_path: Path, arm_log: Log) -> None:
    robot, log = write(tmp_path, arm_log)
    out = tmp_path / "constants.json"
    answer = hesr("inspect", log, "--robot", robot, "--torque-constants", "--json", out)
    assert (answer.code, answer.err) == (0, "")
    lines = [line for line in answer.out.splitlines() if line.startswith("joint ")]
    assert len(lines) == 3
    assert lines[0].startswith("joint 'j1': not determined")
    told = [line for line in lines if "not determined" not in line]
    found = json.loads(out.read_text(encoding="utf-8"))["result"]["torque_constants"]
    assert len(found) == len(told)


def test_a_payload_needs_four_numbers(hesr: Hesr, tmp_path: Path, arm_log: Log) -> None:
    robot, log = write(tmp_path, arm_log)
    answer = hesr("inspect", log, "--robot", robot, "--torque-constants", "--payload", "2.0,0.1")
    assert answer.code == 2
    assert "--payload: found 2 values; expected mass and" in answer.err
    answer = hesr(
        "inspect", log, "--robot", robot, "--torque-constants", "--payload", "2.0,0.1,0,0"
    )
    assert answer.code == 2
    assert "motions under a payload need" in answer.err
