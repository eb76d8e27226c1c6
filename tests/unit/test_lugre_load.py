"""LuGre with load, optionally with ripple and an estimated start."""

import numpy as np
import pytest
from joint_data import along, error_on, law, path, training, unseen, with_tau

from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.records import predict_record
from hesr_model.laws.lugre import LuGre, LuGreLoad, LuGreLoadRipple

CASES = [
    {"sigma_0": 3000.0, "sigma_1": 15.0, "sigma_2": 6.0, "F_c": 9.0, "F_s": 12.0, "v_s": 0.1,
     "tau_0": 0.4, "mu": 0.02},
    {"sigma_0": 900.0, "sigma_1": 2.0, "sigma_2": 12.0, "F_c": 12.0, "F_s": 8.0, "v_s": 0.3,
     "tau_0": -0.6, "mu": 0.005},
]  # fmt: skip


@pytest.mark.parametrize("values", CASES)
def test_generating_coefficients_are_found(values: dict[str, float]) -> None:
    generating = law("lugre_load", {}, **values)
    relaxed = values["F_s"] < values["F_c"]
    entry = LuGreLoad(relaxed=relaxed)
    fitted = entry.fit(training(generating, noise=0.0), np.random.default_rng(0))
    for name, value in values.items():
        assert fitted.values[name] == pytest.approx(value, rel=0.03), name
    assert error_on(fitted, unseen(generating)) < 1e-2


def test_the_load_term_improves_load_dependent_friction() -> None:
    generating = law("lugre_load", {}, **CASES[0])
    records, test = training(generating, noise=0.3), unseen(generating)
    rng = np.random.default_rng(0)
    plain, loaded = LuGre().fit(records, rng), LuGreLoad().fit(records, rng)
    assert error_on(loaded, test) < 0.1 * error_on(plain, test)


def test_the_load_term_vanishes_without_dependence() -> None:
    values = {k: v for k, v in CASES[0].items() if k != "mu"}
    records = training(law("lugre", {}, **values), noise=0.3)
    fitted = LuGreLoad().fit(records, np.random.default_rng(0))
    assert abs(fitted.values["mu"]) * 25.0 < 0.02  # of F_c at the largest load


def test_friction_may_fall_with_the_load() -> None:
    generating = law("lugre_load", {}, **(CASES[0] | {"mu": -0.01}))
    fitted = LuGreLoad().fit(training(generating, noise=0.1), np.random.default_rng(0))
    assert fitted.values["mu"] == pytest.approx(-0.01, rel=0.1)


def test_a_joint_without_friction_gets_a_valid_law() -> None:
    record = along(law("lugre_load", {}, **CASES[0]), path(0))
    for tau in (np.zeros_like(record.tau), 3.0 * record.dq):
        fitted = LuGreLoad().fit([with_tau(record, tau)], np.random.default_rng(0))
        np.testing.assert_allclose(predict_record(fitted, record), tau, atol=0.1)


def test_standard_errors_exist_for_a_coefficient_at_its_bound() -> None:
    """Other terms are divided by F_c, so its difference step must not cross zero."""
    record = along(law("lugre_load", {}, **CASES[0]), path(0))
    for name in ("lugre", "lugre_load"):
        fitted = fit_joint(name, [with_tau(record, 3.0 * record.dq)], seed=0)
        assert fitted.values["F_c"] < 1e-6
        assert np.all(np.isfinite(list(fitted.standard_errors.values())))
        assert "sigma_2" in fitted.standard_errors
        assert "F_c" not in fitted.standard_errors  # it is at its bound


def test_the_bristle_start_comes_from_the_first_samples() -> None:
    """A log that begins with the bristle bent the other way."""
    generating = law("lugre_load", {}, **CASES[1])
    entry = LuGreLoadRipple(relaxed=True)
    fitted = entry.fit(training(generating, noise=0.05), np.random.default_rng(0))
    assert fitted.start_samples == 5
    way = path(7, peak=0.9)
    bent = -0.8 * CASES[1]["F_c"] / CASES[1]["sigma_0"] * np.sign(way.dq[0])
    log = along(generating, way, start=(float(bent),))
    first = slice(0, 12)
    estimated = np.abs(predict_record(fitted, log, measured_start=True) - log.tau)[first].max()
    from_zero = np.abs(
        predict_record(LuGreLoad().fit([log], np.random.default_rng(0)), log) - log.tau
    )[first].max()
    assert estimated < 0.3
    assert from_zero > 3.0
