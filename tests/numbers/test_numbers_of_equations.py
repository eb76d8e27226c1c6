"""Adaptive equations step by step under odd conditions, and functions to the last digits."""

from collections.abc import Callable

import numpy as np
import pytest
import sympy
from adaptive_models import SPEED, lugre, motion, stops
from mpmath import mp, mpf
from oracles.intervals import reach
from unchanged import Unchanged

from hesr.extras.adaptive.component import TUNING, Tuning, adaptive_component
from hesr_model.equations import functions
from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.equations.operations import Graph
from hesr_model.equations.recurrence import recurrence
from hesr_model.equations.stepping import Steps
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.thermal import Thermal

WARM = Thermal(
    coulomb=0.004, viscous=-0.02, reference=30.0, resistance=0.3, time_constant=40.0, ambient=22.0
)
OUTPUTS = ["tau", "level", "viscosity", "offset", "level_sd", "viscosity_sd", "offset_sd",
           "drift", "shift", "health"]  # fmt: skip
NARROW = Tuning(
    level=(0.93, 1.06),
    viscosity=(0.8, 1.2),
    alarm=1.5,
    forgetting_time=3.0,
    offset=0.4,
    offset_rate=0.3,
    hold=0.05,
)
START = {"noise": 0.8, "level_start": 1.0, "viscosity_start": 1.0, "torque_limit": 45.0,
         "speed_least": 0.05, "offset_start": 0.1}  # fmt: skip


# --- adaptive equations -----------------------------------------------------------------------


@pytest.mark.parametrize("tuning", [TUNING, NARROW], ids=["as chosen", "narrow"])
@pytest.mark.parametrize("law", [lugre, stops], ids=["LuGre", "ParFam-S"])
@pytest.mark.parametrize("thermal", [None, WARM], ids=["cold", "warm"])
def test_steps_of_an_adaptive_law(
    tuning: Tuning, law: Callable[[], FrictionLaw], thermal: Thermal | None, unchanged: Unchanged
) -> None:
    """The joint rests, is switched off, saturates, meets outliers and NaN, and friction rises."""
    of = law()
    component = adaptive_component(
        of, tuning, noise=0.8, speed=SPEED, min_viscosity=0.85, thermal=thermal
    )
    values = {p.name: p.start for p in component.parameters if p.name not in of.values}
    start = (0.0, *of.start) if thermal else of.start
    if thermal:
        values["thermometer"] = 0.4  # makes heat and temperature count
    names = [q.name for q in component.inputs]
    run = Steps(component, OUTPUTS).run(values | of.values | START, start, names)
    t, dq, q, load = motion(9.0, 3, 0.02)
    dq = np.where((t > 2.0) & (t < 2.3), 0.0, dq)
    noise = np.random.default_rng(0).normal(size=len(t))
    known = {"dq": dq, "q": q, "tau_load": load, "tau_rigid": 0.4 * load,
             "adapt": np.where((t > 3.0) & (t < 3.2), 0.5, 1.0),
             "temperature": 25.0 + t}  # fmt: skip
    rows, inside = [], []
    before = 0.0
    for k in range(len(t)):
        tau = (1.0 + 0.3 * (t[k] > 5.0)) * before + 0.8 * noise[k] + 0.4 * load[k]
        tau += {120: 60.0, 121: -200.0, 122: np.nan, 200: 44.0}.get(k, 0.0)
        now = [
            float({**{n: v[k] for n, v in known.items()}, "tau_meas": tau}[i.name])
            for i in component.inputs
        ]
        found = run.begin(*now) if k == 0 else run.step(0.02, *now)
        before = found[0]
        rows.append(found)
        inside.append(list(run.remembered))
    at = [0, 1, 2, 5, 50, 101, 116, 121, 123, 126, 150, 160, 201, 205, 240, 260, 300, 380, 449]
    unchanged(
        {
            "outputs": {n: np.array(rows)[at, i] for i, n in enumerate(OUTPUTS)},
            "inside": np.array(inside, dtype=float)[at].T.tolist(),
        },
        rtol=1e-5,
        atol=1e-9,
    )


def test_numbers_of_an_adaptive_law(unchanged: Unchanged) -> None:
    unchanged({"tuning": TUNING})


# --- functions --------------------------------------------------------------------------------

EXACT: dict[str, Callable[[mpf], mpf]] = {
    "share": lambda z: (1 - mp.exp(-z)) / z,
    "share_slope": lambda z: (mp.exp(-z) * (1 + z) - 1) / z**2,
    "cardinal_sine": lambda z: mp.sin(z) / z,
    "cardinal_slope": lambda z: mp.cos(z) / z - mp.sin(z) / z**2,
}


@pytest.mark.parametrize("name", EXACT)
def test_functions_are_exact_on_either_side_of_their_series(name: str) -> None:
    near = np.array([1e-9, 1e-5, 3e-4, 7e-4, 9.9e-4, 9.999e-4])
    small = np.concatenate([-near[::-1], near])
    large = np.array([9e-3, 0.3, 1.0, 2.5, 7.0])
    with mp.workdps(40):
        for points, rtol in (
            (small, 4e-15 if "slope" in name else 1.2e-15),
            (np.concatenate([-large, large]), 3e-11 if "slope" in name else 3e-15),
        ):
            wanted = [float(EXACT[name](mpf(float(z)))) for z in points]
            more = (np.expm1(-points), False) if name.startswith("share") else ()
            of_all = functions.NUMPY[name](points, *more)
            np.testing.assert_allclose(of_all, wanted, rtol=rtol)
            if name in functions.SCALAR:
                each = [
                    functions.SCALAR[name](float(z), *(float(np.expm1(-z)), 0.0)[: len(more)])
                    for z in points
                ]
                np.testing.assert_allclose(each, wanted, rtol=rtol)


def test_functions_at_zero_and_with_euler() -> None:
    zero = np.zeros(2)
    of = functions.NUMPY
    assert of["share"](zero, zero, False).tolist() == [1.0, 1.0]
    assert of["share_slope"](zero, zero, False).tolist() == [-0.5, -0.5]
    assert of["cardinal_sine"](zero).tolist() == [1.0, 1.0]
    assert of["cardinal_slope"](zero).tolist() == [0.0, 0.0]
    some = np.array([0.5, 1e-5])
    assert of["share"](some, -some, True).tolist() == [1.0, 1.0]
    assert of["share_slope"](some, -some, True).tolist() == [0.0, 0.0]
    assert of["decay"](some, True).tolist() == (-some).tolist()
    assert functions.SCALAR["share"](0.5, -0.5, 1.0) == 1.0
    assert functions.SCALAR["decay"](0.5, 1.0) == -0.5
    assert of["over"](1.0, 0.0, 7.0) == functions.SCALAR["over"](1.0, 0.0, 7.0) == 7.0
    assert of["over"](1.0, 0.5, 7.0) == functions.SCALAR["over"](1.0, 0.5, 7.0) == 2.0


@pytest.mark.parametrize("name", ["sgn", "absolute", "positive", "larger", "clip", "exceeds"])
def test_functions_of_scalars_equal_those_of_arrays(name: str) -> None:
    points = (-2.0, -0.5, 0.0, 0.5, 1.0, 2.0, 0.25)
    count = {"larger": 2, "clip": 2, "exceeds": 2}.get(name, 1)
    for x in points:
        for y in points if count == 2 else (0.0,):
            if name == "clip" and y < 0.0:
                continue
            arguments = (x, y)[:count]
            one = functions.SCALAR[name](*arguments)
            assert one == float(functions.NUMPY[name](*arguments)), (name, arguments)
            symbolic = getattr(functions, name)(*map(sympy.Float, arguments))
            assert float(symbolic) == one


def test_derivatives_of_functions_of_two_arguments() -> None:
    a, b, c = sympy.symbols("a b c", real=True)
    of = functions
    at = {a: 0.3, b: 0.7, c: 2.0}
    cases = (
        (of.larger(a, b), (0.0, 1.0)), (of.larger(b, a), (0.0, 1.0)),
        (of.clip(a, b), (1.0, 0.0)), (of.clip(-b, a), (-1.0, 0.0)),
        (of.over(a, b, c), (1.0 / 0.7, -0.3 / 0.49)), (of.over(a, -b, b), (0.0, 1.0)),
        (of.exceeds(a, b), (0.0, 0.0)), (of.positive(a * b), (0.7, 0.3)),
        (of.absolute(-a * b), (0.7, 0.3)), (of.cardinal_sine(a + b), None),
    )  # fmt: skip
    for expression, wanted in cases:
        found = [float(expression.diff(s).subs(at)) for s in (a, b)]
        if wanted is None:
            wanted = (np.cos(1.0) - np.sin(1.0),) * 2
        np.testing.assert_allclose(found, wanted, atol=1e-12)


# --- over logs --------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [1, 2, 127, 128, 129, 600])
def test_clips_of_all_rows_equal_those_row_by_row(rows: int) -> None:
    rng = np.random.default_rng(rows)
    way, bound = rng.normal(size=(2, rows)), np.abs(rng.normal(size=(2, rows)))
    begins = rng.random(rows) < 0.05
    begins[0] = True
    start = rng.normal(size=2)
    ways, bounds = sympy.symbols("v:2", real=True), sympy.symbols("s:2", real=True)
    stops = [
        Stop(name=f"x{i}", unit="1", velocity=v, deflection=1, bound=s)
        for i, (v, s) in enumerate(zip(ways, bounds, strict=True))
    ]
    kernel = Kernel(stops, (), (*ways, *bounds), [stop.state for stop in stops])
    run = KernelRun(kernel, [*way, *bound], np.ones(rows), np.flatnonzero(begins))
    found = run.evaluate(np.zeros(0), start, settled=True).T
    x = start
    for k in range(rows):
        x = start if begins[k] else np.clip(x + way[:, k], -bound[:, k], bound[:, k])
        np.testing.assert_allclose(found[:, k], x, atol=1e-12)


def test_a_recurrence_equals_a_loop() -> None:
    a, c = np.linspace(0.1, 0.9, 7), np.linspace(1.0, -2.0, 7)
    x = [3.0]
    for k in range(1, 7):
        x.append(a[k] * x[-1] + c[k])
    np.testing.assert_allclose(recurrence(a, c, 3.0), x, rtol=1e-13)
    np.testing.assert_allclose(recurrence(a[:1], c[:1], 3.0), [3.0])


# --- structure of expressions -----------------------------------------------------------------


def test_whole_powers_up_to_eight_are_products() -> None:
    x = sympy.Symbol("x", real=True)
    for power, products in ((2, 1), (8, 7)):
        graph = Graph([], [x])
        graph.find_node(x**power)
        assert [n.operation for n in graph.nodes].count("MULTIPLY") == products
    for odd in (x**9, x ** sympy.Rational(1, 3), x**1.5):
        graph = Graph([], [x])
        graph.find_node(odd)
        assert [n.operation for n in graph.nodes].count("POWER") == 1


def test_range_of_a_rate() -> None:
    x, y = sympy.symbols("x y", real=True)
    box = {x: (-2.0, 1.0), y: (1.0, 3.0)}
    cases = {
        x**2: (0.0, 4.0), x**3: (-8.0, 1.0), 1 / y: (1.0 / 3.0, 1.0), x * y: (-6.0, 3.0),
        functions.absolute(x): (0.0, 2.0), functions.clip(x, y): (-2.0, 1.0), x + y: (-1.0, 4.0),
        sympy.cosh(x): (1.0, np.cosh(2.0)), sympy.sin(y): (-1.0, 1.0),
        sympy.sqrt(y): (1.0, 3.0**0.5),
        sympy.exp(-(x**2)): (np.exp(-4.0), 1.0), y**-2: (1.0 / 9.0, 1.0),
    }  # fmt: skip
    for rate, (low, high) in cases.items():
        found = reach(Relaxation(name="z", unit="1", drive=x, rate=rate), box)
        assert found.low == pytest.approx(low, abs=0.05), rate
        assert found.high == pytest.approx(high, rel=0.02, abs=0.06), rate
        assert bool(found.guarded) == (low < 0.0)
        assert found.finite
    assert not reach(Relaxation(name="z", unit="1", drive=x, rate=1 / x), box).finite
    thin = reach(Relaxation(name="z", unit="1", drive=x, rate=x), {x: (-1.0, -1.0)})
    assert (thin.low, thin.high) == (-1.0, -1.0)
