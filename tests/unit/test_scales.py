"""Factors on Coulomb and viscous friction, and the terms they leave unchanged."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import sympy

from hesr.extras.laws.strain_wave import StrainWave
from hesr_model.equations.functions import sgn
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.predict import predict
from hesr_model.friction.scales import COULOMB, VISCOUS, add_scales, has_viscous
from hesr_model.laws.dahl import DahlBasisLoad
from hesr_model.laws.lugre import LuGreLoad
from hesr_model.laws.parfam import family
from hesr_model.laws.stops.form import Structure

UNIT = [{"g": "tanh", "arguments": ["1", "dq", "h", "dh"]}]
LINEAR = ["1", "dq", "h", "dh", "h_load"]


def jumping() -> LawForm:
    """No memory: Coulomb friction rising with the load, a cubic viscous term and ripple."""
    own = tuple(Coefficient(name=n, unit="1", description=n) for n in ("F", "mu", "b", "a", "r"))
    f, mu, b, a, r = (c.symbol for c in own)
    output = (f + mu * TAU_LOAD**2) * sgn(DQ) + b * DQ**3 + a + r * sympy.cos(5 * (Q - DQ / 9))
    return LawForm(coefficients=own, output=output)


FORMS: dict[str, Callable[[], LawForm]] = {
    "lugre": lambda: LuGreLoad.core({}),
    "dahl": lambda: DahlBasisLoad.core({}),
    "strain_wave": lambda: StrainWave.core({}),
    "bristle": lambda: family.form({"linear": LINEAR, "units": UNIT, "state": "bristle"}),
    "paper": lambda: family.form({"linear": LINEAR[:4], "units": UNIT}),
    "generalised": lambda: family.form({"linear": LINEAR, "units": [], "state": "generalised"}),
    "divided": lambda: family.form(
        {"linear": ["1", "dq", "h"], "units": [], "denominator": ["dq", "h"]}
    ),
    "stops": lambda: Structure.from_json(
        {"stops": [["1", 2], ["p", 6], ["load", 4]], "viscous": ["1", "a"], "ripple": [2],
         "window": 0.1}
    ).form(),
    "jumping": jumping,
}  # fmt: skip


def law_of(form: LawForm) -> FrictionLaw:
    """A law with distinct positive coefficients."""
    values = {c.name: 0.3 + 0.37 * k % 1.9 for k, c in enumerate(form.coefficients)}
    values |= {n: x for n, x in {"d_dq": 0.2, "d_h": 0.1, "mu_dif": 0.01}.items() if n in values}
    return FrictionLaw(name="by_hand", form=form, values=values)


def torque(law: FrictionLaw, dq: np.ndarray, coulomb: float, viscous: float) -> np.ndarray:
    form = add_scales(law.form)
    own = {COULOMB.name: coulomb, VISCOUS.name: viscous}
    whole = replace(law, form=form, values={**law.values, **own})
    return run(whole, dq)


def run(law: FrictionLaw, dq: np.ndarray) -> np.ndarray:
    t = 0.01 * np.arange(len(dq))
    load = 3.0 + np.cos(0.2 * t)
    return predict(law, t=t, dq=dq, q=0.01 * np.cumsum(dq), tau_load=load)


@pytest.fixture(params=list(FORMS))
def law(request: pytest.FixtureRequest) -> FrictionLaw:
    return law_of(FORMS[request.param]())


def test_factors_of_one_leave_the_law_unchanged(law: FrictionLaw) -> None:
    dq = np.sin(0.05 * np.arange(300))
    np.testing.assert_allclose(torque(law, dq, 1.0, 1.0), run(law, dq), rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("speed", [0.4, -1.1])
def test_a_slide_is_a_sum_of_parts(law: FrictionLaw, speed: float) -> None:
    """Coulomb and viscous friction are scaled; offset and ripple are not."""
    dq = np.full(3000, speed)
    whole, none = torque(law, dq, 1.0, 1.0)[-200:], torque(law, dq, 0.0, 0.0)[-200:]
    coulomb, viscous = torque(law, dq, 1.0, 0.0)[-200:], torque(law, dq, 0.0, 1.0)[-200:]
    sliding = law.form.output.free_symbols & {s for m in law.form.memory for s in [m.state]}
    tolerance = 1e-6 if sliding else 1e-12
    if "d_h" not in law.values:  # a denominator with memory prevents a sum of parts
        np.testing.assert_allclose(coulomb + viscous - none, whole, atol=tolerance)
        np.testing.assert_allclose(
            torque(law, dq, 2.5, 1.0)[-200:], whole + 1.5 * (coulomb - none), atol=tolerance
        )
    assert np.all(np.sign(speed) * (coulomb - none) > 0.01)
    assert has_viscous(law.form)
    assert np.all(np.sign(speed) * (viscous - none) > 1e-3)


def test_factors_of_zero_leave_offset_and_ripple() -> None:
    law = law_of(jumping())
    dq = np.full(50, 0.5)
    q, k = 0.01 * np.cumsum(dq), law.values
    left = k["a"] + k["r"] * np.cos(5.0 * (q - dq / 9.0))
    np.testing.assert_allclose(torque(law, dq, 0.0, 0.0), left, atol=1e-12)


def test_stiffness_at_rest_is_unchanged() -> None:
    """A doubled level is reached along the same slope after twice the distance."""
    law = law_of(Structure.from_json({"stops": [["1", 8]], "viscous": []}).form())
    dq = np.r_[0.0, np.full(60, 0.05)]
    one, two = (torque(law, dq, level, 1.0) - law.values["tau_0"] for level in (1.0, 2.0))
    slope = law.values["F_9"] * np.arange(61) * 0.05 * 0.01 / 1e-2
    np.testing.assert_allclose(one, np.minimum(slope, law.values["F_9"]), rtol=1e-12)
    np.testing.assert_allclose(two, np.minimum(slope, 2.0 * law.values["F_9"]), rtol=1e-12)


def test_a_law_without_a_viscous_term() -> None:
    form = LawForm(coefficients=(), output=sympy.tanh(DQ))
    assert not has_viscous(form)
    law = FrictionLaw(name="by_hand", form=form, values={})
    dq = np.linspace(-1.0, 1.0, 5)
    np.testing.assert_array_equal(torque(law, dq, 3.0, 7.0), 3.0 * np.tanh(dq))
