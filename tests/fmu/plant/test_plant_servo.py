"""Servo of a plant: rest, latency, limits, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from plant_robots import UF850, chain, coupled
from plant_runs import content_of
from registry_models import everyday
from scipy.spatial.transform import Rotation

from fmu_src.check.run import check
from fmu_src.export.package import write_fmu
from fmu_src.plant.plant_fmu import SUBSTEP, PlantBody, export_plant
from fmu_src.plant.servo import COMMANDS, ServoGains
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import ArgumentError, ExportError, SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot

KV, KI = (90.5, 150.8, 52.8), (905.0, 1508.0, 528.0)
STEP = 0.005
POSTURE = {"q_start[1]": 0.3, "q_start[2]": 0.5, "q_start[3]": -1.2}
PAYLOAD = {"payload.m": 2.0, "payload.com[3]": 0.1}

Array = np.ndarray


@pytest.fixture(scope="module")
def servo_arm(table1: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("servo") / "Arm.fmu"
    return export_plant(table1, path, plant_body=PlantBody.from_robot(Robot(UF850)), kv=KV, ki=KI)


def driven(
    fmu: Path, kind: str, commands: Array, outputs: tuple[str, ...], step: float, **start: float
) -> Array:
    """Return outputs (K + 1, 3 each) under commands (K, 3) of a kind, each held for a step."""
    rows = []
    with FmuInstance(fmu) as arm:
        zeros = {f"{name}[{i}]": 0.0 for name in ("tau", "dq_cmd") for i in (1, 2, 3)}
        arm.initialise(start=zeros | POSTURE | start)
        names = [f"{name}[{i}]" for name in outputs for i in (1, 2, 3)]
        rows.append(arm.get(names))
        for k, command in enumerate(commands):
            arm.set({f"{kind}[{i + 1}]": float(x) for i, x in enumerate(command)})
            arm.step(k * step, step)
            rows.append(arm.get(names))
    return np.array(rows)


def run(fmu: Path, commands: Array, outputs: str = "q", **start: float) -> Array:
    """Return an output (K + 1, 3) under speed commands (K, 3)."""
    return driven(fmu, "dq_cmd", commands, (outputs,), STEP, **start)


def wave(count: int) -> Array:
    return 0.5 * np.sin(2 * np.pi * 0.5 * STEP * np.arange(count))[:, None] * np.ones(3)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_an_arm_starts_at_rest(share: float, servo_arm: Path) -> None:
    """The integral holds what is not compensated; compensation includes the payload."""
    start = PAYLOAD | {f"gravity_share[{i}]": share for i in (1, 2, 3)}
    q = run(servo_arm, np.zeros((200, 3)), **start)
    np.testing.assert_allclose(q, np.tile(q[0], (201, 1)), atol=1e-12)
    torque = run(servo_arm, np.zeros((1, 3)), "tau_motor", **start)
    load = run(servo_arm, np.zeros((1, 3)), "tau_load", **start)
    friction = run(servo_arm, np.zeros((1, 3)), "tau_friction", **start)
    np.testing.assert_allclose(torque, load + friction, atol=1e-9)
    assert np.abs(load).max() > 10.0


def test_friction_at_the_start_sees_the_load(make_law, tmp_path: Path) -> None:
    """For a law without states, which nothing but the load and the motion determine."""
    robot = Robot(chain(tmp_path, 3))
    servo = ServoGains(kv=(0.0,) * 3, ki=(90.0,) * 3)  # which holds the arm as it moves
    whole = content_of(robot, [make_law("viscous")] * 3, servo=servo)
    q, dq = np.array([0.4, -0.7, 0.9]), np.array([0.3, -0.2, 0.1])
    start = {f"q_start[{i + 1}]": float(q[i]) for i in range(3)}
    start |= {f"dq_start[{i + 1}]": float(dq[i]) for i in range(3)}
    with FmuInstance(write_fmu(whole, tmp_path / "Arm.fmu")) as arm:
        arm.initialise(start=start)
        friction, load = (
            np.array(arm.get([f"{name}[{i}]" for i in (1, 2, 3)]))
            for name in ("tau_friction", "tau_load")
        )
    assert np.abs(load).max() > 10.0
    expected = (4.5 + 0.1 * np.abs(load)) * np.sign(dq) + 12.0 * dq**3
    expected += 0.5 * np.cos(200.0 * q) ** 2
    np.testing.assert_allclose(friction, expected, rtol=1e-12)


LAWS = tuple(everyday())
GROUPS = [LAWS[k : k + 3] for k in range(0, len(LAWS) - 2, 3)] + [LAWS[-3:]]
AT_REST = {
    "all joints at 0": {},
    "gravity off": {f"gravity[{i}]": 0.0 for i in (1, 2, 3)},
    "one joint at 0": {"q_start[1]": 0.3, "q_start[2]": 0.0, "q_start[3]": -1.2},
    "a posture": POSTURE,
    "no compensation": {f"gravity_share[{i}]": 0.0 for i in (1, 2, 3)},
}


@pytest.mark.parametrize(
    "laws",
    [
        pytest.param(group, id=", ".join(group), marks=[pytest.mark.ci] * (k > 0))
        for k, group in enumerate(GROUPS)
    ],
)
def test_nothing_moves_where_the_servo_carries_all_torques(
    laws: tuple[str, ...], registry_models: dict[str, FrictionModel], tmp_path: Path
) -> None:
    """The torques of the balance vanish there, but not their round-off."""
    robot = Robot(UF850)
    model = FrictionModel(
        law="by_hand",
        robot=robot.name,
        joints=robot.joints,
        laws=tuple(registry_models[law].laws[0] for law in laws),
        sample_time=0.005,
    )
    body = PlantBody.from_robot(robot)
    fmu = export_plant(model, tmp_path / "Arm.fmu", plant_body=body, kv=KV, ki=KI, bare=True)
    names = [f"q[{i}]" for i in (1, 2, 3)]
    for posture, start in AT_REST.items():
        with FmuInstance(fmu) as arm:
            arm.initialise(start=start)
            first = np.array(arm.get(names))
            for k in range(40):
                arm.step(k * STEP, STEP)
            moved = np.abs(np.array(arm.get(names)) - first).max()
        assert moved < 1e-12, posture


def test_the_torque_is_that_of_both_gains(servo_arm: Path) -> None:
    """Its speed is that in the middle of an inner step, that of the output at its end."""
    commands = np.vstack([wave(150), np.zeros((600, 3))])
    names = ("q", "dq", "tau_motor", "tau_load")
    q, dq, motor, load = (run(servo_arm, commands, name) for name in names)
    behind = STEP * np.cumsum(commands, axis=0)[159:] - (q[160:] - q[0])
    expected = KI * behind - KV * dq[160:]
    found = (motor - load)[160:] - (motor - load)[0]
    assert np.median(np.abs(found - expected)) < 0.01 * np.abs(expected).max()
    assert np.abs(KI * behind).max() > 5.0
    assert np.abs(KV * dq[160:]).max() > 2.0


def test_commands_act_after_the_latency(servo_arm: Path) -> None:
    commands = wave(300)
    late = run(servo_arm, commands, latency=3 * STEP)
    shifted = run(servo_arm, np.vstack([np.zeros((3, 3)), commands[:-3]]))
    np.testing.assert_allclose(late, shifted, atol=1e-12)
    part = run(servo_arm, commands, latency=2.6 * STEP)
    assert 1e-4 < np.abs(part - late).max() < 0.01


KP = (12.0, 10.0, 15.0)


@pytest.fixture(scope="module")
def position_arm(table1: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("position") / "Arm.fmu"
    body = PlantBody.from_robot(Robot(UF850))
    return export_plant(table1, path, plant_body=body, kv=KV, ki=KI, kp=KP, tool=True)


def followed(fmu: Path, goals: Array, step: float = STEP, **start: float) -> Array:
    """Return positions, speeds and motor torques (K, 9) under position commands (K, 3)."""
    first = {f"q_cmd[{i}]": POSTURE[f"q_start[{i}]"] for i in (1, 2, 3)}
    outputs = ("q", "dq", "tau_motor")
    return driven(fmu, "q_cmd", goals, outputs, step, **first, **start)[1:]


def test_position_commands_are_followed(position_arm: Path) -> None:
    home = np.array(list(POSTURE.values()))
    rest = followed(position_arm, np.tile(home, (100, 1)))
    np.testing.assert_allclose(rest[:, :3], np.tile(home, (100, 1)), atol=1e-12)
    goals = np.tile(home + 0.1, (800, 1))
    late = followed(position_arm, goals, latency=2 * STEP)
    shifted = followed(position_arm, np.vstack([home, home, goals[:-2]]))
    np.testing.assert_allclose(late, shifted, atol=1e-9)
    found = followed(position_arm, goals)
    np.testing.assert_allclose(found[-1, :3], home + 0.1, atol=2e-3)  # friction holds it there


def test_the_torque_is_that_of_all_gains(position_arm: Path) -> None:
    home = np.array(list(POSTURE.values()))
    goals = home + 0.3 * (1.0 - np.cos(np.pi * SUBSTEP * np.arange(2000)))[:, None]
    share = {f"gravity_share[{i}]": 0.0 for i in (1, 2, 3)}
    q, dq, motor = np.split(followed(position_arm, goals, SUBSTEP, **share), 3, axis=1)
    speed = KP * (goals - q)
    behind = SUBSTEP * np.cumsum(speed, axis=0) - q
    expected = KV * (speed - dq) + KI * behind
    found, expected = motor[50:] - motor[50], expected[50:] - expected[50]
    assert np.median(np.abs(found - expected)) < 0.01 * np.abs(expected).max()
    assert np.abs(KV * speed).max() > 50.0


def test_the_tool_is_the_last_frame(position_arm: Path) -> None:
    robot = Robot(UF850)
    with FmuInstance(position_arm) as arm:
        arm.initialise(start=POSTURE)
        for k in range(20):
            arm.set({"dq_cmd[1]": 0.5, "dq_cmd[3]": -0.5})
            arm.step(k * STEP, STEP)
        q = np.array(arm.get([f"q[{i}]" for i in (1, 2, 3)]))
        origin = arm.get([f"tool_position[{k}]" for k in (1, 2, 3)])
        rotation = arm.get([f"tool_rotation[{k}]" for k in range(1, 10)])
    assert abs(q[0] - POSTURE["q_start[1]"]) > 1e-3
    at, turned = np.zeros(3), np.eye(3)
    for joint, angle in zip(robot.tree, q, strict=True):
        at, turned = at + turned @ joint.translation, turned @ joint.rotation
        turned = turned @ Rotation.from_rotvec(angle * np.asarray(joint.axis)).as_matrix()
    np.testing.assert_allclose(origin, at, atol=1e-12)
    np.testing.assert_allclose(np.reshape(rotation, (3, 3)), turned, atol=1e-12)


def test_a_position_servo_is_valid(position_arm: Path) -> None:
    assert check(position_arm).problems == ()


def test_torque_stays_within_its_limit(servo_arm: Path) -> None:
    limit = {f"torque_limit[{i}]": 20.0 for i in (1, 2, 3)}
    shares = {f"gravity_share[{i}]": 0.0 for i in (1, 2, 3)}
    torque = run(servo_arm, 3.0 * wave(200), "tau_motor", **limit, **shares)
    assert np.abs(torque).max() == 20.0


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        ({"servo_kv[2]": -1.0}, "servo_kv[2] is -1; it must not be negative."),
        ({"servo_ki[1]": -1.0}, "servo_ki[1] is -1; it must not be negative."),
        ({"torque_limit[3]": -1.0}, "torque_limit[3] is -1; it must not be negative."),
        ({"latency": -0.1}, "latency is -0.1; it must not be negative."),
        ({"latency": 10.0}, f"The latency of 10 s is longer than {COMMANDS} steps; take longer"),
    ],
)
def test_bad_parameters_are_refused(start, sentence: str, servo_arm: Path) -> None:
    with pytest.raises(SimulationError, match=re.escape(sentence)):
        run(servo_arm, wave(COMMANDS + 1), **start)


def test_bad_gains_are_refused(table1: FrictionModel, tmp_path: Path) -> None:
    body, path = PlantBody.from_robot(Robot(UF850)), tmp_path / "Arm.fmu"
    sentence = "plant: 'kv' of joint 2 is -1"
    with pytest.raises(ExportError, match=re.escape(sentence)):
        export_plant(table1, path, plant_body=body, kv=(1.0, -1.0, 1.0))
    sentence = "'ki' needs 'kv', the proportional"
    with pytest.raises(ArgumentError, match=re.escape(sentence)):
        export_plant(table1, path, plant_body=body, ki=KI)
    sentence = "'kp' needs 'kv', the proportional"
    with pytest.raises(ArgumentError, match=re.escape(sentence)):
        export_plant(table1, path, plant_body=body, kp=KP)


def test_the_file_is_valid(servo_arm: Path) -> None:
    assert check(servo_arm).problems == ()


@pytest.mark.ci
@pytest.mark.parametrize("fmi", [2, 3])
def test_servos_turn_coupled_motors(fmi, make_law, tmp_path: Path) -> None:
    robot = Robot(coupled(tmp_path))
    model = content_of(robot, [make_law("lugre")] * 6)
    assert model.table.places["tau[1]"] == 0
    servo = ServoGains(kv=(100.0,) * 6, ki=(1000.0,) * 6, kp=(5.0,) * 6)
    whole = content_of(robot, [make_law("lugre")] * 6, servo=servo, tool=True)
    path = write_fmu(whole, tmp_path / "Arm.fmu", fmi=fmi)
    assert check(path).problems == ()
    with FmuInstance(path) as arm:
        names = [f"{name}[{i}]" for name in ("tau", "dq_cmd") for i in range(1, 7)]
        arm.initialise(start=dict.fromkeys(names, 0.0))
        arm.set({"dq_cmd[5]": 0.3})
        for k in range(400):
            arm.set({"q_cmd[5]": 0.3 * (k + 1) * STEP})
            arm.step(k * STEP, STEP)
        found = arm.get([f"dq[{i}]" for i in range(1, 7)])
    np.testing.assert_allclose(found, [0.0, 0.0, 0.0, 0.0, 0.3, 0.0], atol=0.01)
