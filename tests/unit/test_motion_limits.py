"""Limits of a motion and the objective of its search, hand-computed."""

from dataclasses import replace

import numpy as np
import pytest

from hesr_model.motions.excitation import FourierSearch, _bound_condition, _compute_excess
from hesr_model.motions.limits import Limits, MotionLimits, peak_torque
from hesr_model.motions.trajectories import Fourier, sample_one_period
from hesr_model.robots.robot import Robot

NARROW = MotionLimits(
    position=((-0.4, 0.6), (-1.0, 1.0), (-1.0, 1.0)),
    velocity=(9.0, 0.5, 1.0),
    acceleration=(9.0, 9.0, 0.8),
    torque=(1e3, 1e3, 1e3),
)


@pytest.fixture
def limits(arm_model: Robot) -> Limits:
    return Limits.from_settings(arm_model, NARROW)


@pytest.fixture
def motion() -> Fourier:
    """The motion starts at rest: the sums of a_k and of k b_k are zero in each joint."""
    a = np.array([[1.0, -1.0, 0.0], [0.5, -0.2, -0.3], [0.2, 0.1, -0.3]])
    b = np.array([[0.0, 0.3, -0.2], [0.6, -0.3, 0.0], [-0.2, 0.4, -0.2]])
    return Fourier(offset=np.array([0.3, 0.0, -0.2]), a=a, b=b, period=4.0)


def test_a_period_has_256_points_per_highest_harmonic(motion: Fourier) -> None:
    t = 4.0 * np.arange(768) / 768
    for found, expected in zip(sample_one_period(motion), motion.sample(t), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-13)


def test_each_joint_is_shrunk_to_its_most_exceeded_limit(
    motion: Fourier, limits: Limits, arm_model: Robot
) -> None:
    """A thousandth inside the limits of position (first joint), speed (second) and rest (third).

    Offsets move no further than necessary.
    """
    kept = limits.shrink(motion, arm_model, np.zeros(3))
    q, dq, ddq = sample_one_period(motion)
    shares = np.array(
        [1.0 / np.ptp(q[:, 0]), 0.5 / np.abs(dq[:, 1]).max(), 0.8 / np.abs(ddq[:, 2]).max()]
    )
    assert np.all(shares < 1.0)
    np.testing.assert_allclose(kept.a, 0.999 * shares[:, None] * motion.a, rtol=1e-12)
    np.testing.assert_allclose(kept.b, 0.999 * shares[:, None] * motion.b, rtol=1e-12)
    np.testing.assert_array_equal(kept.offset[1:], motion.offset[1:])
    path = sample_one_period(kept)[0][:, 0]
    assert (path.min(), path.max()) == pytest.approx((-0.4 + 0.0005, 0.6 - 0.0005), abs=1e-9)


def test_the_torque_limit_shrinks_all_paths_towards_rest(
    motion: Fourier, limits: Limits, arm_model: Robot
) -> None:
    small = replace(motion, a=0.1 * motion.a, b=0.1 * motion.b)
    rest = np.array([0.0, -1.2, 0.3])
    still = replace(small, a=0.0 * small.a, b=0.0 * small.b, offset=rest)
    between = 0.5 * (peak_torque(arm_model, small) + peak_torque(arm_model, still))
    between[[0, 2]] = 1e3
    tight = replace(limits, torque=between)
    kept = tight.shrink(small, arm_model, rest)
    share = float(kept.a[0, 0] / small.a[0, 0])
    np.testing.assert_allclose(kept.a, share * small.a, rtol=1e-12)
    np.testing.assert_allclose(kept.b, share * small.b, rtol=1e-12)
    np.testing.assert_allclose(kept.offset, rest + share * (small.offset - rest), rtol=1e-12)
    # The largest share in multiples of 1/4096.
    assert share * 4096 == pytest.approx(round(share * 4096))
    assert peak_torque(arm_model, kept)[1] <= 0.999 * between[1]
    more = share + 1 / 4096
    larger = replace(
        small, a=more * small.a, b=more * small.b, offset=rest + more * (small.offset - rest)
    )
    assert peak_torque(arm_model, larger)[1] > 0.999 * between[1]


def test_peak_torque_comes_from_the_model_file(motion: Fourier, arm_model: Robot) -> None:
    tau = arm_model.torque(arm_model.nominal_parameters, *motion.sample(np.linspace(0, 4, 4001)))
    np.testing.assert_allclose(peak_torque(arm_model, motion), np.abs(tau).max(axis=0), rtol=1e-4)


# --- the objective ----------------------------------------------------------------------------


def test_the_excess_is_the_mean_square_above_a_limit() -> None:
    values = np.array([[1.0, -3.0], [-2.5, 0.0], [2.0, 1.0], [0.0, 0.0]])
    excess, slope = _compute_excess(values, np.array([2.0, 1.0]))
    assert excess == pytest.approx((0.25**2 + 2.0**2) / 4)
    expected = [[0.0, -2 * 2.0 / 1.0 / 4], [-2 * 0.25 / 2.0 / 4, 0.0], [0.0, 0.0], [0.0, 0.0]]
    np.testing.assert_allclose(slope, expected)


def test_norms_of_order_eight_bound_the_condition() -> None:
    """Squared singular values are 9, 4 and 1."""
    columns = np.zeros((2, 2, 3))
    columns.reshape(4, 3)[:3] = np.diag([3.0, 2.0, 1.0])
    value, slopes = _bound_condition(columns)
    squares = np.array([9.0, 4.0, 1.0])
    high, low = np.sum(squares**8), np.sum(squares**-8)
    assert value == pytest.approx(0.5 * np.log(high * low) / 8, rel=1e-12, abs=0.0)
    expected = np.diag([3.0, 2.0, 1.0]) * (squares**7 / high - squares**-9 / low)
    np.testing.assert_allclose(slopes.reshape(4, 3)[:3], expected, atol=1e-15)
    np.testing.assert_array_equal(slopes.reshape(4, 3)[3], 0.0)


def test_the_objective_weights_every_excess_over_a_cycle(
    motion: Fourier, limits: Limits, arm_model: Robot
) -> None:
    tight = replace(limits, torque=np.array([3.0, 8.0, 1.0]))
    search = FourierSearch(robot=arm_model, limits=tight, harmonics=3, period=(3.0, 9.0))
    x = search.pack(motion)
    assert search.bounds == [(None, None)] * 12 + [(-1.0, 1.0)] * 3 + [(np.log(3.0), np.log(9.0))]
    np.testing.assert_allclose(x[12:], [(0.3 - 0.1) / 0.5, 0.0, -0.2, np.log(4.0)])
    q, dq, ddq = motion.sample(4.0 * np.arange(120) / 120)
    tau = arm_model.torque(arm_model.nominal_parameters, q, dq, ddq)
    middle = np.array([0.1, 0.0, 0.0])
    bounded = ((q - middle, [0.5, 1, 1]), (dq, [9, 0.5, 1]), (ddq, [9, 9, 0.8]), (tau, [3, 8, 1]))
    excess = sum(np.sum(np.maximum(np.abs(v) / b - 1, 0) ** 2) / 120 for v, b in bounded)
    bare, _ = search.value_and_gradient(x, 0.0)
    assert search.value_and_gradient(x, 7.0)[0] - bare == pytest.approx(7.0 * excess, rel=1e-9)
    more = FourierSearch(robot=arm_model, limits=tight, harmonics=11, period=(3.0, 9.0))
    assert len(more._series[0]) == 12 * 11
