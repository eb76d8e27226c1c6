"""Servo and friction from commands and positions: fits, scale, intervals, FMU and sentences."""

import json
from pathlib import Path

import numpy as np
import pytest
from hobby_servo import draw_hobby_servo, run_along, write_robot
from industrial_joint import draw_industrial_joint
from small_study import Hesr, hesr_here

import hesr
from cosim.servo.engine import JointEngine
from cosim.servo.fit import JointProblem
from cosim.servo.interval import compute_interval
from cosim.servo.motion import predict_motion, run_plant
from cosim.servo.record import read_servo_records
from cosim.servo.start import find_start
from hesr_model.errors import ExportError, FitError, LogError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.servo import JointServo
from hesr_model.logs.robot_log import Log

SEED = 3  # a draw at 200 Hz
RATE = 100.0


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def lever(tmp_path_factory: pytest.TempPathFactory):
    """Return a draw of a hobby servo with its folder and log."""
    folder = tmp_path_factory.mktemp("lever")
    draw = draw_hobby_servo(folder, SEED, rate=RATE)
    draw.write_log(folder / "log.csv")
    return folder, draw


@pytest.fixture(scope="module")
def law_file(lever) -> Path:
    folder, _ = lever
    hesr.fit(
        folder / "log.csv",
        robot=folder / "robot.toml",
        law="coulomb_viscous",
        output=folder / "law.json",
    )
    return folder / "law.json"


def test_servo_armature_and_friction_are_found(lever, law_file: Path) -> None:
    _, draw = lever
    model = hesr.FrictionModel.read(law_file)
    [fitted] = model.servos
    servo = fitted.servo
    assert fitted.scale == "gravity"
    assert servo.kp == pytest.approx(draw.servo.kp[0], rel=0.01)
    assert servo.armature == pytest.approx(draw.armature, rel=0.02)
    assert servo.latency == pytest.approx(draw.servo.latency, abs=5e-4)
    truth = draw.law.values
    speeds = np.linspace(0.05, 2.5, 50)
    true_curve = truth["F_c"] + truth["sigma_2"] * speeds
    found = model.laws[0].values
    curve = found["F_c"] + found["sigma_2"] * speeds
    error = np.abs(curve - true_curve) / np.ptp(true_curve)
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.9) < 0.02
    step = 2.0 * np.pi / 4096
    assert fitted.position_rmse < 1.3 * step / np.sqrt(12.0)
    assert fitted.ideal_rmse > 5.0 * fitted.position_rmse


def test_all_torques_times_one_factor_move_nothing(lever) -> None:
    _, draw = lever
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    [[record]] = read_servo_records([log], draw.robot, draw.robot.nominal_parameters)
    servo = JointServo(
        kp=draw.servo.kp[0], kd=0.1, ki=0.3, armature=draw.armature, torque_limit=2.0, latency=0.01
    )
    values = dict(draw.law.values)
    with JointEngine(draw.law) as engine:
        one = engine.run(record, servo, values)
        other = engine.run(record, servo.scale(1.37), {k: 1.37 * x for k, x in values.items()})
    assert np.ptp(one) > 0.5
    assert np.max(np.abs(one - other)) < 1e-12


def test_the_start_of_a_fit_is_close(lever) -> None:
    _, draw = lever
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    [records] = read_servo_records([log], draw.robot, draw.robot.nominal_parameters)
    start = find_start(records)
    assert 1.0 / start.body == pytest.approx(draw.servo.kp[0], rel=0.3)
    assert start.latency == pytest.approx(draw.servo.latency + 0.5 / RATE, abs=0.01)


def test_a_fit_repeats_to_the_bit(lever) -> None:
    _, draw = lever
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot).rows(slice(0, 1500))
    [records] = read_servo_records([log], draw.robot, draw.robot.nominal_parameters)
    fits = []
    for _ in range(2):
        with JointProblem(records, estimator("coulomb_viscous")) as problem:
            fits.append(problem.fit())
    assert np.array_equal(fits[0].values, fits[1].values)
    interval = compute_interval(fits[0])
    value, error = interval.find("latency")
    assert 0.0 < error < 1e-3
    assert interval.find("torque_limit") == (0.0, np.inf)
    assert value == fits[0].values[fits[0].names.index("latency")]


def test_a_stated_gain_fixes_the_scale(tmp_path: Path) -> None:
    draw = draw_hobby_servo(tmp_path, SEED, rate=RATE, seconds=20.0)
    log = draw.write_log(tmp_path / "log.csv")
    gain = draw.servo.kp[0]
    robot = tmp_path / "robot.toml"
    stated = f"[servo]\nkp = {gain}\ngain_error = 0.02\n[log.columns]"
    robot.write_text(robot.read_text().replace("[log.columns]", stated))
    [fitted] = hesr.fit(log, robot=robot, law="coulomb_viscous").servos
    assert fitted.scale == "gain"
    assert fitted.servo.kp == gain
    assert fitted.servo.armature == pytest.approx(draw.armature, rel=0.03)


def test_a_gain_that_contradicts_gravity_is_said_and_kept(tmp_path: Path) -> None:
    draw = draw_hobby_servo(tmp_path, SEED, rate=RATE, seconds=20.0, extra="[servo]\nkp = 80.0")
    log = draw.write_log(tmp_path / "log.csv")
    model = hesr.fit(log, robot=tmp_path / "robot.toml", law="coulomb_viscous")
    assert model.servos[0].servo.kp == 80.0
    said = " ".join(model.provenance["from_commands"])
    assert "disagree by a factor" in said


def test_without_a_scale_the_law_is_in_units_of_the_gain(tmp_path: Path, cli: Hesr) -> None:
    draw = draw_hobby_servo(tmp_path, SEED, rate=RATE, seconds=20.0)
    log = draw.write_log(tmp_path / "log.csv")
    robot = write_robot(tmp_path, 0.3, 0.0)  # gravity does nothing
    law = tmp_path / "law.json"
    model = hesr.fit(log, robot=robot, law="coulomb_viscous", output=law)
    [fitted] = model.servos
    assert fitted.scale == "none"
    assert fitted.servo.kp == 1.0
    assert "up to one factor" in " ".join(model.provenance["from_commands"])
    said = cli("export", law, "-o", tmp_path / "friction.fmu")
    assert said.code == 2
    assert "servo.kp" in said.err
    assert not (tmp_path / "friction.fmu").exists()
    with pytest.raises(ExportError, match=r"servo\.kp"):
        predict_motion(model, draw.robot, Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd))


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_plant_turns_commands_into_the_predicted_motion(lever, law_file: Path, fmi) -> None:
    folder, draw = lever
    plant = hesr.export(
        law_file,
        folder / f"plant{fmi}.fmu",
        format="plant",
        robot=folder / "robot.toml",
        fmi=fmi,
    )
    log = Log.read(folder / "log.csv", folder / "robot.toml")
    predicted = predict_motion(hesr.FrictionModel.read(law_file), draw.robot, log)
    assert np.max(np.abs(run_plant(plant, log) - predicted)) < 1e-9
    along = run_along(plant, draw.t, draw.q_cmd, {"q_start[1]": float(draw.q[0])})
    assert np.max(np.abs(along - predicted[:, 0])) < 1e-9
    assert np.sqrt(np.mean((predicted[:, 0] - draw.exact) ** 2)) < 2e-3


def test_the_command_prints_servo_scale_and_error(lever, cli: Hesr) -> None:
    folder, _ = lever
    arguments = [folder / "log.csv", "--robot", folder / "robot.toml"]
    said = cli("fit", *arguments, "--law", "bam_m1", "-o", folder / "bam.json")
    assert said.code == 0, said.err
    for part in ("gain ", "delay ", "scale from gravity", "of an ideal servo"):
        assert part in said.out
    data = json.loads((folder / "bam.json").read_text())
    assert data["joints"][0]["servos"]["scale"] == "gravity"


def test_other_commands_and_laws_say_what_is_missing(lever, cli: Hesr) -> None:
    folder, draw = lever
    robot = folder / "robot.toml"
    said = cli("inspect", folder / "log.csv", "--robot", robot, "--torque-constants")
    assert said.code == 2
    assert "has no torque" in said.err
    with pytest.raises(FitError, match="has memory"):
        hesr.fit(folder / "log.csv", robot=folder / "robot.toml", law="lugre")
    with pytest.raises(LogError, match="neither 'tau' nor 'q_cmd'"):
        Log(t=draw.t, q=draw.q)
    torque_log = Log(t=draw.t + 1.0, q=draw.q, q_cmd=draw.q_cmd, tau=draw.q, robot=draw.robot)
    bare_log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    with pytest.raises(LogError, match="logs of one kind"):
        hesr.fit([torque_log, bare_log], law="coulomb_viscous")


def test_what_needs_torques_says_so_in_one_sentence(lever) -> None:
    _, draw = lever
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    with_torque = Log(t=draw.t, q=draw.q, tau=draw.q, robot=draw.robot)
    body = hesr.identify(with_torque, body="nominal", accept=["torque-signal", "torque-small"])
    with pytest.raises(LogError, match="has no torque"):
        body.separate_friction(log)
    with pytest.raises(LogError, match="has no torque"):
        hesr.FrictionRegressor(law="coulomb_viscous", robot=draw.robot).fit([log])


def test_commands_of_another_motion_explain_nothing(tmp_path: Path) -> None:
    draw = draw_hobby_servo(tmp_path, SEED, rate=RATE, seconds=20.0)
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd[::-1].copy(), robot=draw.robot)
    with pytest.raises(FitError, match="do not explain"):
        hesr.fit(log, law="coulomb_viscous")


def test_a_slow_filter_of_commands_is_no_friction(tmp_path: Path) -> None:
    draw = draw_hobby_servo(tmp_path, SEED, rate=RATE, seconds=20.0, command_filter=0.2)
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    model = hesr.fit(log, law="coulomb_viscous")
    assert model.servos[0].servo.command_filter == pytest.approx(0.2, rel=0.01)
    for name in ("F_c", "sigma_2"):
        assert model.laws[0].values[name] == pytest.approx(draw.law.values[name], rel=0.05)


def test_the_gains_of_a_pid_are_found(tmp_path: Path) -> None:
    draw = draw_industrial_joint(tmp_path, 3, seconds=6.0)  # its smoothed log begins in motion
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    [fitted] = hesr.fit(log, law="coulomb_viscous").servos
    assert fitted.position_rmse < 1.3 * draw.step / np.sqrt(12.0)
    for name in ("kp", "ki", "kd"):
        assert getattr(fitted.servo, name) == pytest.approx(getattr(draw, name), rel=0.015)


def test_a_body_is_identified_from_commands(lever, cli: Hesr) -> None:
    folder, draw = lever
    body_file = folder / "body.json"
    robot = folder / "robot.toml"
    said = cli("identify", folder / "log.csv", "--robot", robot, "-o", body_file)
    assert said.code == 0, said.err
    assert "scale from gravity" in said.out
    body = hesr.RigidBody.read(body_file)
    parameters = dict(zip(body.names, body.parameters, strict=True))
    assert parameters["joint1.Ir"] == pytest.approx(draw.armature, rel=0.02)
    assert body.friction[0, 0] == pytest.approx(draw.law.values["F_c"], rel=0.02)
    refused = cli("identify", folder / "log.csv", "--robot", robot, "--method", "paper")
    assert refused.code == 2
    assert "no torque" in refused.err


def test_no_body_is_identified_without_a_scale(tmp_path: Path, cli: Hesr) -> None:
    draw = draw_hobby_servo(tmp_path, SEED, rate=RATE, seconds=20.0, is_vertical=True)
    log = draw.write_log(tmp_path / "log.csv")
    said = cli("identify", log, "--robot", tmp_path / "robot.toml", "-o", tmp_path / "body.json")
    assert said.code == 2
    assert "up to one factor" in said.err
    assert not (tmp_path / "body.json").exists()
