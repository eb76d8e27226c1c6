"""Servos identified from commands, and predicted following errors, against the digital twin."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.loop.excite import Recording, TwinArm, load_arm, record
from cosim.loop.traces import Following, FollowingError
from cosim.report.tables.loop import benefit
from cosim.study.scores import transpose_records
from fmu_src.arm.plant import Plant
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr.extras.studies.feed_forward import feed_forward, predict_following
from hesr_model.errors import ConfigError, FitError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.guess import guess_columns
from hesr_model.logs.robot_log import Log
from hesr_model.logs.tables import read_table
from hesr_model.motions.trajectories import random_fourier
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.rigid_body.servo import cascade, identify_servo
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Transmission
from hesr_model.support.arrays import Array
from hesr_model.support.files import models_folder

TWIN = models_folder() / "uf850"
KV, KI = (90.5, 150.8, 52.8), (905.0, 1508.0, 528.0)  # of uf850.xml


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(RobotDescription.read(TWIN / "robot.toml"))


@pytest.fixture(scope="module")
def arm() -> Iterator[TwinArm]:
    with load_arm(Plant.read(TWIN / "plant.toml")) as loaded:
        yield loaded


@pytest.fixture(scope="module")
def recorded(arm: TwinArm) -> Recording:
    return run(arm, 1, "commanded")


@pytest.fixture(scope="module")
def identified(arm: TwinArm, robot: Robot) -> tuple[RigidBody, FrictionModel]:
    logs = [run(arm, seed, f"training {seed}").log for seed in (3, 4)]
    body = identify(logs, robot)
    records = transpose_records([friction_records(log, robot, body) for log in logs])
    return body, fit_models(["lugre"], records, robot="uf850", seed=0, workers=1)["lugre"]


def run(arm: TwinArm, seed: int, name: str) -> Recording:
    motion = random_fourier(
        seed=seed,
        harmonics=5,
        period=20.0,
        peak_velocity=np.array([1.2, 1.0, 1.2]),
        offset=np.array([0.0, 0.3, -1.9]),
    )
    return record(arm, motion, seed, name=name)


def test_servo_of_the_twin(recorded: Recording, robot: Robot) -> None:
    found = identify_servo(recorded.log, robot, robot.nominal_parameters)
    kv, ki, kp = cascade(found.factors)
    np.testing.assert_allclose(kv, KV, rtol=0.05)
    np.testing.assert_allclose(ki, KI, rtol=0.05)
    np.testing.assert_array_equal(kp, 0.0)
    assert abs(found.latency - 0.01) < 1e-3
    np.testing.assert_allclose(found.gravity_share[1:], 1.0, atol=0.01)
    errors = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))[:, :2]
    assert np.all(np.abs(found.factors[:, :2] - np.array([KV, KI]).T) < 4.0 * errors)


def test_servo_with_position_commands(
    table1: FrictionModel, recorded: Recording, robot: Robot, tmp_path: Path
) -> None:
    kp, latency, share, step = (30.0, 40.0, 25.0), 0.007, 0.6, 1e-3
    fmu = tmp_path / "Plant.fmu"
    gains = {"kv": np.array(KV), "ki": np.array(KI), "kp": np.array(kp)}
    export_plant(table1, fmu, plant_body=PlantBody.from_robot(robot), **gains, bare=True)
    t = np.arange(0.0, 12.0, step)
    q_cmd = np.column_stack([np.interp(t, recorded.log.t, q) for q in recorded.desired.T])
    with FmuInstance(fmu, name="plant") as plant:
        start = {"q_start": tuple(q_cmd[0]), "latency": latency, "gravity_share": (share,) * 3}
        plant.initialise(start=plant.variables.expand_values(start))
        commands = [f"{name}[{i}]" for name in ("q_cmd", "dq_cmd") for i in (1, 2, 3)]
        outputs = [f"{name}[{i}]" for name in ("q", "dq", "tau_motor") for i in (1, 2, 3)]
        dq_cmd = np.gradient(q_cmd, t, axis=0)
        rows = step_rows(
            plant,
            plant.buffer(commands),
            plant.buffer(outputs),
            t[:-1],
            np.diff(t),
            np.hstack([q_cmd, dq_cmd])[:-1],
        )
    noise = np.random.default_rng(0).normal(0.0, 0.5, (len(rows), 3))
    q, dq, tau = rows[:, :3], rows[:, 3:6], rows[:, 6:] + noise
    log = replace(recorded.log, t=t[1:], q=q, dq=dq, tau=tau, q_cmd=q_cmd[1:], dq_cmd=dq_cmd[1:])
    found = identify_servo(log, robot, robot.nominal_parameters)
    kv, ki = np.array(KV), np.array(KI)
    true = np.column_stack([kv, kv * kp + ki, ki * kp])
    np.testing.assert_allclose(found.factors, true, rtol=0.05)
    # the plant logs the mean torque of the step before
    assert abs(found.latency - latency - 0.5 * step) < 1e-3
    np.testing.assert_allclose(found.gravity_share[1:], share, atol=0.02)


def test_predicted_errors_contain_the_true_ones(
    arm: TwinArm, recorded: Recording, robot: Robot, identified: tuple[RigidBody, FrictionModel]
) -> None:
    body, law = identified
    found = predict_following([recorded.log], robot, body, {"lugre": law}, law)
    first, *others = found.rows
    np.testing.assert_allclose(first.error, rms(recorded.desired - recorded.truth.q), rtol=2e-3)
    true = true_errors(arm, recorded, robot, body, law)
    assert [row.command for row in found.rows] == list(true)
    assert all(contained(row, true).all() for row in others)
    assert np.all(np.array(found.rows[-1].error) < 0.1 * np.array(first.error))
    assert "LuGre would reduce the following error" in benefit(found, ())


@pytest.mark.soak
def test_predicted_benefits_contain_the_true_ones(
    arm: TwinArm, robot: Robot, identified: tuple[RigidBody, FrictionModel]
) -> None:
    body, law = identified
    gains, inside, seed = [], [], 100
    while len(inside) < 100:
        seed += 1
        try:
            recording = run(arm, seed, f"motion {seed}")
        except ConfigError:  # beyond the limits of a joint
            continue
        servo = identify_servo(recording.log, robot, body.parameters)
        gains.append(np.array(cascade(servo.factors)[:2]) / np.array([KV, KI]) - 1.0)
        assert abs(servo.latency - 0.01) < 1e-3
        found = predict_following([recording.log], robot, body, {"lugre": law}, law)
        true = true_errors(arm, recording, robot, body, law)
        inside.append([contained(row, true).all() for row in found.rows[1:]])
    assert np.mean(np.abs(gains) < 0.05) >= 0.98
    assert np.all(np.sum(inside, axis=0) >= 90), np.sum(inside, axis=0)


def true_errors(
    arm: TwinArm, recording: Recording, robot: Robot, body: RigidBody, law: FrictionModel
) -> dict[str, Array]:
    servo = identify_servo(recording.log, robot, body.parameters)
    commands = feed_forward(recording.log, robot, body, {"lugre": law}, servo)
    return {
        name: rms(recording.desired - arm.run(recording.desired[0], dq_cmd, seed=0).q)
        for name, (_, dq_cmd) in commands
    }


def contained(row: FollowingError, true: dict[str, Array]) -> Array:
    return (row.low < true[row.command]) & (true[row.command] < row.high)


def rms(errors: Array) -> Array:
    return np.asarray(np.std(errors, axis=0))  # a velocity command fixes no position


def test_log_without_commands(recorded: Recording, robot: Robot, identified: tuple) -> None:
    log = replace(recorded.log, dq_cmd=None)
    found = predict_following([log], robot, identified[0], {}, identified[1])
    assert "predicted: no log has commanded positions" in benefit(found, ())


def test_torque_of_other_commands(recorded: Recording, robot: Robot) -> None:
    assert recorded.log.dq_cmd is not None
    log = replace(recorded.log, dq_cmd=recorded.log.dq_cmd[::-1])
    with pytest.raises(FitError, match="joint 'joint1' does not follow"):
        identify_servo(log, robot, robot.nominal_parameters)


def test_coupled_motors(recorded: Recording, robot: Robot) -> None:
    matrix = ((50.0, 0.0, 0.0), (0.0, 80.0, 0.0), (0.0, 80.0, 60.0))
    own = {**dict(robot.description), "gear_ratio": None}
    coupled = Robot(RobotDescription(**{**own, "transmission": Transmission(matrix=matrix)}))
    with pytest.raises(FitError, match="servos of coupled motors"):
        identify_servo(recorded.log, coupled, robot.nominal_parameters)


def test_useless_feed_forward() -> None:
    errors = {"a": (1.0,), "b": (2.0,)}
    rows = [FollowingError(command=c, error=e, low=e, high=e) for c, e in errors.items()]
    found = Following(rows=tuple(rows))
    assert "Feed-forward would not reduce the following" in benefit(found, ())


def test_commands_of_a_file(tmp_path: Path) -> None:
    path, t = tmp_path / "log.csv", np.arange(0.0, 2.0, 0.01)
    columns = {"t": t, "actual_q_0": 90 * t, "actual_current_0": t, "target_q_0": 90 * t + 90}
    header = ",".join(columns)
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=header, comments=""
    )
    assert guess_columns(read_table(path)).columns["q_cmd"] == ("target_q_0",)


@pytest.mark.parametrize("cell", ["", "nan", "word"])
@pytest.mark.parametrize("missing", ["refuse", "drop"])
def test_unusable_commands_do_not_count(
    recorded: Recording, robot: Robot, tmp_path: Path, cell: str, missing: str
) -> None:
    path, own = tmp_path / "log.csv", robot.description
    recorded.log.rows(slice(400)).write(path)
    header, first, *rest = path.read_text().splitlines()
    *others, _ = first.split(",")
    path.write_text("\n".join([header, ",".join([*others, cell]), *rest]) + "\n")
    log = own.log.model_copy(update={"missing": missing})
    found = Log.read(path, own.model_copy(update={"log": log}))
    assert found.dq_cmd is None
    assert len(found.t) == 400


def test_commands_of_other_joints_do_not_count(
    recorded: Recording, robot: Robot, tmp_path: Path
) -> None:
    path, own = tmp_path / "log.csv", robot.description
    recorded.log.write(path)
    names = {name: (f"{name}1", f"{name}2") for name in ("q", "dq", "tau")}
    columns = own.log.columns.model_copy(update=names)
    log = own.log.model_copy(update={"columns": columns})
    two = own.model_copy(update={"joints": own.joints[:2], "log": log, "gear_ratio": None})
    assert Log.read(path, two).dq_cmd is None
    assert Log.read(path, own).dq_cmd is not None
