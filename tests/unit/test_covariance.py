"""Least-squares covariance over logs, on processes with a known covariance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm
from scipy.stats import t as student
from significance import long_run_of

from hesr_model.inference.covariance import (
    MIN_SCATTER_LOGS,
    Covariance,
    blocks_of_time,
    covariance,
    leave_out_rows,
    pool_covariances,
)

NAMES = ("a", "b", "c")


def problem(
    rng: np.random.Generator, logs: int, rows: int, *, memory: float = 0.0, differ: float = 0.0
) -> tuple[Covariance, np.ndarray]:
    """Return the covariance and the estimates of a regression whose truth is zero."""
    x = rng.normal(size=(logs * rows, 3)) * [1.0, 100.0, 0.01]
    # The columns are autocorrelated, so that the memory of the residuals matters.
    x = lfilter([1.0], [1.0, -0.8], x, axis=0)
    labels = np.repeat(np.arange(logs), rows)
    noise = lfilter([1.0], [1.0, -memory], rng.normal(size=len(x)))
    own = differ * rng.normal(size=(logs, 3)) / [1.0, 100.0, 0.01]
    y = noise + np.sum(x * own[labels], axis=1)
    estimate = np.linalg.lstsq(x, y, rcond=None)[0]
    hessians = [x[labels == k].T @ x[labels == k] for k in range(logs)]
    return covariance(NAMES, x * (y - x @ estimate)[:, None], hessians, labels), estimate


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_standard_errors_match_the_scatter_of_repetitions(memory: float) -> None:
    made = [problem(np.random.default_rng(k), 3, 400, memory=memory) for k in range(150)]
    z = np.array([estimate / np.sqrt(np.diag(c.within)) for c, estimate in made])
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.12)
    assert np.mean([c.between for c, _ in made]) == pytest.approx(1.0, abs=0.12)
    # Without differences between logs a factor is found as often as chance allows.
    assert np.mean([c.factor > 1.0 for c, _ in made]) < 0.15


def test_differences_between_logs_widen_all_errors() -> None:
    made = [problem(np.random.default_rng(k), 3, 400, differ=0.2) for k in range(80)]
    within = np.array([estimate / np.sqrt(np.diag(c.within)) for c, estimate in made])
    whole = np.array([estimate / c.standard_errors for c, estimate in made])
    assert np.mean(np.abs(within) > 1.96) > 0.4
    # Three logs determine their differences only to a factor: more than one in twenty lies outside.
    assert np.mean(np.abs(whole) > 1.96) < 0.2
    one = made[0][0]
    np.testing.assert_allclose(one.matrix, one.between * one.within, rtol=1e-12)


def test_many_logs_use_their_own_scatter() -> None:
    made = [problem(np.random.default_rng(k), MIN_SCATTER_LOGS, 60, differ=0.2) for k in range(60)]
    z = np.array([estimate / c.standard_errors for c, estimate in made])
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.15)
    assert made[0][0].degrees == 0.0
    assert made[0][0].factor == 1.0


def test_an_unused_unknown_does_not_affect_the_others() -> None:
    rng = np.random.default_rng(0)
    x = np.column_stack([rng.normal(size=(300, 2)), np.zeros(300)])
    gradients, labels = x * rng.normal(size=(300, 1)), np.repeat([0, 1, 2], 100)
    hessians = [x[labels == k].T @ x[labels == k] for k in range(3)]
    with_it = covariance(NAMES, gradients, hessians, labels)
    without = covariance(NAMES[:2], gradients[:, :2], [h[:2, :2] for h in hessians], labels)
    np.testing.assert_allclose(with_it.within[:2, :2], without.within, rtol=0.02)
    assert np.all(with_it.within[2] == 0.0)


def test_priors_and_propagated_errors_are_separate() -> None:
    """Without data, a prior of weight k has the error 1 / k."""
    nothing = np.zeros((50, 1))
    labels = np.repeat([0, 1], 25)
    pull = covariance(
        ("a",), nothing, [np.zeros((1, 1))] * 2, labels, prior_hessian=np.array([[16.0]])
    )
    assert pull.matrix[0, 0] == pytest.approx(1.0 / 16.0)
    hessians = [np.array([[10.0]])] * 2
    off = covariance(("a",), nothing, hessians, labels, carried=np.array([[3.0, 4.0]]))
    assert off.matrix[0, 0] == pytest.approx((3.0**2 + 4.0**2) / 20.0**2)


def test_residuals_are_leave_one_out() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(12, 3)), rng.normal(size=12)
    residual = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    found = leave_out_rows(x, residual, x.T @ x)
    for row in range(12):
        others = np.arange(12) != row
        without = np.linalg.lstsq(x[others], y[others], rcond=None)[0]
        assert found[row] == pytest.approx(y[row] - x[row] @ without, rel=1e-9)


def test_few_influential_rows_widen_the_errors() -> None:
    """Ten rows of influence 1: 3 (sum of squares)^2 / sum of fourth powers = 30 degrees."""
    gradients = np.tile([[1.0], [-1.0]], (5, 1))
    labels = np.repeat([0, 1], 5)
    found = covariance(("a",), gradients, [np.full((1, 1), 0.5)] * 2, labels).within[0, 0]
    plain = float(np.sum(long_run_of([gradients[:5], gradients[5:]])))
    assert found / plain == pytest.approx((student.ppf(0.975, 30.0) / norm.ppf(0.975)) ** 2)


def test_a_single_log_is_split_into_time_blocks() -> None:
    np.testing.assert_array_equal(blocks_of_time(np.zeros(8, dtype=int)), [0, 0, 1, 1, 2, 2, 3, 3])
    two = np.array([0, 0, 1, 1])
    assert blocks_of_time(two) is two


def test_a_group_has_one_factor() -> None:
    c = Covariance(
        names=("a",), within=np.eye(1), between=9.0, degrees=20.0, carried=np.zeros((1, 1))
    )
    first, second = pool_covariances([c, replace(c, between=3.0, degrees=10.0)])
    assert first.between == second.between == pytest.approx((9.0 * 20.0 + 3.0 * 10.0) / 30.0)
    assert first.factor == pytest.approx(np.sqrt(7.0))
    alone = replace(c, degrees=0.0)
    assert pool_covariances([alone])[0].factor == 1.0


def test_covariance_of_functions_follows_from_their_slopes() -> None:
    c, _ = problem(np.random.default_rng(3), 3, 200)
    slopes = np.array([[1.0, 1.0, 0.0], [0.0, 2.0, -1.0]])
    mapped = c.transform(("sum", "other"), slopes)
    np.testing.assert_allclose(mapped.matrix, slopes @ c.matrix @ slopes.T, rtol=1e-12)
    assert mapped.names == ("sum", "other")
    assert mapped.factor == c.factor


@pytest.mark.parametrize("memory", [-0.5, 0.0, 0.6, 0.95])
def test_the_long_run_variance_of_a_known_process(memory: float) -> None:
    """Variance of the sum of n values of x[k] = a x[k-1] + noise is n / (1 - a)^2."""
    rng = np.random.default_rng(5)
    made = [lfilter([1.0], [1.0, -memory], rng.normal(size=(2000, 1)), axis=0) for _ in range(6)]
    found = np.mean([part[0, 0] for part in long_run_of(made)])
    assert found == pytest.approx(2000.0 / (1.0 - memory) ** 2, rel=0.25)
