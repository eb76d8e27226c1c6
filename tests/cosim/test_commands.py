"""Commands as calls in Python: they find what the command line finds."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hesr
from hesr_model.errors import ConfigError, ExportError, HesrError, RobotError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import RobotLog
from hesr_model.robots.owner import Owner
from hesr_model.robots.robot import RobotDescription


@pytest.fixture
def file(arm: RobotDescription, arm_log: RobotLog) -> Path:
    path = arm.model.with_name("run.csv")
    arm_log.write(path)
    return path


def test_from_a_log_to_scores_in_four_calls(arm: RobotDescription, file: Path) -> None:
    log = hesr.Log.read(str(file), robot=str(arm.model))
    body = hesr.identify(log)
    assert body.joints == arm.joints
    model = hesr.fit("stribeck", log, rigid_body=body)
    scores = hesr.evaluate(model, str(file), body, str(arm.model))
    assert scores.joints == arm.joints
    np.testing.assert_allclose(scores.laws["stribeck"].rmse, model.training_rmse, rtol=1e-9)
    assert set(hesr.audit(model)) == set(arm.joints)
    fmu = hesr.export(model, str(file.with_name("Friction.fmu")))
    replayed = hesr.replay(fmu, log, body)
    np.testing.assert_allclose(replayed.laws["Friction"].rmse, model.training_rmse, rtol=1e-6)
    header = hesr.export(model, file.with_name("friction.h"), "c")
    assert header.read_text(encoding="utf-8")


def test_a_start_from_measured_torques_has_a_row_of_its_own(
    arm: RobotDescription, file: Path, table1: FrictionModel
) -> None:
    laws = tuple(replace(law, start_samples=5) for law in table1.laws)
    model = replace(table1, joints=arm.joints, laws=laws)
    body = hesr.identify(str(file), str(arm.model))
    scores = hesr.evaluate({"own": model}, str(file), body, str(arm.model))
    assert list(scores.laws) == ["own", "own + start"]
    assert scores.laws["own"] != scores.laws["own + start"]


def test_models_are_those_of_the_robots_owner(arm: RobotDescription, file: Path) -> None:
    owned = arm.model_copy(update={"owner": Owner(author="A", license="MIT")})
    for robot, owner in ((arm, {}), (owned, {"author": "A", "license": "MIT"})):
        model = hesr.fit("stribeck", str(file), robot)
        assert Owner.of(model.provenance).known == owner


def test_a_log_is_looked_at(arm: RobotDescription, file: Path) -> None:
    proposal = hesr.inspect(str(file), str(arm.model))
    assert [log.name for log in proposal.logs] == ["run"]
    assert hesr.inspect([file]).robot.joints == ("joint1", "joint2", "joint3")


def test_a_folder_is_laid(arm: RobotDescription, tmp_path: Path) -> None:
    made = hesr.new(str(tmp_path / "mine"), str(arm.model))
    assert made.joints == arm.joints
    assert (tmp_path / "mine" / "study.toml").is_file()


def test_the_laws_are_listed() -> None:
    assert "lugre" in hesr.laws()


def test_what_cannot_be_used_is_refused(
    arm_log: RobotLog, table1: FrictionModel, tmp_path: Path
) -> None:
    untrained: Any = table1
    for call, error, sentence in [
        (lambda: hesr.identify(arm_log), RobotError, "the logs do not say of which robot they"),
        (lambda: hesr.identify("a.csv"), RobotError, "a.csv: to read this log its robot must be"),
        (lambda: hesr.inspect(arm_log), ConfigError, "logs are inspected in their files; needed"),
        (lambda: hesr.audit(untrained), ConfigError, "does not say what it was fitted to; an"),
        (
            lambda: hesr.export(table1, "a", "x"),
            ConfigError,
            "export format 'x' is unknown; known are adaptive",
        ),
        (lambda: hesr.export(table1, tmp_path / "a.txt"), ExportError, "a.txt"),
        (lambda: hesr.export(table1, "a", robot="r"), ConfigError, "'robot' and 'rigid_body' go"),
        (
            lambda: hesr.export(table1, "a", "c", robot="r", rigid_body="b"),
            ConfigError,
            "'rigid_body' is for the page of an FMU, the format is 'c'.",
        ),
        (lambda: hesr.evaluate([table1, table1], [], ""), ConfigError, "2 friction models have 1 "),
        (lambda: hesr.report(3), HesrError, "a folder is given as int; needed is a path"),
    ]:
        with pytest.raises(error, match=sentence):
            call()
