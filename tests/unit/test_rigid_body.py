import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import FitError, LogError, RobotError
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.rigid_body.identification import RigidBody, identify, identify_motions
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.typed_files import from_json, to_json

MakeMotion = Callable[..., Motion]


def rows(motion: Motion, kept: slice) -> Motion:
    names = ("t", "q", "dq", "ddq", "tau", "q_raw")
    return replace(motion, **{name: getattr(motion, name)[kept] for name in names})


def worst(rigid_body: RigidBody, model: Robot, motion: Motion, truth: np.ndarray) -> float:
    """Largest error over all joints, relative to the largest torque."""
    error = np.abs(rigid_body.torque(model, motion) - truth).max(axis=0)
    return float(np.max(error / np.abs(truth).max(axis=0)))


def test_base_parameters_span_every_torque(arm_model: Robot) -> None:
    base = base_columns(arm_model)
    q, dq, ddq = np.random.default_rng(5).uniform(-2, 2, (3, 40, 3))
    columns = arm_model.regressor(q, dq, ddq).reshape(-1, 33)
    carried = columns[:, base] @ np.linalg.lstsq(columns[:, base], columns, rcond=None)[0]
    np.testing.assert_allclose(carried, columns, atol=1e-10)
    assert np.linalg.matrix_rank(columns[:, base]) == len(base)


def test_rotors_add_only_independent_columns(arm: RobotDescription, arm_model: Robot) -> None:
    bare = Robot(arm.model_copy(update={"rotor_inertia": False}))
    assert len(base_columns(bare)) == 15
    # The first two rotors act as link inertia; the third does not.
    assert len(base_columns(arm_model)) == 16


@pytest.mark.parametrize("method", ["stacked", "paper"])
@pytest.mark.parametrize("weighting", ["wls", "ols", None])
def test_without_noise_the_torque_is_recovered(
    method: str, weighting: str | None, arm_model: Robot, make_motion: MakeMotion
) -> None:
    forward = make_motion(friction=3.0)
    backward = make_motion(friction=3.0, reverse=True)
    rigid_body = identify_motions(
        [forward], arm_model, method=method, weighting=weighting, reversed_motions=[backward]
    )
    other = make_motion(seconds=7.0)
    other = replace(other, q=1.3 * other.q + 0.2, dq=1.3 * other.dq, ddq=1.3 * other.ddq)
    truth = arm_model.torque(arm_model.nominal_parameters, other.q, other.dq, other.ddq)
    assert worst(rigid_body, arm_model, other, truth) < 1e-8
    assert rigid_body.method == method
    assert rigid_body.weighting == weighting or weighting is None
    assert rigid_body.ridge == 0.0
    assert rigid_body.rows == 4000


def test_the_stacked_fit_also_finds_friction(arm_model: Robot, make_motion: MakeMotion) -> None:
    motion = make_motion(friction=3.0)
    motion = replace(motion, tau=motion.tau + np.array([0.5, 0.0, -0.2]))
    rigid_body = identify_motions([motion], arm_model)
    expected = [[3.0, 1.5, 0.5], [3.0, 1.5, 0.0], [3.0, 1.5, -0.2]]
    np.testing.assert_allclose(rigid_body.friction, expected, atol=1e-7)
    dependent = np.setdiff1d(np.arange(33), rigid_body.base)
    assert np.all(rigid_body.parameters[dependent] == 0.0)


def test_from_a_log_only_the_filter_reduces_accuracy(
    arm_log: Log, arm_model: Robot, make_motion: MakeMotion
) -> None:
    rigid_body = identify([arm_log], arm_model)
    motion = make_motion()
    assert worst(rigid_body, arm_model, motion, motion.tau) < 2e-3
    assert np.all(rigid_body.rmse < 0.05)


def test_averaging_tolerates_latency_and_tracking_errors(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    forward = make_motion(friction=3.0)
    # Both runs lag: the counterpart is displaced from the plain mirror image in time.
    late = make_motion(friction=3.0, reverse=True, seconds=10.0)
    late = rows(replace(late, t=late.t + 3.0), slice(12, None))
    rigid_body = identify_motions([forward], arm_model, method="paper", reversed_motions=[late])
    motion = make_motion()
    assert worst(rigid_body, arm_model, motion, motion.tau) < 1e-8


def test_averaging_cancels_odd_friction_of_any_shape(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    def rubbed(motion: Motion) -> Motion:
        odd = 4.0 * np.tanh(3 * motion.dq) * (1 + motion.q**2)
        return replace(motion, tau=motion.tau + odd)

    forward, backward = rubbed(make_motion()), rubbed(make_motion(reverse=True))
    truth = make_motion()
    averaged = identify_motions([forward], arm_model, method="paper", reversed_motions=[backward])
    assert worst(averaged, arm_model, truth, truth.tau) < 1e-8
    np.testing.assert_array_equal(averaged.friction, np.zeros((3, 3)))
    alone = identify_motions([forward], arm_model)
    assert worst(alone, arm_model, truth, truth.tau) > 1e-3


def test_weights_improve_the_low_noise_joint(arm_model: Robot, make_motion: MakeMotion) -> None:
    truth = make_motion(seconds=20.0)
    errors: dict[str, list[np.ndarray]] = {"wls": [], "ols": []}
    for seed in range(5):
        noise = np.random.default_rng(seed).standard_normal(truth.tau.shape) * [5.0, 5.0, 0.05]
        noisy = replace(truth, tau=truth.tau + noise)
        for weighting, found in errors.items():
            rigid_body = identify_motions([noisy], arm_model, weighting=weighting)
            found.append(np.abs(rigid_body.torque(arm_model, truth) - truth.tau).mean(axis=0))
    assert np.mean(errors["wls"], axis=0)[2] < 0.2 * np.mean(errors["ols"], axis=0)[2]


def test_a_poor_motion_is_regularised_and_reported(
    arm_model: Robot, make_motion: MakeMotion, caplog: pytest.LogCaptureFixture
) -> None:
    motion = make_motion()
    poor = replace(motion, q=0 * motion.q, ddq=0 * motion.ddq)
    with caplog.at_level(logging.WARNING):
        rigid_body = identify_motions([poor], arm_model)
    assert rigid_body.ridge > 0
    assert "log motion: the motion" in caplog.text
    assert np.all(np.isfinite(rigid_body.parameters))


def test_it_survives_json(arm_log: Log, arm_model: Robot) -> None:
    rigid_body = identify([arm_log], arm_model)
    back = from_json(RigidBody, to_json(rigid_body), Path("x.json"), "a rigid body")
    for name in RigidBody.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(rigid_body, name))
        assert type(getattr(back, name)) is type(getattr(rigid_body, name))


def test_the_same_log_gives_the_same_bits(arm_log: Log, arm_model: Robot) -> None:
    first, again = (identify([arm_log], arm_model) for _ in range(2))
    np.testing.assert_array_equal(first.parameters, again.parameters)


def test_too_few_samples_are_refused(arm_model: Robot, make_motion: MakeMotion) -> None:
    short = make_motion(name="short", seconds=0.1)
    message = "log short: 20 samples cannot determine"
    with pytest.raises(FitError, match=message):
        identify_motions([short], arm_model)


def test_a_joint_that_hardly_moves_is_named(arm_model: Robot, make_motion: MakeMotion) -> None:
    motion = make_motion(name="run")
    slow = replace(motion, dq=motion.dq * [1.0, 0.01, 1.0], q_raw=motion.q_raw * [1.0, 0.0, 1.0])
    message = r"joint 'j2' is never faster than 0\.\d+"
    with pytest.raises(FitError, match=message):
        identify_motions([slow], arm_model)


def test_a_joint_that_never_moves_is_named(arm_log: Log, arm_model: Robot) -> None:
    still = replace(arm_log, q=arm_log.q * [0.0, 1.0, 1.0])
    with pytest.raises(LogError, match=r"^log 'run': the position of joint 'j1' is constant"):
        identify([still], arm_model)


def test_averaging_needs_counterparts(arm_model: Robot, make_motion: MakeMotion) -> None:
    motion = make_motion(name="run")
    with pytest.raises(FitError, match="1 logs come with 0 time-reversed"):
        identify_motions([motion], arm_model, method="paper")
    other = replace(motion, name="other", q=motion.q + 0.5)
    message = "time-reversed counterpart of run"
    with pytest.raises(FitError, match=message):
        identify_motions([motion], arm_model, method="paper", reversed_motions=[other])
    same_way = replace(make_motion(name="back", reverse=True), dq=motion.dq[::-1])
    message = "log run: joint 'j1' never moves"
    with pytest.raises(FitError, match=message):
        identify_motions([motion], arm_model, method="paper", reversed_motions=[same_way])


def test_the_torque_of_another_robot_is_refused(
    arm: RobotDescription, arm_log: Log, arm_model: Robot, make_motion: MakeMotion
) -> None:
    rigid_body = identify([arm_log], arm_model)
    other = Robot(arm.model_copy(update={"name": "bare", "rotor_inertia": False}))
    message = r"'arm' with 33 .* 'bare', which has 30"
    with pytest.raises(RobotError, match=message):
        rigid_body.torque(other, make_motion())


LIFT = """<mujoco model="lift"><worldbody><body name="carriage">
  <joint name="z" type="slide" axis="0 0 1" range="-2 2"/>
  <inertial mass="2" pos="0 0 0" diaginertia="1e-3 1e-3 1e-3"/>
  <body name="arm"><joint name="a" axis="0 1 0" range="-90 90"/>
  <inertial mass="1" pos="0.1 0 0" diaginertia="1e-3 1e-3 1e-3"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize("physical", [False, True])
def test_weight_is_separate_from_the_friction_offset(
    physical: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """On a vertical sliding joint both are constant, so no motion can separate them."""
    path = tmp_path / "lift.xml"
    path.write_text(LIFT, encoding="utf-8")
    model = Robot(RobotDescription(name="lift", model=path, joints=("z", "a")))
    t = np.arange(0.0, 20.0, 0.01)
    phase = np.outer(t, [1.3, 2.1])
    rate = np.array([1.3, 2.1])
    q, dq, ddq = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    rubbing = [3.0, 2.0] * np.sign(dq) + [5.0, 1.0] * dq + [0.0, 0.7]
    tau = model.torque(model.nominal_parameters, q, dq, ddq) + rubbing
    motion = Motion(name="lift", t=t, q=q, dq=dq, ddq=ddq, tau=tau, q_raw=q)
    body = identify_motions([motion], model, physical=physical)
    np.testing.assert_allclose(body.friction, [[3.0, 5.0, 0.0], [2.0, 1.0, 0.7]], atol=1e-6)
    weight = model.torque(body.parameters, *np.zeros((3, 1, 2)))[0, 0]
    assert weight == pytest.approx(3.0 * 9.81, rel=1e-6)
    assert body.ridge == 0.0
    assert not caplog.records
