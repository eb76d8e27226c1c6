"""Adaptation of laws to seconds of a new day."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_data import along, path, with_tau
from joint_data import law as true_law

import hesr
from hesr_model.audit.certificate import certify
from hesr_model.errors import ArgumentError, FitError, HesrError
from hesr_model.fitting.days import adapt, build_prior
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse
from hesr_model.friction.thermal import Thermal
from hesr_model.inference.covariance import Covariance
from hesr_model.rigid_body.friction_record import FrictionRecord

TRUTH = true_law(
    "lugre", {}, sigma_0=2000.0, sigma_1=0.0, sigma_2=7.0, F_c=5.0, F_s=6.0, v_s=0.1, tau_0=0.5
)


def day(seed: int, *, seconds: float = 24.0, **changed: float) -> FrictionRecord:
    """A log of a day, whose friction differs by some coefficients; noise 0.3 N.m."""
    truth = replace(TRUTH, values={**TRUTH.values, **changed})
    clean = along(truth, path(seed, seconds=seconds))
    noise = np.random.default_rng(seed).normal(0.0, 0.3, len(clean.t))
    return replace(with_tau(clean, clean.tau + noise), log=f"day {seed}")


def fitted(name: str, *records: FrictionRecord) -> FrictionModel:
    return fit_models([name], [list(records)], robot="bench", seed=0, workers=1)[name]


def error(model: FrictionModel, record: FrictionRecord) -> float:
    return rmse(predict_record(model.laws[0], record) - record.tau)


@pytest.fixture(scope="module", params=["lugre", "parfam_s_v"])
def prior(request: pytest.FixtureRequest) -> FrictionModel:
    days = [day(k, sigma_2=s, F_c=f) for k, s, f in ((0, 6.0, 4.4), (1, 7.0, 5.0), (2, 8.0, 5.6))]
    return fitted(request.param, *days)


def test_seconds_of_a_new_day_move_the_law_to_it(prior: FrictionModel) -> None:
    most = {"lugre": 1.05, "parfam_s_v": 1.4}[prior.law]
    new = {"sigma_2": 9.0, "F_c": 4.2}
    seconds, unseen = day(7, seconds=10.0, **new), day(8, **new)
    model, (sentence,) = adapt(build_prior([prior]), [[seconds]])
    assert error(model, unseen) <= 0.75 * error(prior, unseen)
    assert error(model, unseen) <= most * error(fitted(prior.law, day(9, **new)), unseen)
    assert sentence.startswith(f"{seconds.joint}: error over 9.98 s ")
    assert model.training_rmse[0] == pytest.approx(error(model, seconds))
    verdicts = [certify(of.laws[0], prior.trained[0]).verdict for of in (prior, model)]
    assert verdicts[1] == verdicts[0]


def test_seconds_of_one_way_motion_leave_the_law_nearly_as_it_is(prior: FrictionModel) -> None:
    """The seconds do not determine the law, and a fit from them fails."""
    record, unseen = day(7), day(8)
    way = record.rows(slice(100, 280))
    with pytest.raises(HesrError, match="never reverses"):
        fitted(prior.law, way)
    model, _ = adapt(build_prior([prior]), [[way]])
    assert error(model, unseen) <= 1.15 * error(prior, unseen)
    assert error(model, way) <= error(prior, way)


def test_a_change_that_a_proof_does_not_allow_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """The new day has strong ripple but hardly viscous friction, which ripple must not exceed."""
    days = [replace(day(k, sigma_2=1.0 + 2.0 * k), gear_ratio=20.0) for k in range(3)]
    wavy = [replace(r, tau=r.tau + (3.0 - k) * np.cos(20.0 * r.q)) for k, r in enumerate(days)]
    prior = fitted("parfam_s", *wavy)
    assert any(name.startswith("ripple") for name in prior.laws[0].values)
    assert certify(prior.laws[0], prior.trained[0]).verdict == "proven"
    (law,) = prior.laws
    assert law.covariance is not None
    loose = replace(law.covariance, within=1e6 * law.covariance.within)
    prior = replace(prior, laws=(replace(law, covariance=loose),))
    new = day(7, sigma_2=0.1, F_c=1.0, F_s=1.0)
    new = replace(new, tau=new.tau + 5.0 * np.cos(20.0 * new.q))
    model, _ = adapt(prior, [[new]])
    assert certify(model.laws[0], prior.trained[0]).verdict == "proven"
    assert error(model, new) < error(prior, new)
    monkeypatch.setattr("hesr_model.fitting.days._CHANGE_SHARES", (1.0,))
    cut, _ = adapt(prior, [[new]])
    assert cut.laws[0].values == prior.laws[0].values  # the whole change was not allowed


def test_intervals_cover_the_coefficients_of_the_new_day() -> None:
    """Offset and viscous friction over twelve days."""
    prior = build_prior([fitted("lugre", *(day(k, tau_0=0.5 + 0.5 * k) for k in range(3)))])
    held, before = [], prior.laws[0]
    for seed in range(20, 32):
        truth = {"tau_0": 0.1 * (seed - 20), "sigma_2": 7.0}
        own = adapt(prior, [[day(seed, seconds=10.0, **truth)]])[0].laws[0]
        for name, value in truth.items():
            assert own.standard_errors[name] < before.standard_errors[name]
            held.append(abs(own.values[name] - value) <= 1.96 * own.standard_errors[name])
    assert sum(held) >= 21  # of 24


def test_several_days_give_mean_and_spread() -> None:
    days = [fitted("stribeck", day(k, tau_0=0.5 + k)) for k in range(3)]
    both = build_prior(days).laws[0]
    offsets = [model.laws[0].values["tau_0"] for model in days]
    assert both.values["tau_0"] == pytest.approx(np.mean(offsets))
    spread = np.std(offsets, ddof=1) * np.sqrt(1 + 1 / 3)
    assert both.standard_errors["tau_0"] >= spread
    assert both.standard_errors["tau_0"] <= 1.2 * spread
    assert build_prior(days[:1]) is days[0]


def test_a_law_without_free_coefficients_stays() -> None:
    prior = fitted("stribeck", day(0))
    (own,) = prior.laws
    none = Covariance(
        names=(), within=np.zeros((0, 0)), between=1.0, degrees=0.0, carried=np.zeros((0, 0))
    )
    bare = replace(prior, laws=(replace(own, covariance=none, standard_errors={}),))
    assert adapt(bare, [[day(7)]])[0].laws == bare.laws


def test_priors_that_cannot_be_adapted_are_refused(prior: FrictionModel) -> None:
    bare = replace(prior, laws=tuple(replace(own, covariance=None) for own in prior.laws))
    warm = replace(prior, thermal=(Thermal(coulomb=0.0, viscous=0.0),))
    other = replace(prior, joints=("elbow",))
    stribeck = fitted("stribeck", day(0))
    for models, words in (
        ([bare], "no covariance or depend"),
        ([warm], "depend on temperature; adapt laws"),
        ([prior, other], "structures of its laws differ"),
        ([prior, stribeck], "structures of its laws differ"),
    ):
        with pytest.raises(FitError, match=words):
            build_prior(models)
    with pytest.raises(FitError, match="but the prior elbow"):
        adapt(other, [[day(0)]])


@pytest.mark.parametrize("given", [{}, {"law": "lugre", "prior": ["law.json"]}])
def test_either_a_law_or_a_prior_is_needed(given: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match="give either 'law' or 'prior', fitted"):
        hesr.fit("log.csv", **given)
