"""Rigid-body identification on measured logs: requirements for a valid friction residual."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hesr_model.friction.records import rmse
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records, require_reversals
from hesr_model.robots.robot import Robot, RobotDescription


def friction_of(
    logs: Sequence[Log], model: Robot, rigid_body: RigidBody
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Velocity and friction of each joint, pooled over the logs."""
    records = [friction_records(log, model, rigid_body) for log in logs]
    return [
        (np.concatenate([r.dq for r in joint]), np.concatenate([r.tau for r in joint]))
        for joint in zip(*records, strict=True)
    ]


def static_features(dq: np.ndarray) -> np.ndarray:
    """A static law linear in its coefficients: steps of several widths, and a viscous term."""
    steps = [np.tanh(dq / width) for width in (0.005, 0.02, 0.1, 0.4)]
    return np.column_stack([*steps, dq, dq * np.abs(dq), np.ones_like(dq)])


def static_errors(
    train: Sequence[Log], test: Sequence[Log], model: Robot, rigid_body: RigidBody
) -> np.ndarray:
    """RMSE of the static law on `test` after a fit on `train`, (n,) [N.m]."""
    errors = []
    for (dq, tau), (test_dq, test_tau) in zip(
        friction_of(train, model, rigid_body), friction_of(test, model, rigid_body), strict=True
    ):
        law = np.linalg.lstsq(static_features(dq), tau, rcond=None)[0]
        errors.append(rmse(test_tau - static_features(test_dq) @ law))
    return np.array(errors)


@pytest.fixture(scope="module")
def rigid_body(id_logs: list[Log], ur10e_model: Robot) -> RigidBody:
    return identify(id_logs, ur10e_model)


def test_base_parameters_are_36_and_40_with_rotors(
    ur10e: RobotDescription, ur10e_model: Robot
) -> None:
    bare = Robot(ur10e.model_copy(update={"rotor_inertia": False}))
    assert (len(base_columns(bare)), len(base_columns(ur10e_model))) == (36, 40)


def test_the_three_logs_determine_all_parameters(rigid_body: RigidBody) -> None:
    assert rigid_body.ridge == 0.0
    assert rigid_body.condition < 200
    np.testing.assert_array_less(rigid_body.rmse, [2.7, 3.5, 1.65, 0.37, 0.50, 0.36])
    coulomb, viscous = rigid_body.friction[:, 0], rigid_body.friction[:, 1]
    assert np.all(coulomb > 0)
    assert np.all(viscous > 0)
    rotors = [p for n, p in zip(rigid_body.names, rigid_body.parameters, strict=True) if "Ir" in n]
    assert np.all(np.array(rotors) >= 0)


def test_friction_on_unseen_motions_has_the_known_size(
    unseen_logs: list[Log], ur10e_model: Robot, rigid_body: RigidBody
) -> None:
    friction = friction_of(unseen_logs, ur10e_model, rigid_body)
    spread = [np.std(tau) for _, tau in friction]
    np.testing.assert_allclose(spread, [27.6, 23.9, 11.7, 4.33, 4.25, 3.73], rtol=0.005)


def test_a_static_law_has_the_known_error_on_unseen_motions(
    id_logs: list[Log],
    unseen_logs: list[Log],
    ur10e_model: Robot,
    rigid_body: RigidBody,
) -> None:
    errors = static_errors(id_logs, unseen_logs, ur10e_model, rigid_body)
    np.testing.assert_array_less(errors, [2.80, 4.05, 2.00, 0.50, 0.90, 0.87])


def test_weights_and_rotors_reduce_the_error_on_logs_left_out(
    id_logs: list[Log], ur10e: RobotDescription, ur10e_model: Robot
) -> None:
    def left_out(model: Robot, weighting: str) -> np.ndarray:
        squares = []
        for log in id_logs:
            others = [other for other in id_logs if other is not log]
            found = identify(others, model, weighting=weighting)
            squares.append(static_errors(others, [log], model, found) ** 2)
        return np.sqrt(np.mean(squares, axis=0))

    best = left_out(ur10e_model, "wls")
    unweighted = left_out(ur10e_model, "ols")
    bare = left_out(Robot(ur10e.model_copy(update={"rotor_inertia": False})), "wls")
    assert np.all(best[3:] < 0.97 * unweighted[3:])
    assert np.all(best[:3] < 1.01 * unweighted[:3])
    assert best[5] < 0.97 * bare[5]


def test_a_short_log_still_gives_a_usable_model(
    id_logs: list[Log], unseen_logs: list[Log], ur10e_model: Robot
) -> None:
    log = id_logs[2]
    assert log.dq is not None
    half = len(log.t) // 2
    short = replace(log, t=log.t[:half], q=log.q[:half], dq=log.dq[:half], tau=log.tau[:half])
    rigid_body = identify([short], ur10e_model)
    spread = [np.std(tau) for _, tau in friction_of(unseen_logs, ur10e_model, rigid_body)]
    assert np.all(np.array(spread) < 2.0 * np.array([27.6, 23.9, 11.7, 4.33, 4.25, 3.73]))


def test_every_joint_reverses(
    id_logs: list[Log], ur10e_model: Robot, rigid_body: RigidBody
) -> None:
    for joint in zip(
        *(friction_records(log, ur10e_model, rigid_body) for log in id_logs), strict=True
    ):
        require_reversals(joint)
