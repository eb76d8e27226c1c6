"""A sliding axis end to end: MATLAB log, mass and friction, open loop, output error, FMU."""

import json
from dataclasses import replace
from pathlib import Path

import emps
import numpy as np
import pytest
from small_study import Hesr, hesr_here

from cosim.study.steps import Job
from cosim.study.study import Study
from fmu_src.friction.replay import replay
from hesr_model.fitting.fit import fit
from hesr_model.forward.output_error import MAX_TORQUE_RATIO, RefinementResult, refine
from hesr_model.forward.simulation import Simulator, cut_windows, position_errors, to_single_window
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth_logs
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription

MOST = 5e-3
"""Open-loop error [m]."""

STUDY = """
name = "emps"
robot = "robot.toml"
laws = ["stribeck"]
refinement = { kind = "output_error", law = "stribeck" }
[logs]
identification = ["DATA_EMPS.mat"]
test = { pulses = ["DATA_EMPS_PULSES.mat"] }
"""

Identified = tuple[Robot, RigidBody, FrictionModel]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("emps")
    (path / "robot.toml").write_text(emps.ROBOT, encoding="utf-8")
    (path / "emps.xml").write_text(emps.MODEL, encoding="utf-8")
    (path / "study.toml").write_text(STUDY, encoding="utf-8")
    emps.write(path / "DATA_EMPS.mat", seconds=6.0)
    emps.write(path / "DATA_EMPS_PULSES.mat", seconds=4.0, pulses=True, seed=1)
    return path


@pytest.fixture(scope="module")
def logs(folder: Path) -> tuple[Log, Log]:
    robot = RobotDescription.read(folder / "robot.toml")
    training, pulses = (
        Log.read(folder / f"{n}.mat", robot) for n in ("DATA_EMPS", "DATA_EMPS_PULSES")
    )
    return training, pulses


@pytest.fixture(scope="module", params=["stribeck", "lugre"])
def identified(request: pytest.FixtureRequest, folder: Path, logs: tuple[Log, Log]) -> Identified:
    robot = Robot(RobotDescription.read(folder / "robot.toml"))
    body = identify([logs[0]], robot)
    return robot, body, fit(request.param, friction_records(logs[0], robot, body), robot="EMPS")


@pytest.fixture(scope="module")
def refined(identified: Identified, logs: tuple[Log, Log]) -> RefinementResult:
    robot, body, law = identified
    return refine(robot, body, law, smooth_logs([logs[0]], robot))


def test_mass_and_friction_are_identified(identified: Identified) -> None:
    _, body, law = identified
    assert body.parameters[body.names.index("axis.m")] == pytest.approx(emps.MASS, rel=0.05)
    coulomb, viscous, offset = body.friction[0]
    assert coulomb == pytest.approx(emps.COULOMB, rel=0.1)
    assert viscous == pytest.approx(emps.VISCOUS, rel=0.05)
    assert offset == pytest.approx(emps.OFFSET, rel=0.2)
    assert {c.unit for c in law.laws[0].form.coefficients} >= {"N", "N.s/m", "m/s"}


def torque_error(robot: Robot, body: RigidBody, law: FrictionModel, log: Log) -> float:
    """RMS over all rows [N]."""
    records = friction_records(log, robot, body)
    return float(np.sqrt(np.mean((law.predict(records)[:, 0] - records[0].tau) ** 2)))


def position(robot: Robot, body: RigidBody, law: FrictionModel, log: Log, length: float) -> float:
    """RMS [m] over windows of the given length [s]; 0 is the open loop."""
    records = friction_records(log, robot, body)
    one = Simulator(robot=robot, parameters=body.parameters, model=law)
    cut = cut_windows([records], length) if length else to_single_window(records)
    (found,) = position_errors(one.run(cut), cut)
    return np.inf if found is None else found


def test_output_error_improves_on_an_unseen_log(
    identified: Identified, refined: RefinementResult, logs: tuple[Log, Log]
) -> None:
    robot, body, law = identified
    given, better = (robot, body, law), (robot, refined.body, refined.model)
    assert refined.ratio < 0.8
    for length in (0.2, 0.5):
        assert position(*better, logs[1], length) < 0.8 * position(*given, logs[1], length)
    assert position(*better, logs[1], 0.0) <= MOST
    assert torque_error(*better, logs[1]) <= 1.03 * torque_error(*given, logs[1])
    mass = refined.body.parameters[body.names.index("axis.m")]
    assert mass == pytest.approx(emps.MASS, rel=0.01)


def test_torque_error_is_unchanged_on_the_training_log(
    identified: Identified, refined: RefinementResult, logs: tuple[Log, Log]
) -> None:
    robot, body, law = identified
    after = torque_error(robot, refined.body, refined.model, logs[0])
    assert after <= MAX_TORQUE_RATIO * torque_error(robot, body, law, logs[0])
    np.testing.assert_allclose(refined.model.training_rmse, [after], rtol=1e-9)
    assert not refined.model.laws[0].standard_errors  # those belong to another estimate


def test_a_study_refines_by_output_error(folder: Path, logs: tuple[Log, Log]) -> None:
    path = folder / "study.toml"
    job = Job(study=Study.read(path), path=path, progress=lambda *_: None)
    robot = Robot(job.robot)
    body, together = job.rigid_body({"DATA_EMPS.mat": logs[0]}, robot)
    once = identify([logs[0]], robot)
    assert list(together) == ["stribeck"]
    assert position(robot, body, together["stribeck"], logs[1], 0.5) < 1e-4
    assert body.parameters[0] != once.parameters[0]


def test_the_command_line_covers_all_steps(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hesr: Hesr = hesr_here(capsys, monkeypatch)
    robot = ("--robot", folder / "robot.toml")
    body, law, fmu = (tmp_path / name for name in ("body.json", "law.json", "Friction.fmu"))
    for command in (
        ("identify", folder / "DATA_EMPS.mat", *robot, "-o", body),
        (
            "fit",
            folder / "DATA_EMPS.mat",
            *robot,
            "--rigid-body",
            body,
            "--law",
            "stribeck",
            "-o",
            law,
        ),
        ("export", law, "-o", fmu),
    ):
        answer = hesr(*command)
        assert answer.code == 0, answer.err
    pulses = folder / "DATA_EMPS_PULSES.mat"
    said = hesr(
        *("test", law, "--on", pulses, *robot, "--rigid-body", body),
        *("--json", tmp_path / "a.json", "--verbose"),
    )
    assert said.code == 0, said.err
    assert "the position [mm]" in said.out
    data = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    (free,) = data["result"]["simulation"]["open_loop"]["stribeck"]
    assert free <= MOST
    log = Log.read(pulses, RobotDescription.read(folder / "robot.toml"))
    model = Robot(RobotDescription.read(folder / "robot.toml"))
    (record,) = friction_records(log, model, RigidBody.read(body))
    torque = replay(fmu, record.t, record.dq[:, None])
    expected = FrictionModel.read(law).predict(t=record.t, dq=record.dq[:, None])
    np.testing.assert_allclose(torque, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("law", ["parfam_s_v", "parfam_s_load"])
def test_finer_deflections_simulate_a_sliding_axis_better(
    law: str, folder: Path, logs: tuple[Log, Log]
) -> None:
    """In open loop and over windows of an unseen log, against those of rotating joints."""
    robot = Robot(RobotDescription.read(folder / "robot.toml"))
    body = identify([logs[0]], robot)
    records, unseen = (friction_records(log, robot, body) for log in logs)
    errors = []
    for sliding in (True, False):
        model = fit(law, [replace(r, sliding=sliding) for r in records])
        own = Simulator(robot=robot, parameters=body.parameters, model=model)
        found = [
            position_errors(own.run(windows), windows)[0]
            for windows in (to_single_window(unseen), cut_windows([unseen], 0.2))
        ]
        errors.append(np.array(found, dtype=float))
    assert np.all(errors[0] <= 0.8 * errors[1]), errors
