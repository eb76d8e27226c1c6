"""LuGre: recovery of the coefficients behind noise-free data."""

from dataclasses import replace

import numpy as np
import pytest

from hesr_model.errors import ArtifactError, FitError, HesrError
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.lugre import LuGre
from hesr_model.rigid_body.friction_record import FrictionRecord

NAMES = ("sigma_0", "sigma_1", "sigma_2", "F_c", "F_s", "v_s", "tau_0")


def velocity(t: np.ndarray) -> np.ndarray:
    return 1.2 * (0.55 + 0.45 * np.sin(0.9 * t)) * np.sin(2.0 * np.pi * 0.3 * t)


def torque(t: np.ndarray, dq: np.ndarray, case: tuple[float, ...]) -> np.ndarray:
    """Eq. 1-3 in a loop with the velocity held over each step; each step in closed form."""
    stiffness, damping, viscous, f_c, f_s, v_s, offset = case
    z, rows = 0.0, []
    for k, v in enumerate(dq):
        level = f_c + (f_s - f_c) * np.exp(-((v / v_s) ** 2))
        rate = stiffness * abs(v) / level
        if k and rate > 0.0:
            steady = np.sign(v) * level / stiffness
            z = steady + (z - steady) * np.exp(-rate * (t[k] - t[k - 1]))
        rows.append(stiffness * z + damping * (v - rate * z) + viscous * v + offset)
    return np.array(rows)


def record(case: tuple[float, ...], *, noise: float = 0.0, seed: int = 4) -> FrictionRecord:
    rng = np.random.default_rng(seed)
    t = 1.0 + np.cumsum(rng.uniform(0.004, 0.008, 2500))
    dq = velocity(t) * np.minimum((t - t[0]) / 0.2, 1.0)  # from rest, where the law begins
    tau = torque(t, dq, case) + noise * rng.normal(size=len(t))
    zero = np.zeros_like(t)
    return FrictionRecord(log="run", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)


def fitted(*data: FrictionRecord, relaxed: bool = False) -> FrictionLaw:
    return LuGre(relaxed=relaxed).fit(data, np.random.default_rng(0))


CASES = [
    (2000.0, 20.0, 12.0, 10.0, 13.0, 0.1, 0.3),
    (600.0, 0.0, 4.0, 6.0, 6.5, 0.3, -0.5),
    (5000.0, 5.0, 2.0, 8.0, 5.0, 0.15, 0.0),  # the level rises with speed: F_s < F_c
]


@pytest.mark.parametrize("case", CASES)
def test_generating_coefficients_are_found(case: tuple[float, ...]) -> None:
    data = record(case)
    law = fitted(data, relaxed=case[4] < case[3])
    error = predict(law, t=data.t, dq=data.dq) - data.tau
    assert np.sqrt(np.mean(error**2)) < 1e-3 * np.std(data.tau)
    scale = np.maximum(np.abs(case), [1.0, 1.0, 1.0, 1.0, 1.0, 0.1, 1.0])
    found = np.array([law.values[name] for name in NAMES])
    np.testing.assert_array_less(np.abs(found - case) / scale, 0.02)


def test_the_true_law_gives_the_same_torque() -> None:
    case = CASES[0]
    data = record(case)
    form = LuGre.form({})
    law = FrictionLaw(name="lugre", form=form, values=dict(zip(NAMES, case, strict=True)))
    predicted = predict(law, t=data.t, dq=data.dq)
    np.testing.assert_allclose(predicted, data.tau, atol=1e-12 * np.abs(data.tau).max())


def test_several_logs_are_fitted_jointly_each_from_rest() -> None:
    case = CASES[0]
    both = [record(case), record(case, seed=9)]
    law = fitted(*both)
    for data in both:
        error = predict(law, t=data.t, dq=data.dq) - data.tau
        assert np.sqrt(np.mean(error**2)) < 1e-3 * np.std(data.tau)


def test_noise_costs_only_its_share() -> None:
    case = CASES[0]
    clean = record(case)
    law = fitted(record(case, noise=1.0))
    error = predict(law, t=clean.t, dq=clean.dq) - clean.tau
    # Seven coefficients from 2500 rows: about sqrt(7 / 2500) = 0.05 N.m.
    assert np.sqrt(np.mean(error**2)) < 0.12


def test_no_force_coefficient_is_negative() -> None:
    """A random torque could fit any coefficients."""
    data = record(CASES[0])
    for seed in range(3):
        tau = 5.0 * np.random.default_rng(seed).normal(size=len(data.t)) - 3.0 * data.dq
        law = fitted(FrictionRecord(**(vars(data) | {"tau": tau})))
        for name in NAMES[:-1]:
            assert law.values[name] >= 0.0, name


@pytest.mark.parametrize("slope", [3.0, 0.0, -3.0])
def test_a_joint_without_coulomb_friction_gets_a_valid_law(slope: float) -> None:
    data = record(CASES[0])
    law = fitted(FrictionRecord(**(vars(data) | {"tau": slope * data.dq})))
    predicted = predict(law, t=data.t, dq=data.dq)
    np.testing.assert_allclose(predicted, max(slope, 0.0) * data.dq, atol=0.2)


def test_the_law_depends_on_velocity_alone_and_is_exact() -> None:
    form = LuGre.form({})
    assert [symbol.name for symbol in form.inputs] == ["dq"]
    assert [relaxation.name for relaxation in form.relaxations] == ["z"]
    assert fitted(record(CASES[1])).discretisation == "exact"


def test_a_structure_is_refused() -> None:
    with pytest.raises(ArtifactError, match=r"^law 'lugre' .*found.*'states': 2"):
        LuGre.form({"states": 2})


def test_a_joint_that_never_reverses_is_refused() -> None:
    data = record(CASES[0])
    one_way = FrictionRecord(**(vars(data) | {"dq": np.abs(data.dq)}))
    with pytest.raises(HesrError, match="'j1' never reverses"):
        fitted(one_way)


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (0.0, "friction torque reaches 0; law 'lugre'"),
        (np.nan, "'j1': its friction torque reaches nan"),
        (1e98, r"^joint 'j1': law 'lugre': coefficient '.*' is .*; its torque does not determine"),
    ],
)
def test_a_coefficient_that_is_not_finite_is_an_error_of_the_fit(scale: float, said: str) -> None:
    data = record(CASES[0])
    with pytest.raises(FitError, match=said):
        fit_joint("lugre", [replace(data, tau=scale * data.tau)], seed=0)


CLASSES = (
    "lugre",
    "lugre_load",
    "lugre_load_ripple",
    "lugre_textbook",
    "lugre_passive",
)


@pytest.fixture(scope="module")
def rising() -> FrictionRecord:
    """Friction whose level rises with speed, which favours F_s < F_c."""
    t = 0.01 * np.arange(2500)
    dq = 0.6 * np.sin(0.9 * t) * np.sin(0.31 * t)
    q = np.cumsum(dq) * 0.01
    tau = 4.0 * np.tanh(dq / 0.02) + 6.0 * dq / (1.0 + np.abs(dq) / 0.1)
    load = 3.0 * np.cos(q)
    return FrictionRecord(
        log="made", joint="j1", t=t, dq=dq, q=q, tau_load=load, tau=tau, gear_ratio=100.0
    )


@pytest.mark.parametrize("name", CLASSES)
def test_static_friction_is_not_below_coulomb_friction(name: str, rising: FrictionRecord) -> None:
    values = fit_joint(name, [rising], seed=0).values
    assert values["F_s"] >= values["F_c"] * (1.0 - 1e-9)


@pytest.mark.parametrize("name", CLASSES[:3])
def test_a_relaxed_search_goes_below(name: str, rising: FrictionRecord) -> None:
    values = fit_joint(name, [rising], seed=0, options={"relaxed": True}).values
    assert values["F_s"] < 0.9 * values["F_c"]
