"""Baselines can be fitted to any log, say what the motion determines, and are proven passive."""

import numpy as np
import pytest

from hesr_model.audit.certificate import certify
from hesr_model.fitting.estimator import registry, select_laws
from hesr_model.fitting.fit import fit_joint, fit_models
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array

T = 0.01 * np.arange(1000)


def friction(dq: Array) -> Array:
    return 5.0 * np.sign(dq) + 2.0 * dq + 0.3


def record(dq: Array, tau: Array, noise: float = 0.1) -> FrictionRecord:
    q = np.cumsum(dq) * 0.01
    errors = noise * np.random.default_rng(0).normal(size=len(T))
    return FrictionRecord(
        log="log", joint="j1", t=T, dq=dq, q=q, tau_load=0.0 * q, tau=tau + errors
    )


def fit(data: FrictionRecord) -> FrictionLaw:
    return fit_joint("coulomb_viscous", [data], seed=0)


MOTIONS = {
    "sine": np.sin(T),
    "constant speed": np.full(1000, 0.5),
    "backward": np.full(1000, -0.5),
    "a controller's jitter": 0.5 + 1e-3 * np.sin(50.0 * T),
    "one direction": 1.0 + 0.9 * np.sin(T),
    "one speed both ways": 0.5 * np.sign(np.sin(T)),
    "rest": np.zeros(1000),
}


@pytest.mark.parametrize("dq", MOTIONS.values(), ids=MOTIONS)
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_baseline_can_be_fitted_to_any_log(dq: Array, noise: float) -> None:
    for torque in (friction(dq), -friction(dq), 0.0 * dq):
        data = record(dq, torque, noise)
        laws = [fit_joint(name, [data], seed=0) for name in select_laws("baseline")]
        errors = [rmse(predict(law, t=T, dq=dq) - data.tau) for law in laws]
        assert errors[0] + 1e-9 >= errors[1]  # a constant explains at least as much as nothing
        assert errors[1] + 1e-9 >= errors[2]
        for law in laws:
            assert np.all(np.isfinite(predict(law, t=T, dq=np.sin(T))))


def test_a_baseline_has_band_and_proof() -> None:
    for motion in ("sine", "rest"):
        data = record(MOTIONS[motion], friction(MOTIONS[motion]))
        models = fit_models(select_laws("baseline"), [[data]], robot="bench", seed=0, workers=1)
        for model in models.values():
            assert model.banded
            assert np.isfinite(model.left_out_rmse[0])
            assert certify(model.laws[0], model.trained[0]).verdict == "proven"


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        ("sine", (5.0, 2.0, 0.3)),
        ("constant speed", (6.3, 0.0, 0.0)),
        ("backward", (5.7, 0.0, 0.0)),
        ("a controller's jitter", (6.3, 0.0, 0.0)),
        ("one direction", (5.3, 2.0, 0.0)),
        ("one speed both ways", (6.0, 0.0, 0.3)),
        ("rest", (0.0, 0.0, 0.3)),
    ],
)
def test_what_the_motion_does_not_separate_is_zero(
    motion: str, expected: tuple[float, ...]
) -> None:
    dq = MOTIONS[motion]
    law = fit(record(dq, friction(dq)))
    assert list(law.values.values()) == pytest.approx(expected, abs=0.05)
    # Coefficients that are not determined have no interval.
    determined = {name for name, value in law.values.items() if value}
    assert set(law.standard_errors) == determined


def test_friction_is_not_negative() -> None:
    dq = np.sin(T)
    data = record(dq, -2.0 * dq + 0.3)
    values = fit(data).values
    mean = float(np.mean(data.tau))
    assert values == pytest.approx({"F_c": 0.0, "sigma_2": 0.0, "tau_0": mean})
    values = fit(record(dq, 4.0 * np.sign(dq) - 1.0 * dq)).values
    assert values["sigma_2"] == 0.0
    assert 2.0 < values["F_c"] < 4.0


def test_every_study_has_the_baselines() -> None:
    baselines = select_laws("baseline")
    assert baselines == ("none", "constant", "coulomb_viscous")
    assert tuple(registry())[:3] == baselines
    for fact in ("quick", "proposed", "everyday"):
        assert set(baselines) <= set(select_laws(fact))
    assert [name for name in baselines if name in select_laws("classic")] == ["coulomb_viscous"]
