"""Rest and motion of joints with small strokes, and of resting joints with noise."""

import numpy as np
import pytest

from hesr_model.logs.rest import MOVING, find_resting_speeds, find_resting_travel, find_travelling
from hesr_model.logs.signals import reversals
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import require_reversals
from hesr_model.support.arrays import Array

T = np.arange(0.0, 20.0, 0.005)


def move(scale: float) -> tuple[Array, Array]:
    """Return q and dq (N, 1) of a sine with rests at both ends."""
    phase = 2.0 * np.pi * 0.5 * np.clip(T - 2.0, 0.0, 16.0)
    q = scale * (1.0 - np.cos(phase)) / np.pi
    dq = np.where((T > 2.0) & (T < 18.0), scale * np.sin(phase), 0.0)
    return q[:, None], dq[:, None]


@pytest.mark.parametrize("scale", [1e3, 30.0, 1.0, 1e-1, 1e-3, 1e-5])
def test_reversals_do_not_depend_on_the_stroke(scale: float) -> None:
    q, dq = move(scale)
    [speed] = find_resting_speeds([T], [q], [dq])
    assert speed == pytest.approx(np.clip(MOVING, 0.002 * scale, 0.1 * scale))
    np.testing.assert_array_equal(reversals(dq[:, 0], speed), reversals(move(1.0)[1][:, 0], MOVING))
    assert find_travelling([q]).all()


@pytest.mark.parametrize("scale", [0.21, 9.0])
def test_joints_of_usual_speed_rest_at_a_common_speed(scale: float) -> None:
    q, dq = move(scale)
    still = 0.0 * q
    assert find_resting_speeds([T, T], [q, still], [dq, still]).tolist() == [MOVING]


@pytest.mark.parametrize("unit", [2.0**-30, 2.0**-12, 2.0**12, 2.0**30])
def test_rest_does_not_depend_on_the_unit(unit: float) -> None:
    """Positions of a slow joint in other units, and of a fast one, rest in the same rows."""
    rng = np.random.default_rng(0)
    q, dq = move(0.01 if unit < 1.0 else 100.0)
    positions = [q + 1e-4 * np.ptp(q) * rng.standard_normal(q.shape), 0.0 * q]
    velocities = [dq, 0.0 * dq]
    scaled_positions = [unit * part for part in positions]
    scaled_velocities = [unit * part for part in velocities]
    np.testing.assert_array_equal(
        find_resting_speeds([T, T], scaled_positions, scaled_velocities),
        unit * find_resting_speeds([T, T], positions, velocities),
    )
    np.testing.assert_array_equal(
        find_resting_travel(scaled_positions), unit * find_resting_travel(positions)
    )
    np.testing.assert_array_equal(find_travelling(scaled_positions), find_travelling(positions))


def test_a_fast_motion_in_few_rows_travels() -> None:
    t = np.arange(0.0, 20.0, 0.04)
    q = np.sin(2.0 * np.pi * 4.0 * t)[:, None]
    assert find_travelling([q]).all()
    assert find_resting_travel([q])[0] < 0.3


@pytest.mark.parametrize("resolution", [0.0, 1e-5])
def test_noise_of_a_resting_joint_is_no_motion(resolution: float) -> None:
    rng = np.random.default_rng(0)
    q = 1e-5 * rng.standard_normal((len(T), 1))
    if resolution:
        q = resolution * np.round(q / resolution)
    dq = 1e-3 * rng.standard_normal((len(T), 1))
    assert not find_travelling([q]).any()
    assert find_resting_speeds([T], [q], [dq]).tolist() == [MOVING]


def test_a_rare_step_of_an_encoder_is_no_motion() -> None:
    q = np.where(T > 9.0, 1e-5, 0.0)[:, None]
    assert not find_travelling([q]).any()


def test_a_single_wrong_row_is_no_travel() -> None:
    q = 1e-6 * np.random.default_rng(0).standard_normal((len(T), 1))
    q[1234] = 4e-3
    assert not find_travelling([q]).any()


def test_what_other_joints_shake_does_not_travel() -> None:
    fast, _ = move(1.0)
    assert find_travelling([np.hstack([fast, 1e-3 * fast])]).tolist() == [True, False]
    assert find_travelling([1e-3 * fast]).tolist() == [True]


def test_a_joint_that_rests_in_one_log_does_not_move_there_by_noise() -> None:
    q, dq = move(1e-3)
    rng = np.random.default_rng(0)
    still = 1e-7 * rng.standard_normal(q.shape)
    still_dq = 2e-5 * rng.standard_normal(q.shape)
    [speed] = find_resting_speeds([T, T], [q, still], [dq, still_dq])
    assert len(reversals(dq[:, 0], speed)) == 15
    assert not len(reversals(still_dq[:, 0], speed))
    assert np.ptp(still) < find_resting_travel([q, still])[0] < np.ptp(q)


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_a_small_stroke_reverses(scale: float) -> None:
    q, dq = (column[:, 0] for column in move(scale))
    zeros = np.zeros_like(T)
    record = FrictionRecord(
        log="log", joint="axis", t=T, dq=dq, q=q, tau_load=zeros, tau=zeros, sliding=True
    )
    require_reversals([record])
