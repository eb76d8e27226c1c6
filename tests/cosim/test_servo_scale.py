"""What fixes the size of torques without a torque: stated gains, added inertia, and currents."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hobby_servo import HobbyServo, draw_current, draw_hobby_servo
from small_study import hesr_here

from cosim.servo.current import find_exponent
from cosim.servo.model import fit_from_commands
from cosim.servo.motion import predict_motion
from cosim.servo.record import find_encoder_step, read_servo_records
from cosim.servo.result import count_releases
from cosim.servo.scale import TorqueScale, find_shared_scale
from hesr_model.errors import ConfigError
from hesr_model.friction.model import FrictionModel
from hesr_model.health.joints import remove_joints
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.servo_description import ScaleDescription, ServoDescription

SO101 = Path(__file__).parents[3] / "shared" / "examples" / "so101"
CONSTANT = 1.7  # of the motor [N.m/A]
DISC = 0.02  # inertia of a disc [kg.m2]


@pytest.fixture(scope="module")
def turntable(tmp_path_factory: pytest.TempPathFactory) -> HobbyServo:
    """Return a draw of a servo whose axis is vertical."""
    folder = tmp_path_factory.mktemp("turntable")
    return draw_hobby_servo(folder, 3, rate=100.0, is_vertical=True)


def describe(draw: HobbyServo, **changes: object) -> Robot:
    """Return the robot of a draw with changes of its description."""
    return Robot(draw.robot.description.model_copy(update=changes))


def fit(draw: HobbyServo, robot: Robot, size: np.ndarray | None = None) -> FrictionModel:
    """Return the fit to the log of a draw, maybe with a current."""
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, current_size=size, robot=robot)
    return fit_from_commands([log], robot, "coulomb_viscous", workers=1)


def with_constant(draw: HobbyServo) -> Robot:
    log = draw.robot.description.log.model_copy(update={"torque_per_ampere": (CONSTANT,)})
    return describe(draw, log=log)


def test_nothing_fixes_the_size_about_a_vertical_axis(turntable: HobbyServo) -> None:
    model = fit(turntable, turntable.robot)
    assert model.servos[0].scale == "none"
    [values, scale, *bounds] = model.provenance["from_commands"]
    friction = turntable.law.values["F_c"] / turntable.servo.kp[0]
    assert "up to one factor" in scale
    assert float(scale.partition("friction is ")[2].split()[0]) > 1e3 * friction
    assert any("torque limit: at least" in bound for bound in bounds)
    assert "loop delay" in values


def test_a_motor_current_with_its_constant_fixes_the_size(turntable: HobbyServo) -> None:
    size = draw_current(turntable, 0, "motor", CONSTANT)
    model = fit(turntable, with_constant(turntable), size)
    [fitted] = model.servos
    assert fitted.scale == "current"
    assert fitted.servo.kp == pytest.approx(turntable.servo.kp[0], rel=0.02)
    assert model.laws[0].values["F_c"] == pytest.approx(turntable.law.values["F_c"], rel=0.03)
    assert abs(fitted.servo.kp - turntable.servo.kp[0]) < fitted.intervals["kp"]


@pytest.mark.parametrize("kind", ["supply", "neither"])
def test_other_currents_do_not_fix_it(turntable: HobbyServo, kind: str) -> None:
    size = draw_current(turntable, 0, kind, CONSTANT)
    model = fit(turntable, with_constant(turntable), size)
    without = fit(turntable, turntable.robot)
    assert model.servos[0].scale == "none"
    assert model.servos[0].intervals == without.servos[0].intervals
    said = {"supply": "that of the supply", "neither": "is not used"}[kind]
    assert said in model.provenance["from_commands"][-1]


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_the_exponent_of_a_current_is_found(exponent: float) -> None:
    generator = np.random.default_rng(0)
    error = generator.uniform(-0.1, 0.1, 500)
    speed = generator.uniform(-2.0, 2.0, 500)
    torque = np.abs(error - 0.01 * speed)
    size = 0.02 + torque * np.abs(error) ** (exponent - 1.0)
    assert find_exponent(error, speed, size) == pytest.approx(exponent, abs=0.06)
    assert np.isnan(find_exponent(error, speed, generator.uniform(size=500)))


def test_a_stated_gain_separates_links_and_armature(turntable: HobbyServo) -> None:
    stated = ServoDescription(kp=turntable.servo.kp[0])
    robot = describe(turntable, servo=stated)
    model = fit(turntable, robot)
    [fitted] = model.servos
    width = fitted.intervals["armature"]
    assert abs(fitted.servo.armature - turntable.armature) < width
    assert fitted.servo.armature == pytest.approx(turntable.armature, abs=1e-3)
    # The exported plant has links and armature, and moves as the fit does.
    log = Log(t=turntable.t, q=turntable.q, q_cmd=turntable.q_cmd, robot=robot)
    errors = predict_motion(model, robot, log) - log.q
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(fitted.position_rmse, rel=0.05)


def test_a_gain_withheld_is_found_and_one_given_is_kept(tmp_path: Path) -> None:
    draw = draw_hobby_servo(tmp_path, 3, rate=100.0, extra="[scale]\nbody_error = 0.01")
    true_gain = draw.servo.kp[0]
    withheld = fit(draw, draw.robot)
    given = fit(draw, describe(draw, servo=ServoDescription(kp=true_gain, gain_error=0.01)))
    found = withheld.servos[0]
    assert (found.scale, given.servos[0].scale) == ("gravity", "gain")
    assert abs(found.servo.kp - true_gain) < found.intervals["kp"]
    assert given.servos[0].servo.kp == true_gain
    assert not any("disagree" in text for text in given.provenance["from_commands"])
    for name, value in given.laws[0].values.items():
        ratio = withheld.laws[0].values[name] / found.servo.kp
        assert value / true_gain == pytest.approx(ratio, rel=1e-9)


def test_logs_with_and_without_a_disc_fix_the_size(turntable: HobbyServo, tmp_path: Path) -> None:
    with_disc = draw_hobby_servo(
        tmp_path, 3, rate=100.0, is_vertical=True, added_inertia=DISC, command_seed=8
    )
    scale = ScaleDescription(inertia_added={"disc": {"joint1": DISC}})
    robot = describe(turntable, scale=scale)
    logs = [
        Log(name=name, t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=robot)
        for name, draw in (("bare", turntable), ("disc", with_disc))
    ]
    model = fit_from_commands(logs, robot, "coulomb_viscous", workers=1)
    [fitted] = model.servos
    assert fitted.scale == "added inertia"
    assert fitted.servo.kp == pytest.approx(turntable.servo.kp[0], rel=0.03)
    assert abs(fitted.servo.kp - turntable.servo.kp[0]) < fitted.intervals["kp"]
    alone = fit_from_commands(logs[1:], robot, "coulomb_viscous", workers=1)
    assert alone.servos[0].scale == "none"
    assert any("a constant inertia" in text for text in alone.provenance["from_commands"])


def test_added_inertia_of_no_joint_is_refused(turntable: HobbyServo, tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    (tmp_path / "lever.urdf").write_bytes((turntable.robot.description.model).read_bytes())
    file.write_text(
        'name = "lever"\nmodel = "lever.urdf"\njoints = ["joint1"]\n'
        "[scale.inertia_added]\ndisc = {joint2 = 0.02}\n"
    )
    with pytest.raises(ConfigError, match="joint2") as refusal:
        RobotDescription.read(file)
    assert refusal.value.code == "robot.inertia_added"


def test_a_file_may_name_currents_without_a_sign(turntable: HobbyServo, tmp_path: Path) -> None:
    size = draw_current(turntable, 0, "motor", CONSTANT)
    rows = np.column_stack([turntable.t, turntable.q_cmd, turntable.q, 1e3 * size])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="t,q_cmd1,q1,mA1", comments="", fmt="%.9g")
    columns = turntable.robot.description.log.columns.model_copy(
        update={"current_size": "mA{}", "dq": ""}
    )
    units = turntable.robot.description.log.units.model_copy(update={"current": "mA"})
    log_format = turntable.robot.description.log.model_copy(
        update={"columns": columns, "units": units}
    )
    log = Log.read(path, describe(turntable, log=log_format))
    assert log.current_size is not None
    np.testing.assert_allclose(log.current_size[:, 0], size, atol=1e-6)
    assert not replace(log, name="copy").has_torque


def test_inspect_says_what_a_current_is(
    turntable: HobbyServo,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    size = draw_current(turntable, 0, "motor", CONSTANT)
    rows = np.column_stack([turntable.t, turntable.q_cmd, turntable.q, size])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,q_cmd1,q1,size1", comments="")
    model_file = turntable.robot.description.model
    (tmp_path / "lever.urdf").write_bytes(model_file.read_bytes())
    (tmp_path / "robot.toml").write_text(
        'name = "lever"\nmodel = "lever.urdf"\njoints = ["joint1"]\n'
        '[log.columns]\ndq = ""\ncurrent_size = "size{}"\n'
    )
    cli = hesr_here(capsys, monkeypatch)
    said = cli("inspect", tmp_path / "log.csv", "--robot", tmp_path / "robot.toml")
    assert said.code == 0, said.err
    assert "that of the motor" in said.out


def test_a_joint_that_is_shaken_loose_is_counted(turntable: HobbyServo) -> None:
    log = Log(t=turntable.t, q=turntable.q, q_cmd=turntable.q_cmd, robot=turntable.robot)
    [[record]] = read_servo_records([log], turntable.robot, turntable.robot.nominal_parameters)
    step = find_encoder_step([record])
    assert count_releases(record, step) == 0
    rested = np.where(record.t < 20.0, 0.0, 0.05 * np.minimum(record.t - 20.0, 0.5))
    shaken = step * np.round(rested / step)
    loose = replace(
        record, q=shaken, dq=np.gradient(rested, record.t), q_cmd=np.zeros_like(record.t)
    )
    assert count_releases(loose, step) == 1


def test_the_same_servos_share_a_size() -> None:
    known = [
        TorqueScale(source="gravity", gain=10.0, error=0.2, reference="body_factor"),
        TorqueScale(source="gravity", gain=12.0, error=0.2, reference="body_factor"),
    ]
    nothing = TorqueScale(source="none")
    shared = find_shared_scale([*known, nothing])
    assert shared is not None
    assert shared.gain == pytest.approx(np.sqrt(120.0))
    assert shared.error == pytest.approx(np.hypot(0.2, 0.5 * np.log(1.2)))
    assert find_shared_scale([nothing]) is None


@pytest.mark.nightly("real")
@pytest.mark.skipif(not SO101.is_dir(), reason="needs the logs in ../shared/examples")
def test_a_measured_arm_goes_from_log_to_plant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its current without a sign is no torque, and its first axis is vertical."""
    cli = hesr_here(capsys, monkeypatch)
    robot, study = tmp_path / "robot.toml", tmp_path / "study.toml"
    inspected = cli(
        "inspect", SO101 / "pick_place.csv.gz", "--robot", SO101 / "so101.urdf",
        "--write", robot, "--study", study,
    )  # fmt: skip
    assert inspected.code == 0, inspected.err
    assert "current_size" in robot.read_text()
    with robot.open("a") as file:
        file.write("[scale]\nsame_servos = true\n")
    said = cli("run", study, "--quick", "-o", tmp_path / "results")
    assert said.code == 0, said.err
    assert "scale from the other joints" in said.out
    assert (tmp_path / "results" / "fmus" / "Plant.fmu").exists()


def test_single_gains_may_be_free(turntable: HobbyServo, tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    (tmp_path / "lever.urdf").write_bytes(turntable.robot.description.model.read_bytes())
    text = 'name = "lever"\nmodel = "lever.urdf"\njoints = ["joint1"]\n[servo]\n'
    file.write_text(text + 'kp = ["free"]\ntorque_limit = 3.0\n')
    servo = RobotDescription.read(file).servo
    assert servo.find_stated("kp", 0, 1) is None
    assert servo.find_stated("torque_limit", 0, 1) == 3.0
    file.write_text(text + "kp = [12.0]\n")
    assert RobotDescription.read(file).servo.find_stated("kp", 0, 1) == 12.0
    assert RobotDescription.read(file).servo.find_stated("torque_limit", 0, 1) is None


def test_added_inertia_of_a_locked_joint_is_left_out(tmp_path: Path) -> None:
    scale = ScaleDescription(inertia_added={"disc": {"j1": DISC, "j2": DISC}})
    arm = RobotDescription(name="arm", model=Path("arm.urdf"), joints=("j1", "j2"), scale=scale)
    assert remove_joints(arm, {"j2": 0.0}).scale.inertia_added == {"disc": {"j1": DISC}}
