"""Dahl basis: without a search the coefficients are recovered exactly."""

import numpy as np
import pytest
from joint_data import along, error_on, law, path, training, unseen

from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.dahl import DEFLECTIONS, DahlBasis, DahlBasisLoad

FORCES = {"F_1": 2.0, "F_2": 3.0, "F_3": 1.5, "F_4": 2.5, "F_5": 1.0}
LOADS = {"mu_1": 0.05, "mu_2": 0.01, "mu_3": 0.03, "mu_4": 0.02, "mu_5": 0.01}
KAPPAS = {f"kappa_{i}": 1.0 / d for i, d in enumerate(DEFLECTIONS, start=1)}
REST = {"sigma_2": 5.0, "tau_0": -0.4}


def truth(*, load: bool = False) -> FrictionLaw:
    name, more = ("dahl_load", LOADS) if load else ("dahl", {})
    return law(name, {}, **KAPPAS, **FORCES, **more, **REST)


@pytest.mark.parametrize("load", [False, True])
def test_generating_coefficients_are_recovered(load: bool) -> None:
    generating = truth(load=load)
    entry = DahlBasisLoad if load else DahlBasis
    fitted = entry().fit(training(generating, noise=0.0), np.random.default_rng(0))
    assert fitted.name == generating.name
    for name, value in generating.values.items():
        assert fitted.values[name] == pytest.approx(value, rel=1e-5), name


def test_the_seed_does_not_matter() -> None:
    records = training(truth(), noise=0.5)
    laws = [DahlBasis().fit(records, np.random.default_rng(seed)) for seed in (0, 1)]
    assert laws[0].values == laws[1].values
    assert {name: laws[0].values[name] for name in KAPPAS} == pytest.approx(KAPPAS)


def test_noise_costs_only_its_share() -> None:
    generating = truth(load=True)
    fitted = DahlBasisLoad().fit(training(generating, noise=0.5), np.random.default_rng(0))
    assert error_on(fitted, unseen(generating)) < 0.1


def test_load_terms_are_used_only_if_the_load_matters() -> None:
    rng = np.random.default_rng(0)
    loaded, unloaded = truth(load=True), truth()
    for generating, helps in ((loaded, True), (unloaded, False)):
        records, test = training(generating, noise=0.3), unseen(generating)
        plain = error_on(DahlBasis().fit(records, rng), test)
        with_load = error_on(DahlBasisLoad().fit(records, rng), test)
        assert (with_load < 0.2 * plain) is helps
        assert with_load < 0.1


@pytest.mark.parametrize("entry", [DahlBasis, DahlBasisLoad])
def test_a_state_is_rate_independent(entry: type[DahlBasis]) -> None:
    """The same path at twice the speed gives the same torque except for the viscous part."""
    generating = truth(load=entry.load)
    slow = path(4)
    tau = along(generating, slow).tau - REST["sigma_2"] * slow.dq
    fast = predict(generating, t=slow.t / 2.0, dq=2.0 * slow.dq, tau_load=slow.load)
    np.testing.assert_allclose(fast - 2.0 * REST["sigma_2"] * slow.dq, tau, atol=1e-9)
    assert generating.form == entry.form({})
    for element in generating.form.relaxations:
        assert element.rate.subs(DQ, 0) == 0
