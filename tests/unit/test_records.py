"""Laws on records: the initial state and the prediction from it."""

from dataclasses import replace

import numpy as np
import pytest
from joint_data import HX_BRISTLE, HX_PAPER, Path, along, law, path

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict, record_start
from hesr_model.friction.records import predict_record

LUGRE = law(
    "lugre", {}, sigma_0=2000.0, sigma_1=10.0, sigma_2=6.0, F_c=9.0, F_s=12.0, v_s=0.1, tau_0=0.3
)
BRISTLE = law(
    "parfam_hx", HX_BRISTLE, c_0=0.4, c_dq=5.0, c_h=9.0, c_dh=0.02, kappa=100.0, rho=1.3, v_s=0.1
)
PAPER = law("parfam_hx", HX_PAPER, c_0=0.4, c_dq=5.0, c_h=9.0, c_dh=0.02, alpha=10.0, beta=50.0)
STRIBECK = law("stribeck", {}, F_c=6.0, F_s=9.0, v_s=0.1, sigma_2=4.0, tau_0=-0.3)
DAHL = law(
    "dahl",
    {},
    sigma_2=1.5,
    tau_0=0.1,
    **{f"F_{i}": 2.0 for i in range(1, 6)},
    **{f"kappa_{i}": 10.0 * i for i in range(1, 6)},
)


def sampling(one: FrictionLaw, samples: int = 5) -> FrictionLaw:
    return replace(one, start_samples=samples)


def from_rest(seconds: float = 0.5) -> Path:
    """A log that begins at rest and then moves back and forth."""
    way = path(0)
    still = round(seconds / 0.008)
    dq = np.concatenate([np.zeros(still), way.dq])[: len(way.dq)]
    return replace(way, dq=dq)


@pytest.mark.parametrize("share", [-0.95, -0.4, 0.0, 0.3, 0.8])
@pytest.mark.parametrize(("one", "full"), [(LUGRE, 9.0 / 2000.0), (BRISTLE, 1.0)])
def test_the_true_start_of_a_bristle_at_rest_is_found(
    one: FrictionLaw, full: float, share: float
) -> None:
    log = along(one, from_rest(), start=(share * full,))
    (found,) = record_start(sampling(one), log)
    assert found == pytest.approx(share * full, abs=2e-4 * full)
    predicted = predict_record(sampling(one), log, measured_start=True)
    np.testing.assert_allclose(predicted, log.tau, atol=5e-3)


def test_noise_is_averaged_over_the_samples() -> None:
    starts = [
        record_start(
            sampling(BRISTLE, 5), along(BRISTLE, from_rest(), noise=0.5, seed=s, start=(0.5,))
        )[0]
        for s in range(40)
    ]
    assert np.mean(starts) == pytest.approx(0.5, abs=0.02)
    assert np.std(starts) == pytest.approx(0.5 / 9.0 / np.sqrt(5.0), rel=0.35)


def test_a_start_is_a_reachable_state() -> None:
    """Holds for any size of the first torques."""
    log = along(BRISTLE, from_rest())
    limit = 1.3  # rho, the largest value of the state
    for tau, sign in ((1e3, 1.0), (-1e3, -1.0)):
        (found,) = record_start(sampling(BRISTLE), replace(log, tau=np.full_like(log.tau, tau)))
        assert abs(found) <= limit * (1.0 + 1e-9)
        assert found == pytest.approx(sign * limit, rel=0.05)


def test_only_the_first_samples_count() -> None:
    log = along(BRISTLE, from_rest(), start=(0.5,))
    other = replace(log, tau=np.where(np.arange(len(log.tau)) < 5, log.tau, 99.0))
    assert record_start(sampling(BRISTLE), other) == record_start(sampling(BRISTLE), log)
    assert record_start(sampling(BRISTLE, 6), other) != record_start(sampling(BRISTLE, 6), log)


@pytest.mark.parametrize("one", [STRIBECK, DAHL, LUGRE, PAPER])
def test_a_law_without_samples_keeps_its_own_start(one: FrictionLaw) -> None:
    own = replace(one, start=tuple(0.1 * (k + 1) for k in range(len(one.form.relaxations))))
    log = along(one, from_rest())
    assert record_start(own, log) == own.start
    expected = predict(own, t=log.t, dq=log.dq, q=log.q, tau_load=log.tau_load)
    found = predict_record(own, log, measured_start=True)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("one", [STRIBECK, DAHL])
def test_only_laws_with_one_state_estimate_their_start(one: FrictionLaw) -> None:
    own = replace(sampling(one), start=tuple(0.1 for _ in one.form.relaxations))
    assert record_start(own, along(one, from_rest())) == own.start


def test_a_log_at_rest_keeps_the_laws_own_start() -> None:
    """A bristle that never moves gives no limit for the search."""
    log = along(BRISTLE, replace(from_rest(), dq=np.zeros(len(from_rest().t))), start=(0.4,))
    assert record_start(replace(sampling(BRISTLE), start=(0.2,)), log) == (0.2,)


def test_an_estimated_start_pays_from_the_first_row() -> None:
    log = along(LUGRE, from_rest(), noise=0.1, start=(0.8 * 9.0 / 2000.0,))
    at_rest = log.dq == 0.0
    errors = [
        np.abs(predict_record(sampling(LUGRE), log, measured_start=known) - log.tau)[at_rest][
            :50
        ].mean()
        for known in (True, False)
    ]
    assert errors[0] < 0.2
    assert errors[1] == pytest.approx(0.8 * 9.0, rel=0.05)
