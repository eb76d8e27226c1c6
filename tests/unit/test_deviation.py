"""Outliers and trends: few false alarms, and none without support in the data."""

import numpy as np
import pytest
from scipy import stats

from hesr.extras.fleet.deviation import compute_deviations, fit_trend


@pytest.mark.parametrize("n", [5, 6, 8, 20, 100])
def test_the_false_alarm_rate_is_as_stated(n: int) -> None:
    rng = np.random.default_rng(n)
    p = [
        one.p
        for _ in range(6000 // n)
        for one in compute_deviations(rng.standard_normal(n), [None] * n)
    ]
    for level in (0.05, 0.01):
        assert np.mean(np.array(p) < level) < 1.3 * level + 0.001


def test_only_the_outlier_is_found() -> None:
    values = [*np.random.default_rng(0).normal(10.0, 0.1, 60), 13.0]
    found = compute_deviations(values, [None] * 61)
    assert found[-1].p < 1e-9
    assert found[-1].z > 15.0
    assert found[-1].median == pytest.approx(np.median(values))
    assert min(one.p for one in found[:-1]) > 1e-3


def test_positive_values_are_compared_by_their_ratios() -> None:
    values = np.exp(np.random.default_rng(1).normal(0.0, 1.0, 50)) * 1e5
    up, down = (
        compute_deviations([*values, np.median(values) * f], [None] * 51)[-1] for f in (9.0, 1 / 9)
    )
    assert up.z == pytest.approx(-down.z, rel=0.1)


def test_uncertain_values_are_not_outliers() -> None:
    values, errors = [1.0, 1.01, 0.99, 1.02, 0.98, 2.0], [0.01] * 5
    sure, unsure = (compute_deviations(values, [*errors, own])[-1].z for own in (0.01, 0.9))
    assert sure > 20.0
    assert unsure < 2.0


def test_equal_values_are_not_outliers() -> None:
    for value in (0.0, 3.0, -3.0):
        assert [one.z for one in compute_deviations([value] * 6, [None] * 6)] == [0.0] * 6
    assert compute_deviations([0.0] * 6 + [5.0], [None] * 7)[-1].z > 100.0
    # Values within a thousandth count as equal.
    assert abs(compute_deviations([3.0] * 6 + [3.001], [None] * 7)[-1].z) < 1.0


def test_a_trend_is_the_least_squares_line() -> None:
    rng = np.random.default_rng(2)
    days = np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0])
    values = 1.0 + 0.02 * days + 0.05 * rng.standard_normal(6)
    found, known = fit_trend(days, values), stats.linregress(days, values)
    assert found is not None
    assert found.slope == pytest.approx(known.slope)
    assert found.p == pytest.approx(known.pvalue)
    assert found.change == pytest.approx(9.0 * known.slope)


def test_no_trend_without_support() -> None:
    assert fit_trend([0.0, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0]) is None
    assert fit_trend([3.0] * 6, range(6)) is None
    constant = fit_trend(range(6), [0.0] * 6)
    assert constant is not None
    assert (constant.slope, constant.p) == (0.0, 1.0)
    exact = fit_trend(range(6), [1.0 + 0.1 * k for k in range(6)])
    assert exact is not None
    assert exact.p < 1e-9
