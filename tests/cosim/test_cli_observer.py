"""Observer and plug-in for MuJoCo on the command line."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from small_study import hesr_here, uf850

from fmu_src.run.fmu import FmuInstance
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot


def free_motion(table1: FrictionModel, path: Path, seed: int) -> Path:
    """Write a log of the twin's robot under the law itself, with rests and noisy torques."""
    robot, rng, t = Robot(uf850("robot.toml")), np.random.default_rng(seed), 0.005 * np.arange(8000)
    rates, phases = rng.uniform(0.5, 1.5, (2, 3))
    moving = np.clip(2.0 + 4.0 * np.sin(0.4 * t), 0.0, 1.0)[:, None]
    dq = 0.8 * np.sin(np.outer(t, rates) + phases) * moving
    q = np.cumsum(dq, axis=0) * 0.005 + np.array([0.0, 0.3, -1.9])
    load = robot.torque(robot.nominal_parameters, q, dq, np.gradient(dq, t, axis=0))
    friction = table1.predict(t=t, dq=dq, q=q, tau_load=load)
    tau = load + friction + rng.normal(0.0, 1.0, q.shape)
    Log(name=path.stem, t=t, q=q, dq=dq, tau=tau).write(path)
    return path


def test_an_observer_is_calibrated_on_logs(
    table1: FrictionModel,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hesr, robot = hesr_here(capsys, monkeypatch), uf850("robot.toml")
    logs = [free_motion(table1, tmp_path / f"free{k}.csv", k) for k in (1, 2)]
    options = ("--format", "observer", "--robot", robot)
    calibration = [part for log in logs for part in ("--calibration", log)]
    out = tmp_path / "Observer.fmu"
    answer = hesr(
        *("export", "uf850-table1", *options, *calibration),
        *("--platform", "linux64", "-o", out),
    )
    assert answer.code == 0, answer.err
    with zipfile.ZipFile(out) as archive:
        page = " ".join(archive.read("documentation/index.html").decode().split())
    assert "of the errors in 1.3 min" in page
    assert "Logs: free1, free2." in page
    with FmuInstance(out) as fmu:
        fmu.initialise()
        # Noise of 1 N.m behind means of two samples and the low pass is about 0.4 N.m.
        floor = fmu.get([f"band_floor[{i}]" for i in (1, 2, 3)])
        assert np.all((floor > 0.5) & (floor < 2.0))
    header = tmp_path / "observer.h"
    answer = hesr("export", "uf850-table1", *options, *calibration, "-o", header)
    assert answer.code == 0, answer.err
    assert "observer_step(" in header.read_text(encoding="utf-8")


def test_what_is_missing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    hesr, robot, out = hesr_here(capsys, monkeypatch), uf850("robot.toml"), tmp_path / "O.fmu"
    for options, sentence in (
        (("--format", "observer"), "--format observer needs --robot, the robot of the law."),
        (
            ("--format", "observer", "--robot", robot),
            "model 'parfam_h' has no band; give",
        ),
        (("--bandwidth", "9"), "--bandwidth needs --format observer, but the format is 'fmu'."),
        (
            ("--format", "mujoco-plugin"),
            "plug-in of MuJoCo is a library",
        ),
    ):
        answer = hesr("export", "uf850-table1", *options, "-o", out)
        assert (answer.code, answer.err) == (2, OneSentence("hesr: ", sentence))
    assert list(tmp_path.iterdir()) == []
