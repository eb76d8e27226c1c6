"""Standard errors against the scatter of repeated measurements."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_data import along, law, path, with_tau
from scipy.signal import lfilter

from hesr.extras.laws.strain_wave import StrainWave
from hesr_model.errors import SimulationError
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import Separable
from hesr_model.fitting.uncertainty import (
    MAX_COEFFICIENTS,
    add_standard_errors,
    measure_wider_side,
    pool_errors,
)
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.inference.covariance import correlation_length, standard_errors
from hesr_model.laws.dahl import DahlBasis
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS, LuGre, LuGreLoadRipple

TRUTH = law("strain_wave", {}, x_0=4e-3, mu_avg=0.12, mu_dif=0.03, F_c=5.0, sigma_2=7.0, tau_0=0.5)
CLEAN = along(TRUTH, path(0, from_rest=True))


def noise(seed: int, memory: float) -> np.ndarray:
    """White noise of 0.5 N.m, or autocorrelated noise of the same size."""
    white = np.random.default_rng(seed).normal(size=len(CLEAN.tau))
    coloured = lfilter([1.0], [1.0, -memory], white) * np.sqrt(1.0 - memory**2)
    return np.asarray(0.5 * coloured)


def refitted(tau: np.ndarray) -> FrictionLaw:
    """Fit of the law started at the truth, without a search."""
    samples = JointRows.from_records([with_tau(CLEAN, tau)], coefficients=6)
    problem = Separable(StrainWave.core({}), StrainWave().space(), samples)
    point = problem.polish(problem.point({"x_0": 4e-3}), evaluations=20)
    return replace(TRUTH, values=problem.values(point, problem.solve(point)[0]))


@pytest.mark.parametrize("memory", [0.0, 0.7])
def test_standard_errors_match_the_scatter_of_repeated_fits(memory: float) -> None:
    fits = [refitted(CLEAN.tau + noise(seed, memory)) for seed in range(60)]
    scatter = {name: np.std([f.values[name] for f in fits], ddof=1) for name in TRUTH.values}
    stated = [
        add_standard_errors(
            f, [with_tau(CLEAN, CLEAN.tau + noise(seed, memory))], StrainWave().space()
        ).standard_errors
        for seed, f in enumerate(fits[:10])
    ]
    for name in TRUTH.values:
        ratio = np.mean([s[name] for s in stated]) / scatter[name]
        # 60 fits determine the scatter to a tenth; fast columns see only a short memory.
        assert 0.7 < ratio < (1.45 if memory == 0.0 else 2.5), (name, ratio)


def test_the_truth_lies_within_two_errors_most_of_the_time() -> None:
    inside = []
    for seed in range(100, 130):
        tau = CLEAN.tau + noise(seed, 0.0)
        found = add_standard_errors(refitted(tau), [with_tau(CLEAN, tau)])
        inside += [
            abs(found.values[n] - v) < 1.96 * found.standard_errors[n]
            for n, v in TRUTH.values.items()
        ]
    assert 0.9 < np.mean(inside) < 0.99


def test_errors_of_a_linear_problem_equal_those_of_regression() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(400, 3)) * [1.0, 1e4, 1e-5]
    residual = rng.normal(size=400)
    residual -= x @ np.linalg.lstsq(x, residual)[0]
    variance = residual @ residual / 397 * correlation_length(residual)
    expected = np.sqrt(variance * np.diag(np.linalg.inv(x.T @ x)))
    np.testing.assert_allclose(standard_errors(x, residual), expected, rtol=1e-6)


def test_equal_columns_are_undetermined() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(400, 2))
    residual = rng.normal(size=400)
    twice = standard_errors(np.column_stack([x, x[:, 1]]), residual)
    plain = standard_errors(x, residual)
    assert twice[0] == pytest.approx(plain[0], rel=0.05)
    assert np.all(twice[1:] > 1e6 * plain[1])


# --- correlation ------------------------------------------------------------------------------


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8, 0.95])
def test_the_correlation_length_of_a_known_process(memory: float) -> None:
    """(1 + a) / (1 - a) for x[k] = a x[k-1] + noise."""
    found = [
        correlation_length(lfilter([1.0], [1.0, -memory], rng.normal(size=8000)))
        for rng in map(np.random.default_rng, range(8))
    ]
    assert np.mean(found) == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.25)


def test_the_correlation_length_is_at_least_one() -> None:
    assert correlation_length(np.ones(100)) == 1.0
    assert correlation_length(np.zeros(100)) == 1.0
    assert correlation_length(np.tile([1.0, -1.0], 50)) == 1.0
    white = np.random.default_rng(0).normal(size=1000)
    assert correlation_length(white) == pytest.approx(correlation_length(7.0 * white + 3.0))


# --- existence of errors ----------------------------------------------------------------------


def test_coefficients_without_effect_have_no_error() -> None:
    still = replace(CLEAN, tau_load=np.zeros_like(CLEAN.tau))
    found = add_standard_errors(TRUTH, [still])
    assert set(found.standard_errors) == set(TRUTH.values) - {"mu_avg", "mu_dif"}
    assert found.values == TRUTH.values


def test_more_data_reduce_the_errors() -> None:
    records = [
        with_tau(r, r.tau + 0.3 * np.random.default_rng(k).normal(size=len(r.tau)))
        for k, r in enumerate(along(TRUTH, path(k)) for k in range(4))
    ]
    one = add_standard_errors(TRUTH, records[:1]).standard_errors
    four = add_standard_errors(TRUTH, records).standard_errors
    assert np.mean([four[n] / one[n] for n in one]) == pytest.approx(0.5, rel=0.3)


def test_a_fit_states_the_errors_of_its_law() -> None:
    record = with_tau(CLEAN, CLEAN.tau + noise(0, 0.0))
    bare = DahlBasis().fit([record], np.random.default_rng(0))
    assert bare.standard_errors == {}
    found = fit_joint("dahl", [record], seed=0)
    carried = {n for n, value in found.values.items() if n.startswith("F_") and value > 0.0}
    # Deflections are given, and forces of zero are at their bound.
    assert set(found.standard_errors) == {*carried, "sigma_2", "tau_0"}
    assert all(error > 0.0 for error in found.standard_errors.values())
    assert found.covariance is not None
    assert found.covariance.names == tuple(n for n in found.values if n in found.standard_errors)


def test_coefficients_at_a_bound_have_no_interval() -> None:
    """With F_s / F_c at its bound, F_s has none, and F_c moves F_s with it."""
    ratio = STATIC_RATIO_BOUNDS[1]
    values = {"sigma_0": 4e3, "sigma_1": 0.0, "sigma_2": 5.0, "F_c": 4.0, "F_s": 4.0 * ratio,
              "v_s": 0.05, "tau_0": 0.1}  # fmt: skip
    truth = law("lugre", {}, **values)
    record = along(truth, path(0), noise=0.3)
    found = add_standard_errors(truth, [record], LuGre().space())
    assert set(found.standard_errors) == {"sigma_0", "sigma_2", "F_c", "v_s", "tau_0"}
    assert found.covariance is not None
    matrix, names = found.covariance.matrix, found.covariance.names
    for name, error in found.standard_errors.items():
        plain = float(np.sqrt(matrix[names.index(name), names.index(name)]))
        if name in ("sigma_2", "tau_0"):  # the torque is linear in these
            assert error == pytest.approx(plain, rel=1e-4)
        else:
            assert plain <= error < 1.2 * plain
    f_c, f_s = names.index("F_c"), names.index("F_s")
    assert matrix[f_s, f_s] == pytest.approx(ratio**2 * matrix[f_c, f_c], rel=1e-6)
    inside = add_standard_errors(
        replace(truth, values={**values, "F_s": 5.0, "sigma_1": 10.0}), [record], LuGre().space()
    )
    assert set(inside.standard_errors) == set(values)


def test_ripple_does_not_free_coefficients_at_a_bound() -> None:
    """Otherwise left-out errors, a step from a gradient that is not 0, would be too large."""
    ratio = STATIC_RATIO_BOUNDS[1]
    structure = LuGreLoadRipple.typical
    values = {"sigma_0": 4e3, "sigma_1": 10.0, "sigma_2": 5.0, "F_c": 4.0, "F_s": 4.0 * ratio,
              "v_s": 0.05, "tau_0": 0.1, "mu": 0.02, "ripple2_cos": 0.3, "ripple2_sin": 0.1,
              "lag": 0.003, "smoothing": 0.001}  # fmt: skip
    truth = law("lugre_load_ripple", structure, **values)
    found = add_standard_errors(
        truth, [along(truth, path(0), noise=0.3)], LuGreLoadRipple().build_fitted_space(truth)
    ).covariance
    assert found is not None
    f_c, f_s = found.names.index("F_c"), found.names.index("F_s")
    assert found.matrix[f_s, f_s] == pytest.approx(ratio**2 * found.matrix[f_c, f_c], rel=1e-6)


def test_a_nonlinear_coefficient_states_the_wider_side() -> None:
    """The upper side of log x and the lower one of x^2, whatever else is fitted."""
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(50, 2)) @ np.array([[1.0, 0.6], [0.0, 1.0]])
    point, error = np.array([3.0, 0.5]), 0.4
    covariance = error**2 * np.array([[1.0, -0.3], [-0.3, 2.0]])
    first = np.array([1.0, 0.0])
    for bent, slope, wanted in (
        (np.log, 1.0 / 3.0, 2.0 * error / 3.0 / np.log1p(2.0 * error / 3.0)),
        (np.square, 6.0, 1.0 / (1.0 - error / 3.0)),
        (np.asarray, 1.0, 1.0),
    ):

        def torque(x: np.ndarray, bent: Callable[..., np.ndarray] = bent) -> np.ndarray:
            return rows @ np.array([float(bent(x[0])), x[1]])

        def moved(step: np.ndarray, f: Callable[..., np.ndarray] = torque) -> tuple[float, Any]:
            return float(step[0]), f(point + step) - f(point)

        q, r = np.linalg.qr(rows * [slope, 1.0])
        found = measure_wider_side(first, covariance, q, r, moved)
        assert found == pytest.approx(wanted, rel=1e-12, abs=0.0)
    # If the law is undefined on one side, the other counts; the width is limited to four times.
    q, r = np.linalg.qr(rows)
    undefined = measure_wider_side(
        first, covariance, q, r, lambda x: (x[0], rows @ (np.nan * x if x[0] > 0.0 else x))
    )
    assert undefined == pytest.approx(1.0)
    flat = measure_wider_side(first, covariance, q, r, lambda x: (x[0], 0.01 * rows @ x))
    assert flat == 4.0


def test_an_interval_may_include_unstable_euler_steps() -> None:
    values = {"sigma_0": 1.0, "sigma_1": 0.0, "sigma_2": 5.0, "F_c": 4.0, "F_s": 4.0, "v_s": 0.05,
              "tau_0": 0.1}  # fmt: skip
    quiet = path(0)
    fastest = np.max(np.abs(quiet.dq)) * np.max(np.diff(quiet.t))
    values["sigma_0"] = 0.97 * values["F_c"] / fastest
    own = replace(law("lugre", {}, **values), discretisation="euler")
    record = along(own, quiet, noise=2.0)
    found = add_standard_errors(own, [record], LuGre().space())
    stiffer = values["sigma_0"] + found.standard_errors["sigma_0"]
    with pytest.raises(SimulationError, match="Euler needs"):
        predict_record(replace(own, values={**values, "sigma_0": stiffer}), record)


def test_a_chosen_structure_has_a_covariance_but_no_intervals() -> None:
    chosen = replace(TRUTH, structure={"of": "the data"})
    found = add_standard_errors(chosen, [with_tau(CLEAN, CLEAN.tau + noise(0, 0.0))])
    assert found.standard_errors == {}
    assert found.covariance is not None
    assert np.all(np.diag(found.covariance.matrix) > 0.0)


def test_load_errors_are_propagated() -> None:
    """A constant load error of 0.2 N.m makes the offset uncertain by the same amount."""
    record = with_tau(CLEAN, CLEAN.tau + noise(0, 0.0))
    alone = add_standard_errors(TRUTH, [record], StrainWave().space())
    off = replace(record, tau_load_spread=np.full((len(record.t), 1), 0.2))
    found = add_standard_errors(TRUTH, [off], StrainWave().space())
    more = found.standard_errors["tau_0"] ** 2 - alone.standard_errors["tau_0"] ** 2
    assert more == pytest.approx(0.2**2, rel=1e-6)
    assert found.standard_errors["sigma_2"] == pytest.approx(alone.standard_errors["sigma_2"])


def test_joints_share_differences_between_logs() -> None:
    one = add_standard_errors(TRUTH, [CLEAN, with_tau(CLEAN, CLEAN.tau + noise(0, 0.0))])
    assert one.covariance is not None
    between = [replace(one.covariance, between=b, degrees=10.0) for b in (1.0, 9.0)]
    alike, unlike = (
        replace(
            one,
            covariance=c,
            standard_errors={name: c.factor * e for name, e in one.standard_errors.items()},
        )
        for c in between
    )
    whole = pool_errors([alike, replace(one, covariance=None), unlike])
    assert whole[1].covariance is None
    for law_ in (whole[0], whole[2]):
        assert law_.covariance is not None
        assert law_.covariance.factor == pytest.approx(np.sqrt(5.0))
        for name, error in one.standard_errors.items():
            assert law_.standard_errors[name] == pytest.approx(
                np.sqrt(5.0) * error, rel=1e-12, abs=0.0
            )


def test_network_coefficients_have_no_errors() -> None:
    record = with_tau(CLEAN, CLEAN.tau + noise(0, 0.0))
    network = fit_joint("rbfnn_h", [record], seed=0)
    assert len(network.values) > MAX_COEFFICIENTS
    assert network.standard_errors == {}
