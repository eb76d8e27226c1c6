"""Torque constants from known masses and payloads, and refusals."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hesr_model.errors import FitError
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.torque_constants import point_payload, torque_constants
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]

TRUE = np.array([11.0, 12.0, 9.0])
ASSUMED = np.array([10.0, 20.0, 5.0])
NOISE = np.array([0.5, 0.5, 0.2])


def logged(motion: Motion, seed: int) -> Motion:
    """The motion, with currents converted to torques by the assumed constants."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=(motion.tau + noise) / TRUE * ASSUMED)


def with_load(motion: Motion, model: Robot, payload: np.ndarray) -> Motion:
    return replace(
        motion,
        tau=motion.tau + model.regressor(motion.q, motion.dq, motion.ddq)[:, :, 20:30] @ payload,
    )


def test_model_weights_give_constants_of_loaded_joints(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    motion = logged(make_motion(seconds=20.0, friction=0.2), 1)
    found = torque_constants([motion], arm_model, ASSUMED, mass_error=0.1)
    assert not found[0].determined  # its axis is vertical
    assert "joint 'j1': not determined" in found[0].sentence
    for k in (1, 2):
        assert found[k].determined
        assert abs(found[k].value - TRUE[k]) < 2 * found[k].error
        assert 0.03 < found[k].error / found[k].value < 0.2
        assert f"{found[k].value:.4g} +- " in found[k].sentence


def test_a_weight_hidden_by_friction_determines_nothing(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    motion = logged(make_motion(seconds=20.0, friction=3.0), 1)
    found = torque_constants([motion], arm_model, ASSUMED, mass_error=0.1)
    assert not any(constant.determined for constant in found)


def test_declared_mass_errors_widen_the_intervals(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    motion = make_motion(seconds=20.0, friction=0.2)
    rng = np.random.default_rng(4)
    seen = 0
    for seed in range(6):
        masses = np.repeat(1.0 + 0.15 * rng.standard_normal(3), 10)
        parameters = arm_model.nominal_parameters.copy()
        parameters[:30] *= masses
        tau = arm_model.torque(parameters, motion.q, motion.dq, motion.ddq)
        tau += 0.2 * (np.sign(motion.dq) + 0.5 * motion.dq)
        found = torque_constants(
            [logged(replace(motion, tau=tau), seed)], arm_model, ASSUMED, mass_error=0.15
        )
        for constant, true in zip(found, TRUE, strict=True):
            if constant.determined:
                seen += 1
                assert abs(constant.value - true) < 3 * constant.error
    assert seen >= 6  # the second joint every time


def test_a_known_payload_needs_no_masses(arm_model: Robot, make_motion: MakeMotion) -> None:
    payload = point_payload(5.0, [0.15, -0.05, 0.1])
    free = make_motion(seconds=20.0, friction=2.0)
    heavy = np.repeat([1.4, 0.7, 1.3], 10)  # differs from the model file
    parameters = arm_model.nominal_parameters.copy()
    parameters[:30] *= heavy
    tau = arm_model.torque(parameters, free.q, free.dq, free.ddq)
    free = replace(free, tau=tau + 2.0 * (np.sign(free.dq) + 0.5 * free.dq))
    found = torque_constants(
        [logged(free, 1)],
        arm_model,
        ASSUMED,
        mass_error=0.5,
        loaded=[logged(with_load(free, arm_model, payload), 2)],
        payload=payload,
    )
    assert [c.determined for c in found] == [True, True, True]
    np.testing.assert_allclose([c.value for c in found], TRUE, rtol=0.03)


def test_invalid_requests_are_refused(arm_model: Robot, make_motion: MakeMotion) -> None:
    motion = make_motion()
    with pytest.raises(FitError, match="error of the masses is 0"):
        torque_constants([motion], arm_model, ASSUMED, mass_error=0.0)
    with pytest.raises(FitError, match="motions under a payload need"):
        torque_constants([motion], arm_model, ASSUMED, mass_error=0.1, loaded=[motion])


def test_a_point_mass_has_the_inertia_of_its_distance() -> None:
    m, mx, my, mz, ixx, ixy, iyy, ixz, iyz, izz = point_payload(2.0, [0.1, 0.2, -0.3])
    assert (m, mx, my, mz) == (2.0, 0.2, 0.4, -0.6)
    np.testing.assert_allclose([ixx, iyy, izz], 2 * np.array([0.13, 0.10, 0.05]))
    np.testing.assert_allclose([ixy, ixz, iyz], 2 * np.array([-0.02, 0.03, 0.06]))
