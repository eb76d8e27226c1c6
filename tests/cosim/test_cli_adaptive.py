"""Commands for adaptive friction: the adaptive FMU and the monitor of logs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_models import model as model_of
from fmpy import read_model_description
from small_study import Run, hesr_here, uf850

from cosim.workflow.fit import fit
from hesr.extras.adaptive.component import TUNING
from hesr.extras.thermal.thermal_fit import fit_thermal
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription


def test_an_adaptive_fmu_is_exported(tmp_path: Path, capsys, monkeypatch) -> None:
    hesr = hesr_here(capsys, monkeypatch)
    law, fmu = tmp_path / "law.json", tmp_path / "Adaptive.fmu"
    values = {"sigma_0": 4e4, "sigma_1": 0.0, "sigma_2": 14.0, "F_c": 12.0, "F_s": 14.0,
              "v_s": 0.1, "tau_0": 0.3}  # fmt: skip
    own = FrictionLaw(name="lugre", form=LuGre.form({}), values=values)
    replace(model_of(own), law="lugre").write(law)
    for more, sentence in (
        (
            ("--power",),
            "--power needs --format fmu, but the format is 'adaptive'.",
        ),
    ):
        answer = hesr("export", law, "--format", "adaptive", *more, "-o", fmu)
        assert (answer.code, answer.err.strip()) == (2, f"hesr: {sentence}")
    answer = hesr("export", law, "--format", "adaptive", "-o", fmu)
    assert answer.code == 0, answer.err
    assert "\nPlatforms: linux64, win64.\n" in answer.out
    assert {v.name for v in read_model_description(fmu).modelVariables} >= {"level[1]", "adapt"}


@pytest.mark.ci
def test_temperature_is_found_in_logs(study_run: Run, tmp_path: Path, capsys, monkeypatch) -> None:
    hesr = hesr_here(capsys, monkeypatch)
    robot, body, law = uf850("robot.toml"), study_run.rigid_body, tmp_path / "law.json"
    fit(study_run.log("sweep"), law="lugre", robot=robot, rigid_body=body).write(law)
    log, out = tmp_path / "warm.csv", tmp_path / "warm.json"
    cold = Log.read(study_run.log("sweep"), robot)
    options = ("--law", law, "--add", "temperature", "--robot", robot, "--rigid-body", body)
    options += ("-o", out)
    answer = hesr("fit", study_run.log("sweep"), *options)
    assert answer.code == 2
    assert "without temperatures it must last 300 s" in answer.err
    assert not out.exists()
    warm = np.linspace(20.0, 40.0, len(cold.t))[:, None] * np.ones(cold.q.shape[1])
    replace(cold, temperature=warm).write(log)
    answer = hesr("fit", log, *options)
    assert answer.code == 0, answer.err
    # The twin does not depend on temperature.
    model = Robot(RobotDescription.read(robot))
    records = friction_records(Log.read(log, robot), model, RigidBody.read(body))
    for joint in fit_thermal(FrictionModel.read(law), [records])[1]:
        assert abs(joint.thermal.viscous) < 0.005 + 4.0 * joint.viscous_error
    assert len(FrictionModel.read(out).thermal) == 3
    assert "Coulomb friction falls by" in answer.out
    the_law_and_its_fmu_follow_the_thermometer(hesr, law, out, log, body)


def scored(path: Path):
    return json.loads(path.read_text(encoding="utf-8"))["result"]["prediction"]


def the_law_and_its_fmu_follow_the_thermometer(
    hesr, law: Path, warm: Path, log: Path, body: Path
) -> None:
    fmu = warm.with_suffix(".fmu")
    options = ("--robot", uf850("robot.toml"), "--rigid-body", body)
    answer = hesr("export", warm, "-o", fmu)
    assert answer.code == 0, answer.err
    assert "temperature[3]" in {v.name for v in read_model_description(fmu).modelVariables}
    errors = {}
    for name, command in (
        ("cold", ("test", law)),
        ("warm", ("test", warm)),
        ("fmu", ("test", fmu)),
    ):
        found = warm.parent / f"errors_{name}.json"
        answer = hesr(*command, "--on", log, *options, "--json", found)
        assert answer.code == 0, answer.err
        [errors[name]] = [one["rmse"] for one in scored(found)["laws"].values()]
    np.testing.assert_allclose(errors["fmu"], errors["warm"], rtol=1e-9)
    assert np.all(np.array(errors["warm"]) <= np.array(errors["cold"]) + 1e-9)
    assert errors["warm"] != errors["cold"]
    refused = warm.with_suffix(".drive.fmu")
    answer = hesr("export", warm, "--format", "drive", "--inertia", "1", "-o", refused)
    assert answer.code == 2
    assert "depends on temperature, which a drive" in answer.err


def test_friction_is_monitored_over_logs(
    study_run: Run, tmp_path: Path, capsys, monkeypatch
) -> None:
    hesr = hesr_here(capsys, monkeypatch)
    page, found, law = tmp_path / "page.html", tmp_path / "found.json", tmp_path / "law.json"
    sweep, body = study_run.log("sweep"), study_run.rigid_body
    model = fit(sweep, law="lugre", robot=uf850("robot.toml"), rigid_body=body)
    model.write(law)
    answer = hesr(
        *("monitor", sweep, study_run.log("trial"), "--law", law, "--robot", uf850("robot.toml")),
        *("--rigid-body", body, "-o", page, "--json", found),
    )
    assert answer.code == 0, answer.err
    data = json.loads(found.read_text(encoding="utf-8"))["result"]
    joints = model.joints
    assert [(s["log"], s["joint"]) for s in data["states"]] == [
        (log, joint) for log in ("sweep", "trial") for joint in joints
    ]
    for state in data["states"]:
        # The law was fitted to the sweep, so its scale stays near one.
        assert abs(state["level"] - 1.0) < 0.1
        assert 0.0 < state["level_sd"] <= TUNING.level_sd
        assert state["rmse"] < 1.02 * state["rmse_fixed"]
    assert f"{joints[0]}: level " in answer.out
    text = page.read_text(encoding="utf-8")
    assert "0 changes of friction found." in text or data["alarms"]
    assert text.count("<svg") >= len(joints)
    assert not list(tmp_path.glob("*.png"))


def test_unsupported_laws_are_not_monitored(
    study_run: Run, tmp_path: Path, capsys, monkeypatch
) -> None:
    hesr = hesr_here(capsys, monkeypatch)
    answer = hesr(
        *("monitor", study_run.log("trial"), "--law", study_run.law("stribeck")),
        *("--robot", uf850("robot.toml"), "--rigid-body", study_run.rigid_body),
        *("-o", tmp_path / "page.html"),
    )
    assert answer.code == 2
    assert "has neither stops nor bristles" in answer.err
    assert not list(tmp_path.iterdir())
