"""Stribeck: recovery of the coefficients behind noise-free data."""

import numpy as np
import pytest

from hesr_model.errors import ArtifactError, HesrError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.stribeck import Stribeck
from hesr_model.rigid_body.friction_record import FrictionRecord

RNG_SEED = 0


def velocity(t: np.ndarray, peak: float = 1.2) -> np.ndarray:
    return peak * (0.65 + 0.35 * np.sin(0.7 * t)) * np.sin(2.0 * np.pi * 0.3 * t)


def torque(dq: np.ndarray, f_c: float, f_s: float, v_s: float, viscous: float, offset: float):
    """Eq. 3 as a function of velocity, written out."""
    level = f_c + (f_s - f_c) * np.exp(-((dq / v_s) ** 2))
    return np.sign(dq) * level + viscous * dq + offset


def record(coefficients: tuple[float, ...], *, noise: float = 0.0) -> FrictionRecord:
    t = np.cumsum(np.random.default_rng(4).uniform(0.004, 0.012, 2000))
    dq = velocity(t)
    tau = torque(dq, *coefficients) + noise * np.random.default_rng(5).normal(size=len(t))
    zero = np.zeros_like(t)
    return FrictionRecord(log="run", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)


def fitted(data: FrictionRecord) -> FrictionLaw:
    return Stribeck().fit([data], np.random.default_rng(RNG_SEED))


CASES = [
    (9.6, 13.0, 0.08, 16.6, 0.0),
    (5.5, 7.4, 0.3, 4.0, -0.8),
    (4.0, 12.0, 0.05, 2.0, 0.6),
    (3.0, 3.9, 0.02, 0.0, 0.0),
]


@pytest.mark.parametrize("case", CASES)
def test_generating_coefficients_are_found(case: tuple[float, ...]) -> None:
    law = fitted(record(case))
    names = ("F_c", "F_s", "v_s", "sigma_2", "tau_0")
    np.testing.assert_allclose([law.values[n] for n in names], case, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("case", CASES)
def test_noise_costs_only_its_share(case: tuple[float, ...]) -> None:
    data, clean = record(case, noise=0.5), record(case)
    law = fitted(data)
    error = predict(law, t=clean.t, dq=clean.dq) - clean.tau
    # Five coefficients from 2000 rows: about 0.5 sqrt(5 / 2000) = 0.025 N.m.
    assert np.sqrt(np.mean(error**2)) < 0.06


def test_levels_and_viscous_friction_are_never_negative() -> None:
    """Data that favour negative values: torque along the motion, falling with speed."""
    data = record((5.0, 8.0, 0.1, -3.0, 0.4))
    law = fitted(data)
    assert min(law.values[n] for n in ("F_c", "F_s", "sigma_2")) >= 0.0
    assert law.values["sigma_2"] == 0.0
    opposed = fitted(record((-5.0, -8.0, 0.1, 3.0, 0.0)))
    assert min(opposed.values[n] for n in ("F_c", "F_s", "sigma_2")) >= 0.0


def test_the_law_is_static_and_of_velocity_alone() -> None:
    law = fitted(record(CASES[0]))
    assert law.form.relaxations == ()
    assert [symbol.name for symbol in law.form.inputs] == ["dq"]
    # At rest it is the offset, without Coulomb friction.
    assert predict(law, t=[0.0], dq=[0.0])[0] == law.values["tau_0"]


def test_a_structure_is_refused() -> None:
    with pytest.raises(ArtifactError, match=r"^law 'stribeck' .*found.*'degree': 2"):
        Stribeck.form({"degree": 2})


def test_a_joint_that_never_reverses_is_refused() -> None:
    data = record(CASES[0])
    one_way = FrictionRecord(**(vars(data) | {"dq": np.abs(data.dq)}))
    with pytest.raises(HesrError, match="'j1' never reverses"):
        fitted(one_way)


@pytest.mark.parametrize("speed", [0.1, 0.4, 3.0])
def test_constant_speeds_give_no_static_friction_beyond_reason(speed: float) -> None:
    """No row is slow: a level that falls within 1 mrad/s would be found as 1e150 N.m."""
    rng = np.random.default_rng(0)
    t = 0.005 * np.arange(8000)
    rise = np.ones(9) / 9
    dq = np.convolve(speed * np.where((t // 4.0) % 2 < 1, 1.0, -1.0), rise, "same")
    tau = 0.3 * np.sign(dq) + 0.1 * dq + 0.02 * rng.normal(size=len(t))
    zero = np.zeros_like(t)
    data = FrictionRecord(log="run", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)
    law = fitted(data)
    assert 0.0 <= law.values["F_s"] < 3.0
    error = predict(law, t=t, dq=dq) - tau
    assert np.std(error) < 0.03
