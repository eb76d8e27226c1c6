"""A correction of the model file counts elsewhere as far as it pays on the rows of the logs."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from body_draws import try_draw

from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.choice import KINDS, choose_body, identify_kind
from hesr_model.rigid_body.extrapolation import (
    States,
    compute_standard_errors,
    estimate_ratios,
)
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import models_folder

MakeMotion = Callable[..., Motion]


@pytest.fixture
def states(arm_model: Robot, make_motion: MakeMotion) -> States:
    return States.from_motions([make_motion(seconds=5.0)], arm_model)


@pytest.fixture
def given(arm_model: Robot, make_motion: MakeMotion) -> RigidBody:
    return identify_kind([make_motion(seconds=5.0)], arm_model, "nominal", warns=False)


def estimate(given: RigidBody, robot: Robot, states: States, rmse: float) -> Array:
    """Return the ratios of a body of 1.2 times the masses, whose error was 1 N.m before."""
    body = replace(given, parameters=1.2 * given.parameters)
    sizes = np.ones(robot.n)
    return estimate_ratios([body], [given], np.full(robot.n, rmse), sizes, robot, states)


def test_a_correction_that_pays_is_an_error_of_the_model_file_elsewhere(
    given: RigidBody, arm_model: Robot, states: States
) -> None:
    assert np.all(estimate(given, arm_model, states, 0.01) < 0.5)


def test_a_correction_that_does_not_pay_is_an_error_elsewhere(
    given: RigidBody, arm_model: Robot, states: States
) -> None:
    ratios = estimate(given, arm_model, states, 1.0)
    assert np.all(ratios >= 1.0)
    assert np.max(ratios) > 1.05


def test_the_same_body_has_the_same_error_elsewhere(
    given: RigidBody, arm_model: Robot, states: States
) -> None:
    sizes = np.full(arm_model.n, 2.0)
    ratios = estimate_ratios([given], [given], sizes, sizes, arm_model, states)
    np.testing.assert_array_equal(ratios, 1.0)


def test_a_motion_of_one_frequency_determines_less_elsewhere(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    rich = make_motion(friction=3.0, seconds=20.0)
    noise = np.random.default_rng(0).normal(size=rich.tau.shape)
    rich = replace(rich, tau=rich.tau + noise)
    phase = np.outer(2.0 * rich.t, np.ones(arm_model.n)) + np.arange(arm_model.n)
    q = 0.3 * np.sin(phase)
    dq = 0.6 * np.cos(phase)
    tau = arm_model.torque(arm_model.nominal_parameters, q, dq, -4.0 * q) + 3.0 * np.sign(dq)
    poor = replace(rich, q=q, dq=dq, ddq=-4.0 * q, q_raw=q, dq_causal=dq, tau=tau + noise)
    errors = {}
    for name, motion in (("rich", rich), ("poor", poor)):
        body = identify_kind([motion], arm_model, "free", warns=False)
        states = States.from_motions([motion], arm_model)
        errors[name] = compute_standard_errors([body], arm_model, states)
    assert np.all(errors["poor"] > 2.0 * errors["rich"])


def test_wrong_masses_are_kept_where_no_joint_moves_alone(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """The free body of two joints that move as one is not preferred, whatever its error is."""
    motion = make_motion(friction=3.0, seconds=20.0)
    q = np.repeat(motion.q[:, :1], arm_model.n, axis=1)
    dq = np.repeat(motion.dq[:, :1], arm_model.n, axis=1)
    ddq = np.repeat(motion.ddq[:, :1], arm_model.n, axis=1)
    noise = 0.3 * np.random.default_rng(1).normal(size=dq.shape)
    friction = 3.0 * np.sign(dq) * np.abs(dq) ** 0.5
    tau = arm_model.torque(arm_model.nominal_parameters, q, dq, ddq) + friction + noise
    alike = replace(motion, q=q, dq=dq, ddq=ddq, q_raw=q, dq_causal=dq, tau=tau)
    assert choose_body([alike], arm_model).kind != "free"


@pytest.mark.ci
@pytest.mark.parametrize(("seed", "kinds"), [(15, {"physical"}), (20, {"physical"}), (31, KINDS)])
def test_a_body_that_misleads_elsewhere_is_not_chosen(seed: int, kinds: set[str]) -> None:
    """On these motions of one frequency, bodies have up to five times the given model's error."""
    draw = try_draw(Robot(models_folder() / "uf850" / "robot.toml"), seed)
    assert max(draw.ratios.values()) > 2.0
    assert draw.ratio <= 1.0
    assert draw.kind in kinds
