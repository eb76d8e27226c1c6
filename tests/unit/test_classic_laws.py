"""Classic laws available by name only: equations, signs and proofs."""

from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from joint_data import along, path
from registry_models import everyday
from test_certificate import TRAINED, law_of, worst_step

from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.replay import replay
from hesr_model.audit.certificate import certify
from hesr_model.errors import ArtifactError
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.friction_record import FrictionRecord

NAMES = ("dahl_bound", "strain_wave_bound", *(f"bam_m{k}" for k in range(1, 7)), "gms")
NUMBERS = {
    "F_c": 4.0, "F_e": 2.0, "mu": 0.1, "mu_e": 0.03, "mu_d": 0.15, "mu_b": 0.05, "mu_e_d": 0.02,
    "mu_e_b": 0.06, "nu_d": 0.004, "nu_b": 0.007, "v_s": 0.1, "sigma_2": 2.0,
    "tau_0": -0.3, "x_0": 1e-3, "rise_d": 0.02, "rise_b": 0.05, "rise": 0.03, "ratio": 1.4,
    "C": 50.0, **{f"kappa_{i}": 10.0 ** (5 - i) for i in range(1, 6)},
    **{f"F_{i}": float(i) for i in range(1, 6)},
}  # fmt: skip


def law(name: str) -> FrictionLaw:
    coefficients = registry()[name].form({}).coefficients
    return law_of(name, **{c.name: NUMBERS[c.name] for c in coefficients})


def steady(name: str, dq: float, load: float) -> float:
    """Steady torque at a constant velocity [N.m]."""
    held = np.ones(3)
    return float(predict(law(name), t=1e4 * np.arange(3.0), dq=dq * held, tau_load=load * held)[-1])


def test_classic_laws_are_not_in_the_default_study() -> None:
    optional = [name for name, law in registry().items() if not law.everyday]
    assert optional == ["stribeck_direction", "lugre_static_first", *NAMES]


def _bam(model: int, v: float, load: float, alpha: int = 2) -> float:
    """BAM's friction as documented, with both weights solved for the load."""
    n, e = NUMBERS, np.exp(-((abs(v) / NUMBERS["v_s"]) ** alpha))
    driving = v * load > 0.0
    per_load = n["mu"] if model < 5 else n["mu_d" if driving else "mu_b"]
    at_rest = n["mu_e"] if model < 5 else n["mu_e_d" if driving else "mu_e_b"]
    level = n["F_c"]
    if model >= 3:
        level += per_load * abs(load)
    if model not in (1, 3):
        level += e * n["F_e"]
    if model >= 4:
        level += e * at_rest * abs(load)
    if model == 6:
        level += e * n["nu_d" if driving else "nu_b"] * load**2
    return float(np.sign(v) * level + n["sigma_2"] * v + n["tau_0"])


@pytest.mark.parametrize("model", range(1, 7))
@pytest.mark.parametrize("dq", [-0.7, -0.05, 0.05, 0.7])
@pytest.mark.parametrize("load", [-12.0, 0.0, 12.0])
def test_servo_friction_matches_the_models_of_bam(model: int, dq: float, load: float) -> None:
    assert steady(f"bam_m{model}", dq, load) == pytest.approx(
        _bam(model, dq, load), rel=1e-12, abs=0.0
    )


@pytest.mark.parametrize("alpha", [1, 2, 3])
def test_the_data_choose_the_exponent_of_the_curve(alpha: int) -> None:
    t = 0.01 * np.arange(3000)
    dq, load = 0.3 * np.sin(1.1 * t) * np.sin(0.37 * t), 20.0 * np.cos(1.3 * t)
    tau = np.array([_bam(4, v, tau_load, alpha) for v, tau_load in zip(dq, load, strict=True)])
    record = FrictionRecord(
        log="made", joint="j1", t=t, dq=dq, q=np.cumsum(dq) * 0.01, tau_load=load, tau=tau
    )
    found = fit_joint("bam_m4", [record], seed=0)
    assert found.structure == {"alpha": alpha}
    for name, value in found.values.items():
        assert value == pytest.approx(NUMBERS[name], rel=1e-3), name


@pytest.mark.parametrize(
    ("name", "structure", "said"),
    [
        (
            "bam_m2",
            {"alpha": 4},
            "law 'bam_m2' has 'alpha', one of 1, 2, 3 to choose, found {'alpha': 4}.",
        ),
        ("bam_m1", {"alpha": 2}, "law 'bam_m1' has nothing to choose, found {'alpha': 2}."),
    ],
)
def test_an_invalid_choice_is_refused(name: str, structure: dict[str, int], said: str) -> None:
    with pytest.raises(ArtifactError) as caught:
        registry()[name].form(structure)
    assert str(caught.value) == said


def test_motor_and_load_weights_give_one_level_per_direction() -> None:
    """BAM's tau = F_c + |(K_m + K_e) L + K_m tau| gives one level per load and direction."""
    k_m, k_e, f_c, load = 0.04, 0.06, 4.0, 30.0
    for way, level in ((1.0, (k_m + k_e) / (1.0 - k_m)), (-1.0, (k_m + k_e) / (1.0 + k_m))):
        base = f_c / (1.0 - way * k_m)
        tau = base + level * load
        motor = load + way * tau
        assert tau == pytest.approx(f_c + abs(k_m * motor + k_e * load), rel=1e-12, abs=0.0)


@pytest.mark.parametrize("load", [-12.0, 0.0, 12.0])
def test_load_in_the_bounds_scales_the_sliding_friction(load: float) -> None:
    n = NUMBERS
    dahl = sum(n[f"F_{i}"] for i in range(1, 6)) * (1.0 + n["rise"] * abs(load))
    assert steady("dahl_bound", 0.5, load) == pytest.approx(dahl + 1.0 - 0.3, rel=1e-9)
    for dq in (0.5, -0.5):
        rise = n["rise_d" if dq * load > 0.0 else "rise_b"]
        mesh = np.sign(dq) * n["F_c"] * (1.0 + rise * abs(load))
        assert steady("strain_wave_bound", dq, load) == pytest.approx(mesh + 2.0 * dq - 0.3)


def test_sliding_elements_settle_at_the_rate_of_attraction() -> None:
    """From steady sliding at v_s to ten times that: b' = C (1 - b / s) against its closed form."""
    n = NUMBERS
    slow, fast = (1.0 + 0.4 * np.exp(-((r) ** 2)) for r in (1.0, 10.0))
    forces = sum(n[f"F_{i}"] for i in range(1, 6))
    assert steady("gms", n["v_s"], 0.0) == pytest.approx(forces * slow + 0.2 - 0.3, rel=1e-9)
    t = np.concatenate([[0.0, 1e4], 1e4 + 1e-3 * np.arange(1, 40)])
    dq = np.where(t <= 1e4, n["v_s"], 10.0 * n["v_s"])
    tau = predict(law("gms"), t=t, dq=dq)[2:]
    bound = fast + (slow - fast) * np.exp(-n["C"] / fast * (t[2:] - 1e4))
    np.testing.assert_allclose(tau, forces * bound + 2.0 - 0.3, rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_classic_laws_are_passive_on_random_steps(name: str) -> None:
    found = certify(law(name), TRAINED)
    assert (found.verdict, found.largest_step) == ("proven", inf)
    assert worst_step(law(name), 10_000, 0) > -1e-9


@pytest.mark.soak
@pytest.mark.parametrize("name", NAMES)
def test_classic_laws_are_passive_on_a_million_steps(name: str) -> None:
    assert worst_step(law(name), 1_000_000, 1) > -1e-9


@pytest.mark.parametrize(
    ("name", "coefficient", "said"),
    [
        ("bam_m3", "mu", "load is in the torque itself"),
        ("bam_m6", "nu_b", "load is in the torque itself"),
        ("dahl_bound", "rise", "the rate of x1 depends on more"),
        ("strain_wave_bound", "rise_d", "the rate of z depends on more"),
    ],
)
def test_a_negative_factor_prevents_the_proof(name: str, coefficient: str, said: str) -> None:
    own = law(name)
    wrong = law_of(name, **{**own.values, coefficient: -0.01})
    found = certify(wrong, TRAINED)
    assert found.verdict != "proven"
    assert said in found.rests_on[0]


def test_laws_outside_the_contract_tests_export_as_fmus(tmp_path: Path) -> None:
    names = tuple(name for name in NAMES if name not in everyday())
    laws = tuple(map(law, names))
    model = FrictionModel(
        law=laws[0].name, robot="bench", joints=names, laws=laws, sample_time=0.005
    )
    t = 0.01 * np.arange(400)
    dq, load = np.sin(3.0 * t) * np.sin(0.7 * t), 20.0 * np.cos(1.3 * t)
    wide = {"dq": dq, "q": 0.0 * t, "tau_load": load}
    fmu = export_bare(model, tmp_path / "classic.fmu")
    found = replay(fmu, t, **{k: np.tile(v[:, None], len(names)) for k, v in wide.items()})
    for own, tau in zip(laws, found.T, strict=True):
        expected = predict(own, t=t, dq=dq, tau_load=load)
        assert np.abs(tau - expected).max() <= 1e-12 * np.abs(expected).max(), own.name


@pytest.mark.parametrize("name", ["dahl_bound", "strain_wave_bound"])
def test_the_load_of_bounds_stays_within_its_trained_range(name: str) -> None:
    records = [
        along(law(name), path(seed), noise=0.05, seed=seed, log=str(seed)) for seed in (0, 1)
    ]
    found = fit_joint(name, records, seed=0)
    largest = max(float(np.abs(r.tau_load).max()) for r in records)
    assert found.values["load_most"] == pytest.approx(largest, rel=2e-3)
    assert found.standard_errors
    proof = certify(found, TrainedRange.from_records(records))
    assert (proof.verdict, proof.largest_step) == ("proven", inf)
    # A law of an earlier version has no limit.
    values = {k: v for k, v in found.values.items() if k != "load_most"}
    older = replace(
        found, structure={}, form=registry()[name].form({}), values=values, covariance=None
    )
    for r in records:
        np.testing.assert_array_equal(predict(found, **r.motion), predict(older, **r.motion))
    heavy, heaviest = (
        {**records[0].motion, "tau_load": np.full_like(records[0].t, factor * largest)}
        for factor in (1.5, 3.0)
    )
    np.testing.assert_array_equal(predict(found, **heavy), predict(found, **heaviest))
    beyond = predict(older, **heaviest) - predict(found, **heaviest)
    assert np.abs(beyond).max() > 1.0
    with pytest.raises(ArtifactError, match="has no structure"):
        registry()["dahl"].form({"limited": True})
