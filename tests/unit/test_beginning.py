"""Initial states: the steady state of the first inputs in motion, the start values at rest."""

from collections.abc import Sequence

import numpy as np
import pytest
import sympy
from oracles.stepper import Stepper

from hesr_model.equations.functions import absolute, over
from hesr_model.equations.memory import Element, Relaxation, Stop
from hesr_model.friction.inputs import DQ, MOVING, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.predict import first_states, predict

A = Coefficient(name="a", unit="1/rad", description="")
Z = sympy.Symbol("z", real=True)
AGE = Relaxation(name="p", unit="1", drive=absolute(DQ), rate=2 + absolute(DQ))
ELEMENTS: dict[str, tuple[Element, ...]] = {
    "relaxation": (
        Relaxation(name="z", unit="1", drive=A.symbol * DQ, rate=A.symbol * absolute(DQ)),
    ),
    "stop": (Stop(name="z", unit="1", velocity=DQ, deflection=1e-3, bound=absolute(TAU_LOAD)),),
    "a stop with a bound that ages": (
        AGE,
        Stop(name="z", unit="1", velocity=-2 * DQ, deflection=1e-3, bound=1 - AGE.state / 2),
    ),
    "a rate that sees its state": (
        Relaxation(name="z", unit="1", drive=A.symbol * DQ, rate=absolute(DQ) * absolute(Z)),
    ),
    "a rate that sees it gently": (
        Relaxation(name="z", unit="1", drive=5 * DQ, rate=5 + absolute(DQ) + DQ * Z / 2),
    ),
}


def law(memory: Sequence[Element], start: tuple[float, ...] = ()) -> FrictionLaw:
    output = sum((m.state for m in memory), sympy.Integer(0)) + DQ
    form = LawForm(coefficients=(A,), memory=tuple(memory), output=output)
    return FrictionLaw(name="own", form=form, values={"a": 300.0}, start=start)


@pytest.mark.parametrize("memory", ELEMENTS.values(), ids=ELEMENTS)
@pytest.mark.parametrize("dq", [-3.0, -0.5, MOVING, 0.1, 1.0])
def test_states_are_stationary_under_the_first_inputs(
    memory: tuple[Element, ...], dq: float
) -> None:
    own = law(memory)
    begun = first_states(own, dq, tau_load=-0.7)
    t, held = 0.05 * np.arange(2000), np.ones(2000)
    inputs = {"t": t, "dq": dq * held, "tau_load": -0.7 * held}
    there = predict(own, **inputs)
    np.testing.assert_allclose(there, there[0], rtol=1e-9)
    # A distant starting point leads to the same state.
    away = tuple(0.3 * x - 0.01 for x in begun)
    assert predict(own, **inputs, start=away)[-1] == pytest.approx(there[0], rel=1e-6)


@pytest.mark.parametrize("memory", ELEMENTS.values(), ids=ELEMENTS)
def test_the_start_value_fades_out_towards_motion(memory: tuple[Element, ...]) -> None:
    start = tuple(0.1 * (k + 1) for k in range(len(memory)))
    own = law(memory, start)
    assert first_states(own, 0.0, tau_load=0.7) == start
    assert first_states(own, 1e-9, tau_load=0.7) == pytest.approx(start)
    speeds = np.linspace(0.0, MOVING, 400)
    rows = np.array([first_states(own, v, tau_load=0.7) for v in speeds])
    # A smooth step is at most 1.5 times as steep as its mean.
    assert np.abs(np.diff(rows, axis=0)).max() < 2.0 / len(rows) * np.ptp(rows, axis=0).max()
    assert first_states(own, MOVING, tau_load=0.7) == pytest.approx(
        first_states(law(memory), MOVING, tau_load=0.7)
    )


def test_a_state_without_steady_state_starts_at_its_start_value() -> None:
    way = Relaxation(name="z", unit="rad", drive=DQ, rate=sympy.Integer(0))
    assert first_states(law([way], (0.4,)), 0.7) == (0.4,)


def test_a_stepper_starts_from_its_first_inputs() -> None:
    own = law(ELEMENTS["relaxation"])
    one, other = Stepper(own), Stepper(own, start=(0.2,))
    assert one.step(0.0, 0.5) == predict(own, t=[0.0], dq=[0.5])[0] == pytest.approx(1.5)
    assert other.step(0.0, 0.5) == pytest.approx(0.7)
    late = Stepper(own)
    late.step(0.01, -0.5)
    assert late.x == pytest.approx([-1.0])


@pytest.mark.parametrize("at", [(3.0, 2.0, 7.0), (3.0, -2.0, 7.0), (3.0, 0.0, 7.0)])
def test_quotients_and_their_derivatives(at: tuple[float, float, float]) -> None:
    symbols = sympy.symbols("a b c", real=True)
    whole = over(*symbols)
    values = dict(zip(symbols, at, strict=True))
    a, b, c = at
    assert float(whole.subs(values)) == (a / b if b > 0.0 else c)
    slopes = [float(whole.diff(s).subs(values)) for s in symbols]
    assert slopes == pytest.approx([1.0 / b, -a / b**2, 0.0] if b > 0.0 else [0.0, 0.0, 1.0])
