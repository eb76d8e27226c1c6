"""Friction by direction: the law finds it, is passive, and is named where others do not fit."""

from math import inf

import numpy as np
import pytest
from test_certificate import TRAINED

from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.replay import replay
from hesr_model.audit.certificate import certify
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.health.directions import doubt_one_slope
from hesr_model.health.referee import judge
from hesr_model.rigid_body.friction_record import FrictionRecord

NAME = "stribeck_direction"
UNEQUAL = {
    "F_c_p": 2.1, "F_s_p": 2.9, "sigma_p": 0.562,
    "F_c_n": 1.8, "F_s_n": 2.3, "sigma_n": 0.482, "v_s": 0.15,
}  # fmt: skip
EQUAL = UNEQUAL | {"F_c_n": 2.1, "F_s_n": 2.9, "sigma_n": 0.562}
SEEDS = range(12)


def law_of(values: dict[str, float]) -> FrictionLaw:
    return FrictionLaw(name=NAME, form=registry()[NAME].form({}), values=values)


def record(
    values: dict[str, float], *, seed: int = 0, noise: float = 0.01, offset: float = 0.0
) -> FrictionRecord:
    """Friction of 40 s of motion at 100 Hz, with correlated errors as a rigid body leaves."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(4000)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    q = sum(
        size * np.sin(rate * t + phase)
        for size, rate, phase in zip((1.5, 0.6, 0.2), (0.9, 2.3, 6.1), phases, strict=True)
    )
    dq = np.gradient(q, t)
    tau = predict(law_of(values), t=t, dq=dq) + offset + noise * rng.normal(size=len(t))
    tau += 3.0 * noise * np.sin(0.7 * t + rng.uniform(0.0, 6.0))
    return FrictionRecord(
        log=f"log {seed}", joint="j1", t=t, dq=dq, q=q, tau_load=np.zeros_like(t), tau=tau
    )


def doubts(law_name: str, joint_record: FrictionRecord) -> list[str]:
    law = fit_joint(law_name, [joint_record], seed=0)
    findings = judge(doubt_one_slope(law_name, law, [joint_record])).findings
    return [finding.sentence for finding in findings]


def test_levels_and_slopes_of_both_directions_are_found() -> None:
    fitted = fit_joint(NAME, [record(UNEQUAL)], seed=0)
    for name, value in UNEQUAL.items():
        assert fitted.values[name] == pytest.approx(value, rel=0.06), name
    assert fitted.values["sigma_p"] - fitted.values["sigma_n"] == pytest.approx(0.08, rel=0.15)


def test_it_is_passive_by_proof() -> None:
    for values in (UNEQUAL, EQUAL, dict.fromkeys(UNEQUAL, 0.0) | {"v_s": 0.1, "F_s_n": 3.0}):
        assert certify(law_of(values), TRAINED).largest_step == inf


def test_the_fmu_is_the_law(tmp_path) -> None:
    data = record(UNEQUAL)
    law = fit_joint(NAME, [data], seed=0)
    model = FrictionModel(law=NAME, robot="bench", joints=("j1",), laws=(law,), sample_time=0.01)
    fmu = export_bare(model, tmp_path / "law.fmu")
    torque = replay(fmu, t=data.t, dq=data.dq[:, None])[:, 0]
    np.testing.assert_allclose(torque, predict(law, t=data.t, dq=data.dq), rtol=0, atol=1e-13)


@pytest.mark.parametrize("law_name", ["stribeck", "lugre"])
def test_friction_by_direction_is_found_and_a_law_for_it_named(law_name: str) -> None:
    (sentence,) = doubts(law_name, record(UNEQUAL))
    assert "in positive direction, by 0.0" in sentence
    assert f"the law {law_name} has" in sentence
    assert f"fit {NAME}," in sentence
    assert doubts(NAME, record(UNEQUAL)) == []


def test_the_faster_direction_is_named() -> None:
    turned = UNEQUAL | {"sigma_p": 0.482, "sigma_n": 0.562}
    (sentence,) = doubts("stribeck", record(turned))
    assert "in negative direction" in sentence


@pytest.mark.parametrize("law_name", ["stribeck", "coulomb_viscous"])
def test_equal_friction_with_an_offset_is_no_finding(law_name: str) -> None:
    for seed in SEEDS:
        assert doubts(law_name, record(EQUAL, seed=seed, noise=0.05, offset=0.4)) == [], seed


def test_one_direction_alone_tells_nothing() -> None:
    data = record(UNEQUAL)
    forwards = FrictionRecord(
        log="a", joint="j1", t=data.t, dq=np.abs(data.dq), q=data.q,
        tau_load=data.tau_load, tau=np.abs(data.tau),
    )  # fmt: skip
    assert doubts("coulomb_viscous", forwards) == []
