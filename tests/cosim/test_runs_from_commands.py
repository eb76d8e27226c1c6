"""`hesr run` and the choice of laws for logs without torque."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hobby_servo import HobbyServo, draw_hobby_servo, run_along, write_robot
from small_study import Hesr, hesr_here

import hesr
from cosim.servo.study import MotionErrors
from fmu_src.check.run import check

STUDY = """name = "lever"
robot = "robot.toml"
[logs]
identification = ["train.csv"]
[logs.test]
unseen = ["test.csv"]
"""


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def write_study(folder: Path, *, seconds: float = 30.0, **options: object) -> HobbyServo:
    """Write a study whose test log is the second half of a draw."""
    draw = draw_hobby_servo(folder, 3, rate=100.0, seconds=seconds, **options)
    lines = draw.write_log(folder / "log.csv").read_text().splitlines()
    half = len(lines) // 2
    (folder / "train.csv").write_text("\n".join(lines[:half]))
    (folder / "test.csv").write_text("\n".join([lines[0], *lines[half:]]))
    (folder / "study.toml").write_text(STUDY)
    return draw


def test_a_run_writes_law_fmus_and_report(tmp_path: Path, cli: Hesr) -> None:
    draw = write_study(tmp_path)
    results = tmp_path / "results"
    said = cli("run", tmp_path / "study.toml", "--quick", "-o", results)
    assert said.code == 0, said.err
    assert "from commands and positions" in said.out
    page = (results / "report.html").read_text()
    for part in ("from commands", "scale from gravity", "whole plant", "test (test)"):
        assert part in page
    model = hesr.FrictionModel.read(results / "laws" / "coulomb_viscous.json")
    assert model.servos[0].servo.kp == pytest.approx(draw.servo.kp[0], rel=0.02)
    for fmu in (results / "fmus").iterdir():
        assert check(fmu).problems == ()
    again = cli("report", results)
    assert again.code == 2
    assert "from commands" in again.err
    data = json.loads((results / "command_run.json").read_text())
    [test] = [errors for errors in data["result"]["errors"] if errors["is_test"]]
    plant = results / "fmus" / "Plant.fmu"
    rows = np.loadtxt(tmp_path / "test.csv", delimiter=",", skiprows=1)
    reached = run_along(plant, rows[:, 0] - rows[0, 0], rows[:, 1], {"q_start[1]": rows[0, 2]})
    error = np.sqrt(np.mean((reached - rows[:, 2]) ** 2))
    assert test["coupled"][0] == pytest.approx(error, rel=1e-9)


def test_a_law_is_tested_on_the_motion_of_commands(tmp_path: Path, cli: Hesr) -> None:
    draw = write_study(tmp_path)
    law = tmp_path / "law.json"
    robot = tmp_path / "robot.toml"
    hesr.fit(tmp_path / "train.csv", robot=robot, law="coulomb_viscous", output=law)
    said = cli("test", law, "--on", tmp_path / "test.csv", "--robot", robot)
    assert said.code == 0, said.err
    assert "from commands alone" in said.out
    assert "passivity" in said.out
    report = hesr.test(law, on=tmp_path / "log.csv", robot=robot)
    [errors] = report.motions["coulomb_viscous"]
    assert errors.coupled == pytest.approx(errors.alone, rel=0.2)
    assert errors.coupled[0] < 0.1 * errors.ideal[0]
    assert errors.coupled[0] < 4.0 * np.max(np.abs(draw.q - draw.exact))


def test_without_a_scale_a_run_has_no_fmu(tmp_path: Path, cli: Hesr) -> None:
    write_study(tmp_path)
    write_robot(tmp_path, 0.3, 0.0)
    results = tmp_path / "results"
    said = cli("run", tmp_path / "study.toml", "--quick", "-o", results)
    assert said.code == 0, said.err
    assert "up to one factor" in said.out
    assert not (results / "fmus").exists()


def test_seeds_are_refused(tmp_path: Path, cli: Hesr) -> None:
    write_study(tmp_path)
    said = cli("run", tmp_path / "study.toml", "--seeds", "2", "-o", tmp_path / "results")
    assert said.code == 2
    assert not (tmp_path / "results").exists()


@pytest.mark.ci
@pytest.mark.parametrize("seconds", [15.0, 30.0])
@pytest.mark.parametrize("law", ["coulomb_viscous", "stribeck"])
def test_the_true_law_is_chosen(tmp_path: Path, law: str, seconds: float) -> None:
    write_study(tmp_path, law_name=law, seconds=seconds)
    model = hesr.fit(tmp_path / "log.csv", robot=tmp_path / "robot.toml", law="choose")
    assert model.law == law
    assert model.provenance["choose"]


def test_joints_that_move_each_other_are_named() -> None:
    errors = MotionErrors(
        log="wave", is_test=True, ideal=(0.02, 0.03), alone=(0.001, 0.002), coupled=(0.0011, 0.004)
    )
    [doubt] = errors.doubts
    assert "joint 2 errs 2.0 times" in doubt
    assert replace(errors, coupled=()).doubts == []


def test_inspect_proposes_a_study_of_commands(tmp_path: Path, cli: Hesr) -> None:
    write_study(tmp_path)
    robot = tmp_path / "proposed.toml"
    study = tmp_path / "proposed_study.toml"
    said = cli(
        "inspect", tmp_path / "train.csv", "--robot", tmp_path / "lever.urdf",
        "--write", robot, "--study", study,
    )  # fmt: skip
    assert said.code == 0, said.err
    assert "lugre" not in study.read_text()
    run = cli("run", study, "--quick", "-o", tmp_path / "results")
    assert run.code == 0, run.err
    assert (tmp_path / "results" / "fmus" / "Plant.fmu").exists()
