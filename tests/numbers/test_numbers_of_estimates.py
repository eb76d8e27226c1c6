"""Covariances, comparisons, deviations and bands of random data."""

from dataclasses import replace

import numpy as np
import pytest
from joint_data import law
from scipy.signal import lfilter
from significance import long_run_of
from unchanged import Unchanged

from hesr.extras.fleet.deviation import compute_deviations, fit_trend
from hesr_model.fitting import calibration, uncertainty
from hesr_model.fitting.separable import SearchSpace
from hesr_model.inference.comparison import adjust_by_holm, law_errors
from hesr_model.inference.covariance import (
    Covariance,
    blocks_of_time,
    correlation_length,
    covariance,
    leave_out_rows,
    pool_covariances,
    standard_errors,
)
from hesr_model.logs.rest import MOVING
from hesr_model.rigid_body.friction_record import FrictionRecord

LUGRE = {"sigma_0": 500.0, "sigma_1": 0.5, "sigma_2": 4.5, "F_c": 7.5, "F_s": 10.0, "v_s": 0.12,
         "tau_0": 0.4, "mu": 0.03}  # fmt: skip


def alike(seed: int, rows: int, memory: float, columns: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return lfilter([1.0], [1.0, -memory], rng.normal(size=(rows, columns)), axis=0)


def problem(logs: int, rows: int = 90) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    labels = np.repeat(np.arange(logs), rows)
    jacobian = alike(1, logs * rows, 0.8, 3) * [1.0, 30.0, 0.02]
    residual = alike(2, logs * rows, 0.6)[:, 0] + 0.4 * np.sin(labels)
    return jacobian, residual, labels


# --- covariances ------------------------------------------------------------------------------


@pytest.mark.parametrize("logs", [1, 2, 5, 19, 20])
def test_a_covariance(logs: int, unchanged: Unchanged) -> None:
    jacobian, residual, labels = problem(logs)
    labels = blocks_of_time(labels)
    hessians = [jacobian[labels == k].T @ jacobian[labels == k] for k in range(labels[-1] + 1)]
    gradients = jacobian * leave_out_rows(jacobian, residual, np.sum(hessians, axis=0))[:, None]
    plain = covariance("abc", gradients, hessians, labels)
    known = covariance(
        "abc",
        gradients,
        hessians,
        labels,
        prior_hessian=np.diag([10.0, 3e4, 0.1]),
        carried=np.array([[1.0, 0.5], [30.0, -20.0], [0.02, 0.1]]),
    )
    unchanged({
        "plain": plain, "factor": plain.factor, "matrix": plain.matrix,
        "errors": plain.standard_errors, "known": known, "of known": known.matrix,
        "mapped": known.transform("de", np.array([[1.0, 0.1, 2.0], [0.0, 1.0, -50.0]])).matrix,
        "sums": [m.tolist() for m in long_run_of(np.split(gradients, labels[-1] + 1)
                                              if logs > 1 else [gradients])],
    })  # fmt: skip


def test_the_leverage_of_a_row_is_limited() -> None:
    """Leverage is capped at 0.9."""
    jacobian = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    found = leave_out_rows(jacobian, np.ones(5), jacobian.T @ jacobian)
    np.testing.assert_allclose(found, [10.0, *[4.0 / 3.0] * 4], rtol=1e-9)


def test_random_differences_between_logs_give_no_factor() -> None:
    """With 4 degrees of freedom, chi squared exceeds 9.488 by chance in one of twenty cases."""

    def of(between: float, degrees: float = 4.0) -> Covariance:
        one = np.eye(1)
        return Covariance(
            names=("a",), within=one, between=between, degrees=degrees, carried=0.0 * one
        )

    assert of(2.37).factor == 1.0
    assert of(2.375).factor == pytest.approx(np.sqrt(2.375))
    assert of(2.375, 0.0).factor == 1.0
    group = pool_covariances([of(1.0, 2.0), of(4.0, 6.0)])
    assert [(c.between, c.degrees) for c in group] == [(3.25, 8.0)] * 2
    assert [c.between for c in pool_covariances([of(3.0, 0.0)])] == [3.0]


def test_memory_of_residuals(unchanged: Unchanged) -> None:
    found = {}
    for memory in (0.0, 0.5, 0.95, -0.5):
        residual = alike(3, 401, memory)[:, 0]
        jacobian = alike(4, 401, 0.7, 3) * [1.0, 1e3, 1e-3]
        found[str(memory)] = {
            "length": correlation_length(residual),
            "errors": standard_errors(jacobian, residual),
        }
    drift = np.linspace(-1.0, 1.0, 64)
    unchanged({**found, "drift": correlation_length(drift)})
    assert correlation_length(np.ones(16)) == 1.0


# --- comparisons ------------------------------------------------------------------------------


@pytest.mark.parametrize(("logs", "rows"), [(1, 2500), (3, 4000), (7, 900), (9, 400), (16, 50)])
def test_a_comparison(logs: int, rows: int, unchanged: Unchanged) -> None:
    above = [0.9 * alike(k, rows, 0.9)[:, 0] for k in range(logs)]
    below = [alike(100 + k, rows, 0.8)[:, 0] for k in range(logs)]
    third = [0.5 * (a + b) for a, b in zip(above, below, strict=True)]
    periods = [0.01 + 0.001 * k for k in range(logs)]
    errors = law_errors({"above": above, "below": below, "third": third}, periods)
    found = {"errors": errors, "ratios": errors.ratios("third")}
    if not errors.too_short:
        found["seconds"] = errors.required_seconds("above", "third", 1.1)
    unchanged(found)


def test_adjusted_probabilities() -> None:
    found = adjust_by_holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.9})
    assert found == pytest.approx({"a": 0.04, "b": 0.09, "c": 0.09, "d": 0.9})
    assert adjust_by_holm({"a": 0.6, "b": 0.7}) == {"a": 1.0, "b": 1.0}


# --- deviations -------------------------------------------------------------------------------


def test_deviations_and_trends(unchanged: Unchanged) -> None:
    values = [3.0, 3.1, 2.9, 3.3, 2.8, 9.0, 0.4]
    errors = [None, 0.1, 0.1, None, 0.2, 4.0, 0.01]
    days = [0.0, 1.0, 3.0, 4.0, 9.0, 10.0, 11.0]
    unchanged({
        "positive": compute_deviations(values, errors),
        "both signs": compute_deviations([v - 3.0 for v in values], errors),
        "alike": compute_deviations([2.0, 2.0, 2.0, 2.0, 2.0, 2.001], [None] * 6),
        "zeros": compute_deviations([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [None] * 6),
        "none": compute_deviations([0.0] * 5, [None] * 5),
        "trend": fit_trend(days, values),
        "line": fit_trend(days[:5], [1.0 + 0.5 * d for d in days[:5]]),
    })  # fmt: skip
    assert fit_trend(days[:4], values[:4]) is None
    assert fit_trend([1.0] * 6, values[:6]) is None
    level = fit_trend(days[:5], [0.0] * 5)
    assert level is not None
    assert (level.slope, level.p) == (0.0, 1.0)


# --- coefficients and bands -------------------------------------------------------------------

SPACE = SearchSpace(
    bounds=(("v_s", (1e-3, 1.0)), ("sigma_0", (10.0, 500.0))),
    linear=("sigma_1", "sigma_2", "F_c", "F_s", "mu", "tau_0"), non_negative=5,
)  # fmt: skip


@pytest.mark.parametrize("spread", [False, True])
@pytest.mark.parametrize("space", [None, SPACE])
def test_intervals_of_coefficients(
    spread: bool, space: SearchSpace | None, records: list[FrictionRecord], unchanged: Unchanged
) -> None:
    of = law("lugre_load", {}, **LUGRE)
    logs = records
    if spread:
        logs = [replace(r, tau_load_spread=np.stack([0.01 * r.q, 0.02 * r.dq], 1)) for r in logs]
        of = law("lugre_load", {}, **LUGRE | {"sigma_1": 0.0})
    found = uncertainty.add_standard_errors(of, logs, space)
    assert found.covariance is not None
    banded = calibration.calibrate_band(found, logs)[0]
    two = uncertainty.pool_errors([found, of, replace(found, values=LUGRE)])
    unchanged({
        "covariance": found.covariance, "errors": found.standard_errors, "band": banded.band,
        "names": [sum(map(ord, n)) for n in found.standard_errors],
        "pooled": [one.standard_errors for one in two],
        "sensitivities": calibration._compute_sensitivities(found, logs[:1])[::50].tolist(),
        "left out": calibration._cross_validate_band(found, logs),
    }, rtol=1e-3)  # fmt: skip


def test_parts_of_a_band(records: list[FrictionRecord], unchanged: Unchanged) -> None:
    of = law("lugre_load", {}, **LUGRE)
    rng = np.random.default_rng(5)
    columns = np.abs(rng.normal(size=(300, 3))) * [1.0, 0.1, 0.0]
    squares = rng.normal(size=300) ** 2 * (0.3 + columns[:, 1])
    standard = np.abs(rng.standard_t(4, size=500))
    many = [
        replace(records[0], dq=np.where(np.arange(len(r.t)) % 80 < 70, 0.0, 1.0))
        for r in records[:1]
    ]
    unchanged({
        "alone": calibration.calibrate_band(of, records)[0].band,
        "rested": calibration.calibrate_band(of, [*records, *many])[0].band,
        "shares": calibration.fit_variance_shares(columns, squares, np.zeros(300)),
        "with known": calibration.fit_variance_shares(columns, squares, np.full(300, 0.1)),
        "none": calibration.fit_variance_shares(columns, 0.0 * squares, np.zeros(300)),
        "tails": [calibration._fit_tail(standard**k, float(np.quantile(standard**k, 0.95)))
                  for k in (0.2, 0.8, 1.0, 4.0)],
        "no tail": calibration._fit_tail(0.0 * standard, 0.0),
        "rests": [calibration._count_rests(r, MOVING) for r in (*records, *many)],
    }, rtol=1e-5)  # fmt: skip


def test_a_rest_lasts_half_a_second() -> None:
    t = 0.125 * np.arange(40)
    flat = np.zeros(40)
    one = FrictionRecord(log="a", joint="j1", t=t, dq=flat, q=flat, tau_load=flat, tau=flat)

    def rests(*still: range) -> int:
        dq = np.ones(40)
        for rows in still:
            dq[list(rows)] = 0.0199
        return calibration._count_rests(replace(one, dq=dq), MOVING)

    assert rests(range(4)) == 0
    assert rests(range(5)) == 1
    assert rests(range(5), range(6, 11), range(35, 40)) == 3
    assert calibration._count_rests(replace(one, dq=np.full(40, 0.02)), MOVING) == 0
    assert calibration._count_rests(replace(one, dq=np.full(40, -0.0199)), MOVING) == 1


@pytest.mark.parametrize(("rests", "envelope"), [(9, 1.0), (10, 0.0)])
def test_ten_rests_determine_the_band_at_rest(rests: int, envelope: float) -> None:
    t = 0.1 * np.arange(400)
    dq = 0.5 * np.sin(t)
    for k in range(rests):
        dq[40 * k : 40 * k + 8] = 0.0
    flat = np.zeros(400)
    noise = np.random.default_rng(0).normal(size=400)
    one = FrictionRecord(log="a", joint="j1", t=t, dq=dq, q=flat, tau_load=flat, tau=noise)
    band = calibration.calibrate_band(law("lugre_load", {}, **LUGRE), [one])[0].band
    assert band is not None
    assert band.envelope == envelope


def test_values_at_their_bounds_are_fixed() -> None:
    for number, held in ((1.0069, True), (1.0070, False), (992.0, False), (993.2, True)):
        assert uncertainty._is_at_end(number, 1.0, 1000.0) == held
    for number, held in ((-0.9981, True), (-0.9979, False), (0.9979, False), (0.9981, True)):
        assert uncertainty._is_at_end(number, -1.0, 1.0) == held
