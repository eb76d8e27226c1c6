"""The rows of one joint from several records, and linear problems on them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hesr_model.errors import FitError, LogError
from hesr_model.fitting.joint_rows import JointRows, least_squares, non_negative_least_squares
from hesr_model.rigid_body.friction_record import FrictionRecord


def record(rows: int, *, log: str = "run", start: float = 0.0, seed: int = 0) -> FrictionRecord:
    rng = np.random.default_rng(seed)
    t = start + np.cumsum(rng.uniform(0.004, 0.02, rows))
    dq, q, load, tau = rng.normal(size=(4, rows))
    return FrictionRecord(log=log, joint="j1", t=t, dq=dq, q=q, tau_load=load, tau=tau)


def test_records_are_concatenated() -> None:
    first, second = record(5), record(3, log="two", start=100.0, seed=1)
    samples = JointRows.from_records([first, second], coefficients=3)
    for name in ("dq", "q", "tau_load", "tau"):
        expected = np.concatenate([getattr(first, name), getattr(second, name)])
        np.testing.assert_array_equal(getattr(samples, name), expected)
    np.testing.assert_array_equal(samples.log_index, [0] * 5 + [1] * 3)
    np.testing.assert_array_equal(np.flatnonzero(samples.begins), [0, 5])
    np.testing.assert_array_equal(samples.dt[1:5], np.diff(first.t))
    np.testing.assert_array_equal(samples.dt[6:], np.diff(second.t))


def test_no_time_passes_from_one_record_to_the_next() -> None:
    samples = JointRows.from_records([record(5), record(3, start=100.0, seed=1)], coefficients=3)
    np.testing.assert_array_equal(samples.dt[samples.begins], 0.0)
    assert samples.dt.max() < 0.03


def test_a_state_restarts_in_every_record() -> None:
    samples = JointRows.from_records([record(5), record(3, start=100.0, seed=1)], coefficients=3)
    factors, increments = np.full(8, 0.5), np.arange(8.0) + 1.0
    steady = np.arange(8.0) - 3.0
    speed = np.minimum(np.abs(samples.dq) / 0.02, 1.0)
    expected, x = [], 0.0
    for k in range(8):
        begins = speed[k] ** 2 * (3.0 - 2.0 * speed[k]) * steady[k]
        x = begins if k in (0, 5) else 0.5 * x + increments[k]
        expected.append(x)
    found = samples.recurrence(factors, increments, steady)
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_fewer_rows_than_coefficients_are_refused() -> None:
    samples = JointRows.from_records([record(5)], coefficients=5)
    assert len(samples.tau) == 5
    with pytest.raises(FitError) as caught:
        JointRows.from_records([record(5), record(2)], coefficients=8)
    assert "joint 'j1': 7 rows for 8" in str(caught.value)


def test_a_joint_must_reverse_in_one_of_the_records() -> None:
    one_way = FrictionRecord(**(vars(record(40)) | {"dq": np.linspace(0.0, 1.0, 40)}))
    JointRows.from_records([one_way, record(40, log="two")], coefficients=3)
    with pytest.raises(LogError, match=r"run.*joint 'j1' never reverses"):
        JointRows.from_records([one_way], coefficients=3)


def test_folds_are_logs_or_blocks_of_time() -> None:
    rows = [
        JointRows.from_records(
            [record(k, seed=k, log=str(k)) for k in counts], coefficients=1
        ).folds
        for counts in ((5, 3, 9), (40,), (41,))
    ]
    assert [fold.sum() for fold in rows[0]] == [5, 3, 9]
    assert [fold.sum() for fold in rows[1]] == [10, 10, 10, 10]
    for folds in rows:
        assert np.all(np.sum(folds, axis=0) == 1)  # every row is left out once
        for fold in folds:
            assert np.all(np.diff(np.flatnonzero(fold)) == 1)  # in one piece


# --- linear problems --------------------------------------------------------------------------


def test_least_squares_recovers_the_generating_coefficients() -> None:
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(50, 3))
    np.testing.assert_allclose(least_squares(columns, columns @ [1.0, -2.0, 3.0]), [1, -2, 3])


def test_least_squares_has_the_least_norm_for_equal_columns() -> None:
    column = np.arange(1.0, 6.0)
    np.testing.assert_allclose(least_squares(np.stack([column, column], axis=1), column), [0.5] * 2)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_non_negative_least_squares_finds_the_constrained_optimum(seed: int, bounded: int) -> None:
    """Nearly orthogonal columns, as in friction laws, and a random target."""
    rng = np.random.default_rng(seed)
    columns = np.linalg.qr(rng.normal(size=(60, 5)))[0] @ (
        np.eye(5) + 0.05 * rng.normal(size=(5, 5))
    )
    columns = columns * 10.0 ** rng.uniform(-3, 3, size=5)
    target = rng.normal(size=60) + columns @ (rng.normal(size=5) / np.linalg.norm(columns, axis=0))
    solution, cost = non_negative_least_squares(columns, target, non_negative=bounded)
    assert np.all(solution[:bounded] >= 0.0)
    assert cost == pytest.approx(np.sum((target - columns @ solution) ** 2), rel=1e-9)
    lower = np.where(np.arange(5) < bounded, 0.0, -np.inf)
    scale = np.linalg.norm(columns, axis=0)
    best = lsq_linear(columns / scale, target, (lower, np.inf), method="bvls")
    assert cost <= 2.0 * best.cost * (1.0 + 1e-2)


def test_unbounded_columns_may_be_negative() -> None:
    columns = np.eye(4)
    solution, cost = non_negative_least_squares(
        columns, np.array([1.0, -2.0, -3.0, 4.0]), non_negative=2
    )
    np.testing.assert_allclose(solution, [1.0, 0.0, -3.0, 4.0], atol=1e-15)
    assert cost == pytest.approx(4.0)


def test_a_column_of_zeros_gets_a_zero_coefficient() -> None:
    columns = np.stack([np.zeros(6), np.arange(6.0)], axis=1)
    solution, cost = non_negative_least_squares(columns, 2.0 * np.arange(6.0), non_negative=1)
    np.testing.assert_allclose(solution, [0.0, 2.0], atol=1e-12)
    assert cost == pytest.approx(0.0, abs=1e-12)


def test_the_worst_coefficient_is_scaled_by_its_column() -> None:
    """Two unit vectors at 120 degrees, the second in units a thousand times smaller.

    Both coefficients start negative, -1.13 and -0.27 for unit vectors. Without the first, the
    second is 0.3; without the second, the first is -1, so nothing would be left.
    """
    fine = 1e-3
    columns = np.array([[1.0, -0.5 * fine], [0.0, np.sqrt(0.75) * fine]])
    target = np.array([-1.0, -0.2 / np.sqrt(0.75)])
    solution, cost = non_negative_least_squares(columns, target, non_negative=2)
    np.testing.assert_allclose(solution, [0.0, 0.3 / fine], rtol=1e-12)
    assert cost == pytest.approx(target @ target - 0.3**2, rel=1e-12, abs=0.0)


def test_parts_of_one_log_are_no_folds_of_their_own() -> None:
    parts = [record(36), record(4, seed=1, start=100.0)]
    folds = JointRows.from_records(parts, coefficients=1).folds
    assert [fold.sum() for fold in folds] == [10, 10, 10, 10]
