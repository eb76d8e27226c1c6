"""Components: refusals, time steps and derived dependencies."""

from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st
from oracles.stepper import Stepper
from scipy.integrate import solve_ivp

from fmu_src.blocks.controller import controller_equations, velocity_equations
from hesr_model.equations.component import Component, Equation, Quantity, previous
from hesr_model.equations.functions import (
    NUMPY,
    absolute,
    clip,
    exceeds,
    larger,
    positive,
    to_numpy_function,
)
from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import DT, Discretisation, Relaxation, Stop
from hesr_model.equations.program import change_symbol, derive_changes, readings
from hesr_model.equations.stepping import Steps
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.predict import predict

X, Y = sympy.symbols("x y", real=True)
STEPS = st.lists(st.tuples(st.floats(-2, 2), st.floats(0, 1.5)), min_size=1, max_size=70)


def law(*memory: Relaxation | Stop, output: sympy.Expr) -> FrictionLaw:
    form = LawForm(coefficients=(), memory=memory, output=output)
    return FrictionLaw(name="tried", form=form, values={})


def signal(name: str) -> Quantity:
    return Quantity(name=name, unit="1", description="")


# --- functions --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "expression",
    [positive(X), larger(X, Y), clip(X, Y**2), absolute(X * Y), clip(X * Y, 1) * positive(Y)],
)
def test_derivatives_are_those_almost_everywhere(expression: sympy.Expr) -> None:
    function = to_numpy_function((X, Y), (expression, expression.diff(X), expression.diff(Y)))
    rng = np.random.default_rng(3)
    for x, y in rng.normal(size=(50, 2)):
        h = 1e-6
        _, by_x, by_y = function(x, y)
        for slope, dx, dy in ((by_x, h, 0.0), (by_y, 0.0, h)):
            change = function(x + dx, y + dy)[0] - function(x - dx, y - dy)[0]
            assert slope == pytest.approx(change / (2.0 * h), abs=1e-8)


def test_the_guard_replaces_nan_by_zero() -> None:
    assert NUMPY["positive"](np.array([np.nan, -1.0, 2.0])).tolist() == [0.0, 0.0, 2.0]
    assert positive(sympy.Float(-3)) == 0.0
    assert exceeds(sympy.Integer(2), sympy.Integer(2)) == 0.0


# --- memory -----------------------------------------------------------------------------------


def stops_over(way: np.ndarray, bound: np.ndarray, begins: np.ndarray, start: np.ndarray) -> Any:
    """Stops (E,) moved along paths (E, N) within a bound (N,), from `start` in each record."""
    ways, limit = sympy.symbols(f"way:{len(way)}", real=True), sympy.Symbol("limit", real=True)
    stops = [
        Stop(name=f"x{i}", unit="1", velocity=w, deflection=1, bound=limit)
        for i, w in enumerate(ways)
    ]
    kernel = Kernel(stops, (), (*ways, limit), [s.state for s in stops])
    run = KernelRun(kernel, [*way, bound], np.ones_like(bound), np.flatnonzero(begins))
    return run.evaluate(np.zeros(0), start, settled=True).T


def states_over(
    memory: tuple[Relaxation, ...],
    dq: np.ndarray,
    dt: np.ndarray,
    begins: np.ndarray,
    start: tuple[float, ...],
    discretisation: Discretisation,
) -> np.ndarray:
    kernel = Kernel(memory, (), (DQ,), [m.state for m in memory])
    run = KernelRun(kernel, [dq], dt, np.flatnonzero(begins), euler=discretisation == "euler")
    return run.evaluate(np.zeros(0), np.array(start), settled=True).T


@given(STEPS, st.floats(-1, 1))
def test_the_scan_of_a_stop_equals_the_loop(steps: list[tuple[float, float]], start: float) -> None:
    steps = steps * 60  # more rows than fit in one block
    way, bound = (np.array(column) for column in zip(*steps, strict=True))
    expected = [[start], [-start]]
    for x, sign in zip(expected, (1.0, -1.0), strict=True):
        for a, s in steps[1:]:
            x.append(min(max(x[-1] + sign * a, -s), s))
    begins = np.arange(len(way)) == 0
    found = stops_over(np.stack([way, -way]), bound, begins, np.array([start, -start]))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_stop_restarts_with_each_record() -> None:
    way = np.full(6, 0.3)
    begins = np.array([True, False, False, True, False, False])
    found = stops_over(way[None], np.full(6, 10.0), begins, np.array([0.25]))
    np.testing.assert_allclose(found, [[0.25, 0.55, 0.85] * 2], rtol=1e-15)


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(0, 2)), min_size=2, max_size=40))
def test_a_stop_never_generates_energy(steps: list[tuple[float, float]]) -> None:
    """F x v dt >= the change of F w x^2 / 2 in every step, for any motion of its bound."""
    w, x = 0.5, 0.0
    for v, s in steps:
        after = float(NUMPY["clip"](x + v / w, s))
        assert after * v >= w / 2.0 * (after**2 - x**2) - 1e-12
        x = after


def test_later_elements_see_updated_earlier_ones() -> None:
    age = Relaxation(name="p", unit="1", drive=absolute(DQ), rate=sympy.Integer(2))
    stop = Stop(name="x", unit="1", velocity=DQ, deflection=0.1, bound=age.state)
    tried = law(age, stop, output=stop.state)
    t = 0.1 * np.arange(40)
    dq = np.sin(t)
    p, x, expected = 0.0, 0.0, [0.0]
    for v in dq[1:]:
        p = p * np.exp(-0.2) + abs(v) * (1.0 - np.exp(-0.2)) / 2.0
        x = min(max(x + v * 0.1 / 0.1, -p), p)
        expected.append(x)
    np.testing.assert_allclose(predict(tried, t=t, dq=dq), expected, rtol=1e-13, atol=1e-15)


def test_a_rate_may_depend_on_its_own_state() -> None:
    """The law z' = v - |v| |z| z of Bouc and Wen, with the rate frozen over a step."""
    z = sympy.Symbol("z", real=True)
    element = Relaxation(name="z", unit="1", drive=DQ, rate=absolute(DQ) * absolute(z))
    tried = law(element, output=element.state)
    t = 1e-3 * np.arange(4000)
    dq = 2.0 * np.sin(3.0 * t)
    found = predict(tried, t=t, dq=dq)
    stepper = Stepper(tried)
    steps = [stepper.step(1e-3 * (k > 0), v) for k, v in enumerate(dq[:101])]
    np.testing.assert_allclose(found[:101], steps, rtol=1e-14)
    truth = solve_ivp(
        lambda s, y: 2.0 * np.sin(3.0 * s) - abs(2.0 * np.sin(3.0 * s)) * abs(y) * y,
        (0.0, t[-1]),
        [0.0],
        t_eval=t,
        rtol=1e-9,
        atol=1e-10,
    )
    assert np.abs(found - truth.y[0]).max() < 2e-3


@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_the_scalar_loop_equals_the_recursion_and_restarts(discretisation: Discretisation) -> None:
    """Bouc-Wen by hand: two records, after another state it depends on."""
    p, z = sympy.symbols("p z", real=True)
    age = Relaxation(name="p", unit="1", drive=1.0, rate=2.0)
    rate = 60 * absolute(DQ) * absolute(z) + 40 * DQ * z - p
    memory = (age, Relaxation(name="z", unit="1", drive=100 * DQ, rate=rate))
    dq = 0.3 * np.sin(0.05 * np.arange(300))
    dt, begins = np.full(300, 1e-3), np.isin(np.arange(300), (0, 170))
    found = states_over(memory, dq, dt, begins, (0.5, 0.1), discretisation)
    before = np.nan
    for v, first, age_there, x in zip(dq, begins, *found, strict=True):
        r = 0.0
        if not first:
            r = max(60 * abs(v) * abs(before) + 40 * v * before - age_there, 0.0)
        fall = 1e-3 * r if discretisation == "euler" else -np.expm1(-1e-3 * r)
        filled = 1e-3 if discretisation == "euler" or r == 0.0 else fall / r
        expected = 0.1 if first else (1.0 - fall) * before + 100 * v * filled
        assert x == pytest.approx(expected, rel=1e-12, abs=1e-14)
        before = x


def test_nan_rates_propagate_as_in_arrays() -> None:
    """A division by zero makes a guarded rate NaN, as does a root of -1."""
    z = sympy.Symbol("z", real=True)
    for rate in (z / DQ, sympy.sqrt(DQ - 2) + z):
        memory = (Relaxation(name="z", unit="1", drive=DQ, rate=rate),)
        dq, begins = np.array([0.0, 1.0, 0.0, 1.0]), np.arange(4) == 0
        x = states_over(memory, dq, np.full(4, 0.1), begins, (0.5,), "exact")[0]
        assert x[0] == 0.5
        assert np.isfinite(x).all()


@pytest.mark.parametrize("bound", [1.0, 0.0])
def test_the_continuous_stop_equals_the_sampled_one(bound: float) -> None:
    stop = Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=bound)
    slope = to_numpy_function((DQ, stop.state), [stop.express_derivative()])
    t = 1e-4 * np.arange(20000)
    dq = 0.05 * np.sin(2.0 * np.pi * t)
    truth = predict(law(stop, output=stop.state), t=t, dq=dq)
    found = solve_ivp(
        lambda s, x: [float(slope(0.05 * np.sin(2.0 * np.pi * s), x[0])[0])],
        (0.0, t[-1]),
        [0.0],
        t_eval=t,
        method="LSODA",
        rtol=1e-6,
        atol=1e-8,
        max_step=1e-3,
    )
    assert np.abs(found.y[0] - truth).max() < 5e-3


def test_the_continuous_stop_yields_if_its_bound_shrinks_at_rest() -> None:
    stop = Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=TAU_LOAD)
    slope = to_numpy_function((DQ, TAU_LOAD, stop.state), [stop.express_derivative()])
    found = solve_ivp(
        lambda s, x: [float(slope(0.0, 1.0 - 0.8 * min(s, 1.0), x[0])[0])],
        (0.0, 2.0),
        [1.0],
        method="LSODA",
        rtol=1e-8,
        atol=1e-10,
        max_step=1e-2,
    )
    assert found.y[0, -1] == pytest.approx(0.2, rel=0.01)


# --- equations --------------------------------------------------------------------------------


def test_equations_are_ordered_and_free_of_cycles() -> None:
    a, b = (Equation(name=n, expression=e) for n, e in (("a", Y + 1), ("y", X)))
    assert [e.name for e in Component(inputs=(signal("x"),), equations=(a, b)).ordered] == [
        "y",
        "a",
    ]
    circle = (Equation(name="x", expression=Y), Equation(name="y", expression=X))
    with pytest.raises(ArtifactError, match=r"'x' depends on itself through x, y; use previous"):
        Component(equations=circle)


def test_previous_needs_a_start() -> None:
    with pytest.raises(ArtifactError, match=r"symbol 'previous\(y\)' of 'y' is neither"):
        Component(equations=(Equation(name="y", expression=previous("y") + 1),))
    counter = Equation(name="y", expression=previous("y") + 1, start=sympy.Integer(4))
    assert Component(equations=(counter,)).starting == {Y: 5}


def test_controller_dependencies_are_derived() -> None:
    own = controller_equations(0.005)
    used = {str(s) for s in own.find_sources(sympy.Symbol("tau_d", real=True))}
    assert used == {"tau_rb", "tau_f", "friction_gain"}
    compensation = sympy.Symbol("dq_comp", real=True)
    now, at_start = (
        {str(s) for s in own.find_sources(compensation, starting=s)} for s in (False, True)
    )
    assert {"q_d", "q", "Kx"}.isdisjoint(now)
    assert {"previous(e)", "previous(integral)"} <= now
    assert not any(s.startswith("previous") for s in at_start)


def test_step_dependent_variables_are_held_between_steps() -> None:
    assert velocity_equations().holds
    assert not controller_equations(0.005).holds


def test_a_tangent_follows_named_expressions() -> None:
    own = Component(
        inputs=(signal("x"),),
        equations=(
            Equation(name="a", expression=X**2),
            Equation(name="b", expression=sympy.sin(sympy.Symbol("a", real=True)), output=True),
        ),
    )
    seed = sympy.Symbol("seed", real=True)
    program = {**readings(own), **derive_changes({X: seed}, readings(own))}
    b = program[change_symbol(sympy.Symbol("b", real=True))]
    for symbol in (change_symbol(sympy.Symbol("a", real=True)), sympy.Symbol("a", real=True)):
        b = b.subs(symbol, program[symbol])
    assert sympy.simplify(b - 2 * X * seed * sympy.cos(X**2)) == 0


# --- single steps -----------------------------------------------------------------------------


def test_memory_may_read_previous_values() -> None:
    """A bound that follows the previous output: each step sees the one before it."""
    u, x = signal("u"), sympy.Symbol("x", real=True)
    grows = Component(
        inputs=(u,),
        memory=(Stop(name="x", unit="1", velocity=u.symbol, deflection=1, bound=previous("y")),),
        equations=(
            Equation(name="y", expression=previous("y") + DT * u.symbol, start=sympy.Float(1)),
            Equation(name="held", expression=x, output=True),
        ),
    )
    assert grows.sampled_memory
    assert not velocity_equations().sampled_memory
    run = Steps(grows).run({}, [0.0], ["u"])
    assert run.begin(2.0) == [0.0]
    # From 0 by 4 within 1; y is then 1 + 2 * 2 = 5, from 1 by 8 within 5.
    assert [run.step(2.0, 2.0), run.step(4.0, 2.0)] == [[1.0], [5.0]]


def test_before_the_first_step_no_time_has_passed() -> None:
    u = signal("u")
    grows = Component(
        inputs=(u,),
        equations=(
            Equation(
                name="y", expression=previous("y") + DT * u.symbol, start=u.symbol, output=True
            ),
        ),
    )
    assert Steps(grows).run({}, [], ["u"]).begin(3.0) == [3.0]
