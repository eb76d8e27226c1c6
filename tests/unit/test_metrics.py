import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hesr_model.friction.records import (
    score,
    score_band,
    time_band,
)
from hesr_model.logs.rest import MOVING
from hesr_model.logs.signals import near_reversals, reversals
from hesr_model.rigid_body.friction_record import FrictionRecord


def record(t: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> FrictionRecord:
    zero = np.zeros_like(t)
    return FrictionRecord(log="run", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)


def test_a_reversal_lies_at_the_smallest_speed_between() -> None:
    dq = np.array([0.5, 0.1, 0.015, -0.004, 0.003, -0.01, -0.1, -0.5, -0.03, 0.021])
    np.testing.assert_array_equal(reversals(dq, MOVING), [4, 9])


@pytest.mark.parametrize(
    "dq",
    [
        [0.5, 0.1, 0.0, 0.0, 0.1, 0.5],  # a rest during the motion
        [0.5, 0.1, 0.01, -0.019, 0.01, 0.1],  # noise at rest
        [0.0, 0.0, 0.0],
        [0.01, -0.01, 0.01],
    ],
)
def test_a_rest_is_not_a_reversal(dq: list[float]) -> None:
    assert len(reversals(np.array(dq), MOVING)) == 0


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=40))
def test_reversals_are_symmetric_in_sign_and_one_per_change(values: list[float]) -> None:
    dq = np.array(values)
    found = reversals(dq, MOVING)
    np.testing.assert_array_equal(found, reversals(-dq, MOVING))
    signs = np.sign(dq[np.abs(dq) > 0.02])
    assert len(found) == np.count_nonzero(np.diff(signs))
    assert np.all(np.diff(found) >= 0)


def test_windows_extend_a_tenth_of_a_second_to_either_side() -> None:
    t = np.arange(0, 2, 0.01) + 5.0
    near = near_reversals(t, np.cos(np.pi * (t - 5.0) + 1e-9), MOVING)
    expected = (np.abs(t - 5.5) < 0.1001) | (np.abs(t - 6.5) < 0.1001)
    np.testing.assert_array_equal(near, expected)


def test_a_score_pools_the_rows_of_all_logs() -> None:
    t = np.arange(0, 4, 0.01)
    dq = np.sin(np.pi * t + 0.5)
    first = record(t, dq, 3.0 * np.sign(dq))
    second = record(t[:100], np.zeros(100), np.full(100, 1.0))
    predictions = [first.tau - 0.3 * np.sign(dq), second.tau - 0.6]
    result = score([first, second], predictions)
    assert result.tau_std == pytest.approx(np.std(np.concatenate([first.tau, second.tau])))
    assert result.rmse == pytest.approx(np.sqrt((400 * 0.3**2 + 100 * 0.6**2) / 500))
    assert result.rmse_moving == pytest.approx(0.3)
    assert result.rmse_reversal == pytest.approx(0.3)
    assert result.r2 == pytest.approx(1 - (result.rmse / result.tau_std) ** 2)


def test_a_score_without_rows_is_none() -> None:
    still = record(np.arange(5) * 0.1, np.zeros(5), np.ones(5))
    result = score([still], [np.zeros(5)])
    assert (result.rmse, result.tau_std) == (1.0, 0.0)
    assert (result.rmse_moving, result.rmse_reversal, result.r2) == (None, None, None)


def test_the_score_of_a_band_counts_its_rows_and_compares_its_width() -> None:
    t = 0.01 * np.arange(200)
    dq = np.where(t < 1.0, 0.0, 0.5)
    moved = record(t, dq, np.where(t < 1.0, 0.0, 4.0))
    still = record(t[:50], np.zeros(50), np.ones(50))
    # 80 of 100 rows at rest are inside (on the edge), all in motion, none of the second log.
    upper = np.where(t < 1.0, np.where(t < 0.795, 0.0, -1.0), 7.0)
    bands = [(np.full(200, -3.0), upper), (np.full(50, 2.0), np.full(50, 6.0))]
    torque = [np.where(t < 1.0, 0.1, 1.0), np.full(50, 6.0)]
    found = score_band([moved, still], torque, bands)
    assert found.held == pytest.approx(180 / 250)
    assert found.held_moving == 1.0
    assert found.held_reversal is None
    assert found.least_log == 0.0
    # Errors are 0.1, 3 and 5 N.m on 100, 100 and 50 rows: their 72 % quantile is 3 N.m.
    mean = (80 * 3.0 + 20 * 2.0 + 100 * 10.0 + 50 * 4.0) / 250
    assert found.width == pytest.approx(mean / 6.0)
    perfect = score_band([still], [still.tau], [(still.tau, still.tau)])
    assert (perfect.held, perfect.width) == (1.0, None)


def test_a_band_includes_its_start_but_not_its_stop() -> None:
    t = np.array([0.0, 1.0, 2.0, 2.6, 3.0])
    np.testing.assert_array_equal(time_band(t, 1.0, 2.6), [False, True, True, False, False])
    np.testing.assert_array_equal(time_band(t, 2.6, 9.0), [False, False, False, True, True])
