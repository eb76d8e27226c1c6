"""Excitation design: search, limits and refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from hesr_model.errors import ConfigError, FitError, RobotError
from hesr_model.motions.excitation import (
    Excitation,
    ExcitationSettings,
    FourierSearch,
    condition,
    design,
    random_motions,
)
from hesr_model.motions.limits import Limits, MotionLimits, peak_torque
from hesr_model.motions.trajectories import Fourier
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

SLOW = MotionLimits(velocity=(2.0, 2.0, 2.0))  # an MJCF has no speed limits
QUICK = ExcitationSettings(harmonics=3, period=(5.0, 12.0), starts=1, limits=SLOW)


def with_limits(**limits: object) -> ExcitationSettings:
    return QUICK.model_copy(update={"limits": MotionLimits.model_validate(dict(SLOW) | limits)})


@pytest.fixture(scope="module")
def uf850() -> Robot:
    return Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))


@pytest.fixture(scope="module")
def uf850_excitation(uf850: Robot) -> Excitation:
    return design(uf850, ExcitationSettings(limits=SLOW))


def assert_kept(found: Excitation) -> None:
    """Peaks also between the points of the design."""
    motion, limits = found.motion, found.limits
    q, dq, ddq = motion.sample(np.random.default_rng(3).uniform(0, motion.duration, 20_000))
    assert np.all(q.min(axis=0) > limits.lower)
    assert np.all(q.max(axis=0) < limits.upper)
    assert np.all(np.abs(dq).max(axis=0) < limits.velocity)
    assert np.all(np.abs(ddq).max(axis=0) < limits.acceleration)


# --- condition and limits ---------------------------------------------------------------------


def test_condition_is_a_third_of_the_median_random_motion(
    uf850: Robot, uf850_excitation: Excitation
) -> None:
    base = base_columns(uf850)
    with threadpool_limits(1):
        random = random_motions(uf850, ExcitationSettings(limits=SLOW), 200, seed=1)
        median = np.median([condition(uf850, base, motion) for motion in random])
    found = condition(uf850, base, uf850_excitation.motion)
    assert uf850_excitation.condition == pytest.approx(found)
    assert uf850_excitation.condition < median / 3


def test_limits_are_met_and_used(uf850_excitation: Excitation) -> None:
    assert_kept(uf850_excitation)
    _, q, dq, ddq = uf850_excitation.setpoints()
    limits = uf850_excitation.limits
    share = [
        np.ptp(q, axis=0) / (limits.upper - limits.lower),
        np.abs(dq).max(axis=0) / limits.velocity,
        np.abs(ddq).max(axis=0) / limits.acceleration,
    ]
    assert np.all(np.max(share, axis=0) > 0.95)


def test_setpoints_run_from_rest_to_rest(uf850_excitation: Excitation) -> None:
    t, q, dq, ddq = uf850_excitation.setpoints()
    np.testing.assert_allclose(np.diff(t), 1 / 200, rtol=1e-9)
    assert t[-1] == pytest.approx(uf850_excitation.motion.duration, abs=1e-9)
    assert 10.0 <= uf850_excitation.motion.period <= 30.0
    np.testing.assert_allclose(q[0], q[-1], atol=1e-12)
    for rate in (dq, ddq):
        np.testing.assert_allclose(rate[[0, -1]], 0.0, atol=1e-12)


def test_counterpart_is_as_well_conditioned(uf850: Robot, uf850_excitation: Excitation) -> None:
    backward = uf850_excitation.motion.reverse_time()
    found = condition(uf850, base_columns(uf850), backward)
    assert found == pytest.approx(uf850_excitation.condition, rel=1e-3)


def test_torque_limit_is_met_and_costs_condition(arm_model: Robot) -> None:
    free = design(arm_model, QUICK)
    torque = 0.5 * free.peak_torque
    bound = design(arm_model, with_limits(torque=tuple(torque)))
    assert_kept(bound)
    assert np.all(bound.peak_torque <= torque)
    assert np.any(bound.peak_torque > 0.9 * torque)
    assert bound.condition > free.condition


def test_periods_rate_and_seed_are_used(arm_model: Robot) -> None:
    settings = QUICK.model_copy(update={"periods": 3, "sample_rate": 125.0})
    found, again = design(arm_model, settings), design(arm_model, settings)
    np.testing.assert_array_equal(found.motion.a, again.motion.a)
    t, q, _, _ = found.setpoints()
    assert len(t) == round(3 * found.motion.period * 125.0) + 1
    assert found.motion.period * 125.0 == pytest.approx(round(found.motion.period * 125.0))
    assert len(q) == len(t)


def test_random_motions_differ_and_meet_the_limits(arm_model: Robot) -> None:
    limits = Limits.from_settings(arm_model, QUICK.limits)
    motions = random_motions(arm_model, QUICK, 20, seed=4)
    assert len({motion.period for motion in motions}) == 20
    assert random_motions(arm_model, QUICK, 1, seed=5)[0].period != motions[0].period
    for motion in motions:
        assert_kept(
            Excitation(
                motion=motion,
                condition=0.0,
                sample_rate=200.0,
                limits=limits,
                peak_torque=np.zeros(3),
            )
        )
        _, dq, ddq = motion.sample(np.linspace(0, motion.period, 2000))
        used = np.maximum(
            np.abs(dq).max(axis=0) / limits.velocity,
            np.abs(ddq).max(axis=0) / limits.acceleration,
        )
        assert np.all(used > 0.5)


# --- the search -------------------------------------------------------------------------------


def test_gradient_matches_differences_of_the_value(arm_model: Robot) -> None:
    # With tight limits every penalty contributes.
    limits = Limits.from_settings(
        arm_model,
        MotionLimits(
            position=((-0.2, 0.3), (-0.1, 0.4), (0.0, 0.5)),
            velocity=(0.2, 0.3, 0.2),
            acceleration=(0.3, 0.2, 0.3),
            torque=(0.5, 3.0, 1.0),
        ),
    )
    search = FourierSearch(robot=arm_model, limits=limits, harmonics=3, period=(4.0, 9.0))
    x = np.random.default_rng(2).uniform(-0.9, 0.9, len(search.bounds))
    x[-1] = np.log(6.0)
    value, gradient = search.value_and_gradient(x, 10.0)
    assert np.isfinite(value)
    expected = np.empty_like(x)
    for k in range(len(x)):
        step = np.zeros_like(x)
        step[k] = 1e-5
        ends = [search.value_and_gradient(x + way * step, 10.0)[0] for way in (1, -1)]
        expected[k] = (ends[0] - ends[1]) / 2e-5
    np.testing.assert_allclose(gradient, expected, atol=1e-5 * np.abs(expected).max())


def test_coordinates_map_to_motions(arm_model: Robot) -> None:
    limits = Limits.from_settings(arm_model, SLOW)
    search = FourierSearch(robot=arm_model, limits=limits, harmonics=3, period=(5.0, 12.0))
    motion = random_motions(arm_model, QUICK, 1, seed=0)[0]
    back = search.unpack(search.pack(motion))
    for name in ("offset", "a", "b", "period"):
        np.testing.assert_allclose(getattr(back, name), getattr(motion, name), atol=1e-12)
    value, _ = search.value_and_gradient(search.pack(motion), 1.0)
    true = np.log(condition(arm_model, search.base, motion))
    assert true - 0.05 < value < true + 0.5


# --- limits -----------------------------------------------------------------------------------


URDF = """
<robot name="one">
  <link name="base"/>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="{effort}" velocity="3"/>
  </joint>
  <link name="arm">
    <inertial><origin xyz="0.5 0 0"/><mass value="2"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""


@pytest.mark.parametrize(("effort", "expected"), [(40, 40.0), (0, np.inf)])
def test_limits_come_from_the_model(tmp_path: Path, effort: float, expected: float) -> None:
    path = tmp_path / "one.urdf"
    path.write_text(URDF.format(effort=effort), encoding="utf-8")
    model = Robot(RobotDescription(name="one", model=path, joints=("hinge",)))
    limits = Limits.from_settings(model, MotionLimits())
    assert (limits.lower[0], limits.upper[0]) == (-0.9, 0.9)
    assert (limits.velocity[0], limits.acceleration[0], limits.torque[0]) == (3.0, 3.0, expected)
    given = MotionLimits(
        position=((-1.0, 0.5),), velocity=(1.0,), acceleration=(4.0,), torque=(7.0,)
    )
    found = Limits.from_settings(model, given)
    values = [getattr(found, name)[0] for name in Limits.__dataclass_fields__]
    assert values == [-1.0, 0.5, 1.0, 4.0, 7.0]


def test_a_motion_within_the_limits_is_left_alone(arm_model: Robot) -> None:
    limits = Limits.from_settings(
        arm_model, MotionLimits(velocity=SLOW.velocity, torque=(1e3, 1e3, 1e3))
    )
    motion = random_motions(arm_model, QUICK, 1, seed=0)[0]
    small = replace(motion, a=0.5 * motion.a, b=0.5 * motion.b, offset=np.zeros(3))
    kept = limits.shrink(small, arm_model, limits.find_rest_position(arm_model))
    for name in ("offset", "a", "b"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(small, name))


def test_rest_minimises_gravity_torque(arm_model: Robot) -> None:
    limits = Limits.from_settings(
        arm_model, MotionLimits(velocity=SLOW.velocity, torque=(50.0, 12.0, 3.0))
    )
    rest = limits.find_rest_position(arm_model)
    still = Fourier(offset=rest, a=np.zeros((3, 2)), b=np.zeros((3, 2)), period=1.0)
    assert np.max(peak_torque(arm_model, still) / limits.torque) < 0.05


# --- refusals ---------------------------------------------------------------------------------


def test_limits_must_be_one_per_joint(arm_model: Robot) -> None:
    message = r"^key 'limits\.velocity' has 2 entries"
    with pytest.raises(RobotError, match=message):
        design(arm_model, with_limits(velocity=(1.0, 1.0)))


@pytest.mark.parametrize(("kind", "key"), [("revolute", "velocity"), ("continuous", "position")])
def test_an_absent_limit_is_asked_for(tmp_path: Path, kind: str, key: str) -> None:
    path = tmp_path / "one.urdf"
    text = URDF.format(effort=40).replace('velocity="3"', 'velocity="0"')
    path.write_text(text.replace("revolute", kind), encoding="utf-8")
    model = Robot(RobotDescription(name="one", model=path, joints=("hinge",)))
    with pytest.raises(RobotError) as caught:
        design(model, QUICK.model_copy(update={"limits": MotionLimits()}))
    assert f"{key} limit of joint 'hinge'; state" in str(caught.value)


def test_positions_outside_the_joint_range_are_refused(arm_model: Robot) -> None:
    message = r"joint 'j2' is -1 to 2\.5"
    with pytest.raises(RobotError, match=message):
        design(arm_model, with_limits(position=((-1, 1), (-1, 2.5), (-1, 1))))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[limits]\nposition = [[0.5, 0.5]]", "1 goes from 0.5 to 0.5"),
        ("[limits]\nvelocity = [0.0]", "key 'limits.velocity.0' is 0.0: Input should be greater"),
        ("period = [20.0, 10.0]", "key 'period' is [20.0, 10.0]: the shortest period must come"),
        ("harmonics = 1", "key 'harmonics' is 1: Input should be greater than or equal to 2"),
        ("[limits]\njerk = [1.0]", "unknown key 'limits.jerk'; allowed here: acceleration, posit"),
    ],
)
def test_settings_that_admit_no_motion_are_refused(
    tmp_path: Path, text: str, sentence: str
) -> None:
    path = tmp_path / "excitation.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        ExcitationSettings.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert sentence in str(caught.value)


def test_torque_below_gravity_admits_no_motion(arm_model: Robot) -> None:
    position = ((-1.0, 1.0), (0.0, 0.2), (0.0, 0.2))
    message = r"joint 'j2' needs \d+(\.\d+)? N\.m .* 5 N\.m"
    with pytest.raises(FitError, match=message):
        design(arm_model, with_limits(position=position, torque=(50.0, 5.0, 5.0)))


def test_torque_limits_used_up_by_gravity_admit_no_motion(arm_model: Robot) -> None:
    message = "limits allow no motion: gravity exceeds"
    with pytest.raises(FitError, match=message):
        design(arm_model, with_limits(torque=(1e-4, 1e-4, 1e-4)))


def test_limits_too_narrow_to_identify_anything_are_refused(arm_model: Robot) -> None:
    message = r"joint 'j3' at most 0\.0\d+ rad/s"
    with pytest.raises(FitError, match=message):
        design(arm_model, with_limits(position=((-1, 1), (-1, 1), (0.0, 0.002))))
