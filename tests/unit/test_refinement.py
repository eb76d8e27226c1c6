"""Alternating fit of rigid body and friction, on an arm whose friction has memory."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from joint_data import law as made

from hesr_model.errors import ArtifactError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.refinement import identify_again
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]

BRISTLE = made(
    "lugre_load",
    {},
    sigma_0=600.0,
    sigma_1=0.0,
    sigma_2=4.0,
    F_c=12.0,
    F_s=18.0,
    v_s=0.15,
    tau_0=0.5,
    mu=0.01,
)
"""So soft that its memory resembles rigid-body torque in a fit with Coulomb columns."""
NOISE = 0.2


@pytest.fixture
def rough(make_motion: MakeMotion) -> Callable[..., Log]:
    """Noisy logs of the arm with this friction in every joint."""

    def make(*, seed: int = 0, **options: object) -> Log:
        motion = make_motion(**options)
        friction = [
            predict(BRISTLE, t=motion.t, dq=motion.dq[:, k], tau_load=motion.tau[:, k])
            for k in range(motion.dq.shape[1])
        ]
        noise = NOISE * np.random.default_rng(seed).normal(size=motion.tau.shape)
        tau = motion.tau + np.column_stack(friction) + noise
        return Log(name=motion.name, t=motion.t, q=motion.q, dq=motion.dq, tau=tau)

    return make


def fitted(
    logs: Sequence[Log], model: Robot, body: RigidBody, law: str = "lugre_load"
) -> FrictionModel:
    records = [friction_records(log, model, body) for log in logs]
    by_joint = [list(of_joint) for of_joint in zip(*records, strict=True)]
    return fit_models([law], by_joint, robot="arm", seed=0, workers=1)[law]


def rigid_errors(body: RigidBody, model: Robot, make_motion: MakeMotion) -> np.ndarray:
    """RMSE of the rigid-body torque on another motion, (n,) [N.m]."""
    motion = make_motion()
    w = np.array([1.3, 1.7, 2.3])
    angle = motion.t[:, None] * w + [0.0, 1.0, 2.0]
    other = replace(
        motion, q=0.8 * np.sin(angle), dq=0.8 * w * np.cos(angle), ddq=-0.8 * w**2 * np.sin(angle)
    )
    truth = model.torque(model.nominal_parameters, other.q, other.dq, other.ddq)
    return np.sqrt(np.mean((body.torque(model, other) - truth) ** 2, axis=0))


def test_the_rigid_body_gains_from_a_better_friction_law(
    rough: Callable[..., Log], arm_model: Robot, make_motion: MakeMotion
) -> None:
    logs = [rough(name="one"), rough(name="two", reverse=True, seed=1)]
    first = body = identify(logs, arm_model)
    errors = [rigid_errors(body, arm_model, make_motion)]
    for _ in range(2):
        body = identify_again(logs, arm_model, body, fitted(logs, arm_model, body))
        errors.append(rigid_errors(body, arm_model, make_motion))
    assert np.all(errors[1] < 0.8 * errors[0]), errors
    assert np.all(errors[2] < errors[1]), errors
    assert np.all(body.rmse < 0.5 * first.rmse)


def test_friction_is_removed_from_reversed_logs(
    rough: Callable[..., Log], arm_model: Robot, make_motion: MakeMotion
) -> None:
    forward, backward = rough(name="run"), rough(name="back", reverse=True, seed=1)
    body = identify([forward], arm_model, reversed_logs=[backward])
    friction = fitted([forward, backward], arm_model, body)
    again = identify_again([forward], arm_model, body, friction, reversed_logs=[backward])
    assert again.logs == body.logs
    before = rigid_errors(body, arm_model, make_motion)
    after = rigid_errors(again, arm_model, make_motion)
    assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2))
    assert np.all(again.rmse < body.rmse)


def test_friction_within_the_columns_changes_nothing(
    make_motion: MakeMotion, arm_model: Robot
) -> None:
    """A Stribeck law equal to Coulomb plus viscous friction: the rigid body stays the same."""
    motion = make_motion(name="run", friction=3.0)
    log = Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau)
    body = identify([log], arm_model)
    friction = fitted([log], arm_model, body, "stribeck")
    again = identify_again([log], arm_model, body, friction)
    np.testing.assert_allclose(
        rigid_errors(again, arm_model, make_motion),
        rigid_errors(body, arm_model, make_motion),
        atol=0.02,
    )


def test_the_logs_are_not_modified(rough: Callable[..., Log], arm_model: Robot) -> None:
    log = rough(name="run")
    body = identify([log], arm_model)
    before = log.tau.copy()
    identify_again([log], arm_model, body, fitted([log], arm_model, body, "stribeck"))
    np.testing.assert_array_equal(log.tau, before)


def test_a_model_of_another_robot_is_refused(rough: Callable[..., Log], arm_model: Robot) -> None:
    log = rough(name="run")
    body = identify([log], arm_model)
    friction = fitted([log], arm_model, body, "stribeck")
    two = replace(
        friction,
        joints=friction.joints[:2],
        laws=friction.laws[:2],
        trained=(),
        training_rmse=(),
        left_out_rmse=(),
    )
    with pytest.raises(ArtifactError, match="joints j1, j2; the robot"):
        identify_again([log], arm_model, body, two)
