"""Motors coupled to several joints: description, logs, rigid body, friction and files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import ArtifactError, ConfigError, RobotError
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import find_excess
from hesr_model.health.evidence import ModelTorques, smooth_parts, to_logged_side
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import identify_motions
from hesr_model.rigid_body.residual import friction_records, transform_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Coupling, Transmission

MATRIX = ((50.0, 0.0, 0.0), (0.0, -80.0, 0.0), (0.0, 40.0, 40.0))
"""Motor 2 turns against its joint; motor 3 also turns with joint 2."""
C = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 1.0]])

TOML = """
name = "arm"
model = "arm.xml"
joints = ["j1", "j2", "j3"]
[transmission]
"""


@pytest.fixture
def coupled(arm: RobotDescription) -> RobotDescription:
    return RobotDescription(**{**dict(arm), "transmission": Transmission(matrix=MATRIX)})


@pytest.fixture
def coupled_model(coupled: RobotDescription) -> Robot:
    return Robot(coupled)


def rubbed(motion: Motion, model: Robot) -> Motion:
    """The motion with rotors and motor friction, by virtual work."""
    tau = model.torque(model.nominal_parameters, motion.q, motion.dq, motion.ddq)
    du = motion.dq @ C.T
    return replace(motion, tau=tau + (3.0 * np.sign(du) + 1.5 * du) @ C)


def test_friction_coordinates_keep_the_joint_scale(coupled: RobotDescription) -> None:
    assert coupled.gear_ratio == (50.0, 80.0, 40.0)
    assert coupled.coupling is not None
    assert np.array_equal(coupled.coupling.forward, C)
    mixed = Transmission(matrix=MATRIX, friction=("motor", "motor", "joint"))
    assert np.array_equal(mixed.coordinates, np.eye(3))
    assert np.array_equal(mixed.motors, C)
    plain = Transmission(matrix=((50.0, 0.0), (0.0, -80.0)))
    assert Coupling.from_matrix(plain.coordinates) is None


def test_power_is_the_same_on_both_sides() -> None:
    coupling = Coupling(tuple(map(tuple, C)))
    dq, tau = np.random.default_rng(0).normal(size=(2, 5, 3))
    at_motors = np.sum(coupling.motion(dq) * coupling.torque(tau), axis=1)
    np.testing.assert_allclose(at_motors, np.sum(dq * tau, axis=1), rtol=1e-12)
    np.testing.assert_allclose(coupling.to_joints(coupling.torque(tau)), tau, rtol=1e-12)


def test_rotors_turn_with_the_motors(coupled_model: Robot) -> None:
    rng = np.random.default_rng(1)
    q, dq, ddq = rng.uniform(-1, 1, (3, 4, 3))
    nothing = np.zeros(len(coupled_model.parameter_names))
    inertia = np.array([0.4, 0.3, 0.1])
    nothing[-3:] = inertia
    expected = ddq @ C.T @ np.diag(inertia) @ C
    found = coupled_model.torque(nothing, q, dq, ddq)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_motor_logs_convert_to_joint_logs(
    coupled: RobotDescription, arm_log: Log, tmp_path: Path
) -> None:
    r, zero = np.array(MATRIX), np.array([0.1, -0.2, 0.3])
    assert arm_log.dq is not None
    motors = replace(
        arm_log, q=(arm_log.q - zero) @ r.T, dq=arm_log.dq @ r.T, tau=arm_log.tau @ np.linalg.inv(r)
    )
    motors.write(tmp_path / "motors.csv")
    side = Transmission(matrix=MATRIX, logs="motor")
    robot = coupled.model_copy(
        update={
            "transmission": side,
            "log": coupled.log.model_copy(update={"zero": tuple(zero.tolist())}),
        }
    )
    read = Log.read(tmp_path / "motors.csv", robot)
    assert read.dq is not None
    for found, expected in ((read.q, arm_log.q), (read.dq, arm_log.dq), (read.tau, arm_log.tau)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    [part] = smooth_parts(read, 15.0)
    torques = ModelTorques.from_motion(Robot(robot), part.q, part.v, part.a)
    logged, _ = to_logged_side(part, torques, robot.logged)
    np.testing.assert_allclose(logged.v, part.v @ C.T, atol=1e-12)
    assert coupled.logged is None


def test_motor_friction_is_identified_at_the_motors(coupled_model: Robot, make_motion) -> None:
    motion = rubbed(make_motion(seconds=20.0), coupled_model)
    body = identify_motions([motion], coupled_model)
    np.testing.assert_allclose(body.friction[:, :2], [[3.0, 1.5]] * 3, atol=1e-6)
    log = Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau)
    records = friction_records(log, coupled_model, body)
    for record in transform_records(records):
        moving = np.abs(record.dq) > 0.2
        expected = 3.0 * np.sign(record.dq) + 1.5 * record.dq
        assert np.sqrt(np.mean((record.tau - expected)[moving] ** 2)) < 0.1
    model = fit("stribeck", records)
    assert model.coupling == records[0].coupling
    predicted, measured = model.predict(records), np.column_stack([r.tau for r in records])
    fast = np.min(np.abs(motion.dq @ C.T), axis=1) > 0.2
    assert np.sqrt(np.mean((predicted - measured)[fast] ** 2)) < 0.1
    arrays = {
        name: np.column_stack([getattr(r, name) for r in records])
        for name in ("dq", "q", "tau_load")
    }
    np.testing.assert_allclose(model.predict(t=motion.t, **arrays), predicted, atol=1e-9)
    # One law per joint cannot describe it: joint 2 then sees the friction of two motors.
    alone = fit("stribeck", [replace(r, coupling=None) for r in records])
    error = alone.predict([replace(r, coupling=None) for r in records]) - measured
    assert np.sqrt(np.mean(error[:, 1] ** 2)) > 4 * np.sqrt(
        np.mean((predicted - measured)[:, 1] ** 2)
    )
    moved = transform_records(records)
    assert not any(find_excess(seen, [r]) for seen, r in zip(model.trained, moved, strict=True))


def test_the_papers_method_averages_at_the_motors(coupled_model: Robot, make_motion) -> None:
    forward = rubbed(make_motion(), coupled_model)
    backward = rubbed(make_motion(reverse=True), coupled_model)
    body = identify_motions([forward], coupled_model, method="paper", reversed_motions=[backward])
    expected = coupled_model.torque(
        coupled_model.nominal_parameters, forward.q, forward.dq, forward.ddq
    )
    found = body.torque(coupled_model, forward)
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.05


def test_a_model_file_keeps_the_coupling(coupled_model, make_motion, tmp_path: Path) -> None:
    motion = rubbed(make_motion(), coupled_model)
    body = identify_motions([motion], coupled_model)
    log = Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau)
    model = fit("stribeck", friction_records(log, coupled_model, body))
    path = tmp_path / "law.json"
    model.write(path)
    assert FrictionModel.read(path).coupling == model.coupling
    path.write_text(path.read_text().replace('"matrix": [', '"matrix": [[1.0, 2.0],'))
    with pytest.raises(ArtifactError, match="must be a regular square matrix"):
        FrictionModel.read(path)


def test_a_coupling_of_other_joints_is_refused(table1: FrictionModel) -> None:
    with pytest.raises(ArtifactError, match="a coupling of 2 joints for"):
        replace(table1, coupling=Coupling(((1.0, 0.0), (1.0, 1.0))))


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("matrix = [[50.0, 0.0], [0.0, 1.0, 2.0]]", "has 2 rows; each needs 2 entries"),
        ("matrix = [[50.0, 0.0], [1.0, 0.0]]", "the gear ratio of motor 2"),
        ("matrix = [[5.0, 5.0], [1.0, 1.0]]", "is singular"),
        ("matrix = [[5.0]]\nfriction = ['motor', 'joint']", "'friction' has 2 entries"),
        ("matrix = [[5.0]]\nlogs = 'gear'", "'motor' or 'joint'"),
    ],
)
def test_invalid_transmissions_are_refused(
    table: str, sentence: str, arm: RobotDescription, tmp_path: Path
) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(TOML + table)
    with pytest.raises(ConfigError, match=sentence):
        RobotDescription.read(path)


def test_a_transmission_needs_a_motor_per_joint(arm: RobotDescription, tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(TOML + "matrix = [[50.0]]")
    with pytest.raises(RobotError, match=r"key 'transmission.matrix' .* has 1 entries"):
        RobotDescription.read(path)
    path.write_text(
        TOML.replace("[trans", "gear_ratio = [1.0, 2.0, 3.0]\n[trans")
        + f"matrix = {[list(row) for row in MATRIX]}"
    )
    with pytest.raises(ConfigError, match="'gear_ratio' contradicts the diagonal"):
        RobotDescription.read(path)


def test_sliding_and_revolute_joints_cannot_be_coupled() -> None:
    transmission = Transmission(matrix=((50.0, 0.0), (3.0, 50.0)))
    transmission.require_turning(["a", "b"], [False, False])
    with pytest.raises(RobotError, match="joint 'b' to joint 'a'"):
        transmission.require_turning(["a", "b"], [True, False])
