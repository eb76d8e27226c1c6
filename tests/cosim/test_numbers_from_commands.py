"""Numbers for simulators of laws from commands: servo, price in positions, and refusals."""

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from hobby_servo import HobbyServo, draw_hobby_servo, write_robot
from small_study import Hesr, hesr_here

import hesr
from hesr_model.logs.robot_log import Log

RATE = 100.0
SPLIT = 1395  # rows of the fit; the lever rests there

Lever = tuple[Path, HobbyServo, Log, Log]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def lever(tmp_path_factory: pytest.TempPathFactory) -> Lever:
    """Return a lever with Stribeck friction, its fitted law, and logs to fit and to judge."""
    folder = tmp_path_factory.mktemp("lever")
    draw = draw_hobby_servo(folder, 3, rate=RATE, seconds=20.0, law_name="stribeck")
    draw.write_log(folder / "log.csv")
    whole = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    training = whole.rows(slice(0, SPLIT))
    test = whole.rows(slice(SPLIT, None))
    hesr.fit(training, law="stribeck", output=folder / "law.json")
    return folder, draw, training, test


def write_mjcf(folder: Path) -> Path:
    """Write the lever of the URDF as an MJCF, with a servo of other gains."""
    inertial = ET.parse(folder / "lever.urdf").find("link/inertial")
    mass = inertial.find("mass").get("value")
    centre = inertial.find("origin").get("xyz")
    path = folder / "lever.xml"
    path.write_text(
        f"""<mujoco><option timestep="0.002"/><worldbody><body>
        <inertial pos="{centre}" mass="{mass}" diaginertia="1e-5 1e-5 1e-5"/>
        <joint name="joint1" axis='0 1 0'/></body></worldbody>
        <actuator><position joint="joint1" kp="1"/></actuator></mujoco>""",
        encoding="utf-8",
    )
    return path


def simulate_copy(path: Path, log: Log, delay: float) -> np.ndarray:
    """Return the positions of the whole model along the commands of a log with even rows."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0] = log.q[0, 0]
    step = model.opt.timestep
    count = round(1.0 / RATE / step)
    positions = [data.qpos[0]]
    for k in range((len(log.t) - 1) * count):
        row = max(0, int(np.floor(((k + 0.5) * step - delay) * RATE + 1e-9)))
        data.ctrl[0] = log.q_cmd[row, 0]
        mujoco.mj_step(model, data)
        if (k + 1) % count == 0:
            positions.append(data.qpos[0])
    return np.array(positions)


def test_the_price_is_that_of_the_written_file(lever: Lever) -> None:
    """MuJoCo simulates the copy of the model, whose torques and positions are judged again."""
    folder, _, training, test = lever
    output = folder / "copy.xml"
    hesr.export(
        folder / "law.json",
        output,
        format="mjcf-joint",
        robot=folder / "robot.toml",
        log=training,
        test_log=test,
        into=write_mjcf(folder),
    )
    text = output.read_text(encoding="utf-8")
    [(law_rmse, rmse, soft_rmse)] = re.findall(
        r"position RMSE .* (\S+) mrad .* law, (\S+) with .*, (\S+) in MuJoCo", text
    )
    model = hesr.FrictionModel.read(folder / "law.json")
    delay = model.servos[0].servo.latency
    reached = simulate_copy(output, test, delay)
    recomputed = 1e3 * np.sqrt(np.mean((reached - test.q[:, 0]) ** 2))
    assert recomputed == pytest.approx(float(soft_rmse), rel=0.03)
    assert float(law_rmse) < float(rmse) < float(soft_rmse)
    joint = ET.parse(output).find(".//worldbody//joint")
    numbers = [float(joint.get(name)) for name in ("frictionloss", "damping")]
    [(torque_rmse, unit)] = re.findall(r"joint1: (\S+) (\S+), .*; speeds of", text)
    assert unit == "N.m"
    law = model.laws[0].values
    [(slowest, fastest)] = re.findall(r"speeds of (\S+) to (\S+) rad/s", text)
    speeds = np.linspace(float(slowest), float(fastest), 2000)
    stribeck = law["F_c"] + (law["F_s"] - law["F_c"]) * np.exp(-((speeds / law["v_s"]) ** 2))
    differences = numbers[0] + numbers[1] * speeds - stribeck - law["sigma_2"] * speeds
    assert np.min(np.abs(differences)) < float(torque_rmse) < np.max(np.abs(differences))


def test_each_format_has_the_servo(lever: Lever) -> None:
    folder, _, training, _ = lever
    fitted = hesr.FrictionModel.read(folder / "law.json").servos[0].servo
    steps = round(fitted.latency / 0.002)
    for name, suffix, part in (
        ("mjcf-joint", "xml", f'kp="{fitted.kp:.6g}" kv="0"'),
        ("urdf-dynamics", "urdf", f"kp {fitted.kp:.4g}"),
        ("sdf-dynamics", "sdf", f"kp {fitted.kp:.4g}"),
        ("isaaclab", "py", f'stiffness={{\n        "joint1": {fitted.kp:.6g}'),
        ("newton", "py", f'"joint_target_ke": {fitted.kp:.6g}'),
    ):
        output = folder / f"{name}.{suffix}"
        hesr.export(
            folder / "law.json",
            output,
            format=name,
            robot=folder / "robot.toml",
            log=training.rows(slice(0, 600)),
        )
        text = output.read_text(encoding="utf-8")
        assert part in text
        assert f"({steps} steps of 2 ms)" in text
        assert f"{fitted.armature:.6g}" in text


def test_a_joint_that_the_model_lacks_is_refused(lever: Lever, cli: Hesr) -> None:
    folder, *_ = lever
    other = folder / "other.urdf"
    other.write_text('<robot name="a"><joint name="elbow" type="revolute"/></robot>')
    call = ["export", folder / "law.json", "--robot", folder / "robot.toml"]
    call += ["--log", folder / "log.csv", "-o", folder / "out.urdf", "--into", other]
    said = cli(*call, "--format", "urdf-dynamics")
    assert said.code == 2
    assert "has no joint 'joint1'" in said.err
    assert not (folder / "out.urdf").exists()
    call[-3] = folder / "out.py"
    said = cli(*call, "--format", "newton")
    assert said.code == 2
    assert "--into needs --format mjcf-joint" in said.err


def test_numbers_without_a_scale_are_refused(tmp_path: Path, cli: Hesr) -> None:
    draw = draw_hobby_servo(tmp_path, 3, rate=RATE, seconds=12.0)
    log = draw.write_log(tmp_path / "log.csv")
    robot = write_robot(tmp_path, 0.3, 0.0)  # gravity does nothing
    law = tmp_path / "law.json"
    hesr.fit(log, robot=robot, law="coulomb_viscous", output=law)
    for name, suffix in (("mjcf-joint", "xml"), ("newton", "py")):
        output = tmp_path / f"out.{suffix}"
        said = cli("export", law, "--format", name, "--robot", robot, "--log", log, "-o", output)
        assert said.code == 2
        assert "nothing fixes the size" in said.err
        assert not output.exists()


def test_a_law_of_torques_has_a_price_in_positions(lever: Lever, cli: Hesr) -> None:
    """Under a stated gain the numbers of Coulomb and viscous friction move a joint as the law."""
    folder, draw, *_ = lever
    t = np.arange(0.0, 12.0, 0.01)
    q = np.column_stack([0.6 * np.sin(1.3 * t) + 0.3 * np.sin(3.1 * t)])
    dq = np.gradient(q[:, 0], t)
    inertial = np.gradient(dq, t)
    mass = float(ET.parse(folder / "lever.urdf").find("link/inertial/mass").get("value"))
    centre = float(
        ET.parse(folder / "lever.urdf").find("link/inertial/origin").get("xyz").split()[2]
    )
    body = mass * centre**2 * inertial - mass * 9.81 * centre * np.sin(q[:, 0])
    tau = body + 0.3 * np.sign(dq) + 0.2 * np.exp(-((dq / 0.2) ** 2)) * np.sign(dq) + 0.1 * dq
    log = Log(t=t, q=q, tau=tau[:, None], robot=draw.robot)
    identified = hesr.identify(log, body="nominal")
    model = hesr.fit(log, law="stribeck", rigid_body=identified)
    differences = {}
    for gain in (20.0, 200.0):
        output = folder / f"torque_{gain:g}.xml"
        hesr.export(
            model,
            output,
            format="mjcf-joint",
            robot=draw.robot,
            rigid_body=identified,
            log=log,
            kp=gain,
        )
        [(numbers, soft)] = re.findall(
            rf"a servo of {gain:g} N.m/rad .* it (\S+) mrad .*, (\S+) in MuJoCo",
            output.read_text(encoding="utf-8"),
        )
        differences[gain] = float(numbers)
        assert 0.0 < float(numbers) < 3.0 * float(soft)
    assert 5.0 * differences[200.0] < differences[20.0] < 20.0 * differences[200.0]
