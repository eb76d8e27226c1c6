"""Payload identification with known payloads."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import FitError, LogError, RobotError
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.payload import add_payload, identify_payload, identify_payload_motions
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.typed_files import from_json, to_json

MakeMotion = Callable[..., Motion]

PAYLOAD = np.array([1.5, 0.12, -0.06, 0.09, 0.02, 0.002, 0.03, -0.001, 0.003, 0.025])
NOISE = np.array([0.5, 0.5, 0.2])


@pytest.fixture
def unloaded(arm_model: Robot, make_motion: MakeMotion) -> RigidBody:
    return identify_motions([make_motion(name="free", friction=3.0)], arm_model)


@pytest.fixture
def carried(arm_model: Robot, make_motion: MakeMotion) -> Motion:
    return under_load(make_motion(name="run", friction=3.5, seconds=12.0), arm_model, PAYLOAD)


def under_load(motion: Motion, model: Robot, payload: np.ndarray) -> Motion:
    columns = model.regressor(motion.q, motion.dq, motion.ddq)[:, :, 20:30]
    return replace(motion, tau=motion.tau + columns @ payload)


def noisy(motion: Motion, seed: int) -> Motion:
    noise = NOISE * np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=motion.tau + noise)


def test_without_noise_all_ten_parameters_are_found(
    arm_model: Robot, unloaded: RigidBody, carried: Motion
) -> None:
    payload = identify_payload_motions([carried], arm_model, unloaded)
    np.testing.assert_allclose(payload.parameters, PAYLOAD, atol=1e-8)
    assert payload.mass == pytest.approx(1.5)
    np.testing.assert_allclose(
        payload.parameters[1:4] / payload.mass, [0.08, -0.04, 0.06], atol=1e-8
    )
    np.testing.assert_allclose(payload.friction, [[3.5, 1.75, 0.0]] * 3, atol=1e-7)
    assert payload.rows == len(carried.t)
    assert payload.logs == ("run",)
    assert payload.to_dict()["parameters"]["m"] == payload.mass


def test_a_noisy_joint_gets_little_weight(
    arm_model: Robot, unloaded: RigidBody, carried: Motion
) -> None:
    """Unweighted, rows with 10 N.m of noise would make the payload insignificant."""
    noise = np.random.default_rng(0).standard_normal(carried.tau.shape)
    loud = replace(carried, tau=carried.tau + [0.1, 10.0, 0.1] * noise)
    payload = identify_payload_motions([loud], arm_model, unloaded)
    np.testing.assert_allclose(payload.parameters[1:4], PAYLOAD[1:4], atol=0.05)


def test_the_loaded_body_predicts_torque_under_load(
    arm_model: Robot, unloaded: RigidBody, carried: Motion, make_motion: MakeMotion
) -> None:
    payload = identify_payload_motions([carried], arm_model, unloaded)
    body = add_payload(unloaded, payload, arm_model)
    other = make_motion(seconds=7.0)
    other = replace(other, q=1.2 * other.q - 0.1, dq=1.2 * other.dq, ddq=1.2 * other.ddq)
    nominal = arm_model.torque(arm_model.nominal_parameters, other.q, other.dq, other.ddq)
    expected = under_load(replace(other, tau=nominal), arm_model, PAYLOAD).tau
    np.testing.assert_allclose(body.torque(arm_model, other), expected, atol=1e-7)
    assert body.logs == ("free", "run")
    assert body.base == unloaded.base
    assert np.all(body.standard_errors >= unloaded.standard_errors)
    np.testing.assert_array_equal(body.friction, payload.friction)
    assert to_json(from_json(RigidBody, to_json(body), Path("x.json"), "a body")) == to_json(body)


def test_standard_errors_match_the_scatter_of_repetitions(
    arm_model: Robot, carried: Motion, make_motion: MakeMotion
) -> None:
    found, stated = [], []
    for seed in range(20):
        free = noisy(make_motion(name="free", friction=3.0), 1000 + seed)
        body = identify_motions([free], arm_model)
        payload = identify_payload_motions([noisy(carried, seed)], arm_model, body)
        found.append(payload.parameters)
        stated.append(payload.standard_errors)
    spread = np.std(found, axis=0)
    # Errors of the unloaded body are taken as independent, which is conservative.
    ratio = np.mean(stated, axis=0) / spread
    assert np.all(ratio > 0.5)
    assert ratio[0] < 2.5


def test_correlated_residuals_widen_the_errors(
    arm_model: Robot, unloaded: RigidBody, carried: Motion
) -> None:
    noise = np.random.default_rng(0).standard_normal(carried.tau.shape)
    window = np.ones(60) / np.sqrt(60)
    slow = np.column_stack([np.convolve(column, window, mode="same") for column in noise.T])
    white, coloured = (
        identify_payload_motions(
            [replace(carried, tau=carried.tau + 0.3 * errors)], arm_model, unloaded
        )
        for errors in (noise, slow)
    )
    np.testing.assert_allclose(coloured.rmse, white.rmse, rtol=0.3)
    assert np.median(coloured.standard_errors / white.standard_errors) > 3.0


def test_from_logs_only_the_filter_reduces_accuracy(
    arm_model: Robot, unloaded: RigidBody, carried: Motion
) -> None:
    log = Log(name="run", t=carried.t, q=carried.q, dq=carried.dq, tau=carried.tau)
    payload = identify_payload([log], arm_model, unloaded)
    assert payload.mass == pytest.approx(1.5, abs=0.01)


def test_a_log_without_payload_is_refused(
    arm_model: Robot, unloaded: RigidBody, make_motion: MakeMotion
) -> None:
    message = "log run: no significant payload"
    for seed in range(5):
        empty = noisy(make_motion(name="run", friction=3.0, seconds=12.0), seed)
        with pytest.raises(FitError, match=message):
            identify_payload_motions([empty], arm_model, unloaded)


def test_a_short_log_is_refused(
    arm_model: Robot, unloaded: RigidBody, make_motion: MakeMotion
) -> None:
    message = r"run: lasts 4 s; .* 10 s"
    with pytest.raises(FitError, match=message):
        identify_payload_motions([make_motion(name="run", seconds=4.0)], arm_model, unloaded)


def test_a_motion_that_does_not_determine_the_payload_is_refused(
    arm_model: Robot, unloaded: RigidBody, carried: Motion
) -> None:
    poor = replace(carried, q=0 * carried.q, ddq=0 * carried.ddq)
    message = r"determine the payload \(condition number \d\.?\d?e\+\d+\)"
    with pytest.raises(FitError, match=message):
        identify_payload_motions([poor], arm_model, unloaded)


def test_a_joint_that_never_moves_is_named(
    arm_model: Robot, unloaded: RigidBody, arm_log: Log
) -> None:
    still = replace(arm_log, q=arm_log.q * [1.0, 1.0, 0.0])
    with pytest.raises(LogError, match=r"^log 'run': the position of joint 'j3' is constant"):
        identify_payload([still], arm_model, unloaded)


def test_the_body_of_another_robot_is_refused(
    arm: RobotDescription, unloaded: RigidBody, carried: Motion
) -> None:
    other = Robot(arm.model_copy(update={"name": "bare", "rotor_inertia": False}))
    with pytest.raises(RobotError, match="rigid body of 'arm' with 33"):
        identify_payload_motions([carried], other, unloaded)


def test_one_way_motion_that_hides_parts_of_friction_determines_a_payload(
    arm_model: Robot, unloaded: RigidBody, one_way: Motion
) -> None:
    payload = identify_payload_motions(
        [under_load(one_way, arm_model, PAYLOAD)], arm_model, unloaded
    )
    np.testing.assert_allclose(payload.parameters[:4], PAYLOAD[:4], atol=1e-3)
    assert np.all(payload.friction[[0, 1], 2] == 0.0)
