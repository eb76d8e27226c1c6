"""Interval arithmetic: valid and tight bounds, and places where guards act."""

from math import inf

import numpy as np
import pytest
import sympy
from oracles.intervals import Box, reach

from hesr_model.equations.functions import absolute, clip, larger, positive, sgn, to_numpy_function
from hesr_model.equations.intervals import bound_expression, find_minimum
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.fitting.estimator import registry
from hesr_model.friction.inputs import DQ, TAU_LOAD

X, Y = sympy.symbols("x y", real=True)
BOX = {X: (-1.5, 2.0), Y: (0.25, 3.0)}


def enclosure(expression: sympy.Expr, box: Box) -> tuple[float, float]:
    """Bounds of an expression, evaluated as a rate."""
    found = reach(Relaxation(name="z", unit="1", drive=X, rate=expression), box)
    return found.low, found.high


EXPRESSIONS = [
    X * Y - X**2,
    X**3 / Y,
    absolute(X) / (1 + 2 * sympy.exp(-((X / Y) ** 2))),
    sympy.sqrt(Y) * sympy.tanh(X) + sgn(X),
    clip(X * Y, absolute(X) + 1) + larger(X, Y - 1),
    positive(X - Y) * sympy.cos(X) + sympy.log(Y) + sympy.cosh(X) * sympy.sin(Y),
    1 / (2 + absolute(X)) ** 2,
]


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_values_lie_within_and_reach_near_the_bounds(expression: sympy.Expr) -> None:
    low, high = enclosure(expression, BOX)
    x, y = np.meshgrid(np.linspace(*BOX[X], 301), np.linspace(*BOX[Y], 301))
    values = to_numpy_function((X, Y), [expression])(x, y)[0]
    assert low <= values.min() <= values.max() <= high
    wide = values.max() - values.min()
    loose = 0.6 if expression.has(sympy.cos) else 0.08  # sines and cosines are bounded by -1 and 1
    assert high - low < (1.0 + 2.0 * loose) * wide


@pytest.mark.parametrize("expression", [1 / X, sympy.log(X), sympy.sqrt(X), sympy.gamma(X)])
def test_possibly_undefined_values_are_unbounded(expression: sympy.Expr) -> None:
    low, high = enclosure(expression, BOX)
    assert low == -inf or high == inf


def test_a_finite_non_negative_rate_is_not_guarded() -> None:
    rate = absolute(X) / (1 + sympy.exp(-((X / Y) ** 2)))
    found = reach(Relaxation(name="z", unit="1", drive=X, rate=rate), BOX)
    assert found.finite
    assert found.low >= 0.0
    assert not found.guarded


def test_inputs_for_which_a_bound_is_guarded() -> None:
    stop = Stop(name="w", unit="1", velocity=X, deflection=0.1, bound=1 + X)
    found = reach(stop, BOX)
    assert found.finite
    assert found.low == pytest.approx(-0.5)
    assert max(box[X][1] for box in found.guarded) == pytest.approx(-1.0, abs=2e-3)
    assert min(box[X][0] for box in found.guarded) == BOX[X][0]


def test_bounds_of_constants() -> None:
    assert enclosure(sympy.Float(2.5), {}) == (2.5, 2.5)
    assert reach(Relaxation(name="z", unit="1", drive=X, rate=-1.0), {}).guarded == ({},)


def test_the_rate_of_lugre_is_finite_and_no_guard_acts() -> None:
    """Proven for a form with its coefficients, over the inputs of a log."""
    form = registry()["lugre"].form({})
    values = {"sigma_0": 3e3, "sigma_1": 20.0, "sigma_2": 5.0, "F_c": 4.0, "F_s": 6.0, "v_s": 0.1}
    numbers = {c.symbol: sympy.Float(values.get(c.name, 0.0)) for c in form.coefficients}
    (bristle,) = (m.subs(numbers) for m in form.memory)
    found = reach(bristle, {DQ: (-2.0, 2.0), TAU_LOAD: (-40.0, 40.0)})
    assert found.finite
    assert not found.guarded
    assert found.high == pytest.approx(3e3 * 2.0 / 4.0, rel=0.01)


@pytest.mark.parametrize("name", registry())
def test_rates_and_bounds_of_every_law_lie_within_theirs(name: str) -> None:
    estimator = registry()[name]
    form = estimator.form(getattr(estimator, "typical", {}))
    rng = np.random.default_rng(0)
    numbers = {c.symbol: sympy.Float(rng.uniform(0.2, 2.0)) for c in form.coefficients}
    for element in form.memory:
        expression = element.subs(numbers).parts[1]
        symbols = sorted(expression.free_symbols, key=str)
        ends = rng.normal(size=(len(symbols), 2, 200)) * 10.0 ** rng.uniform(-3.0, 2.0, 200)
        ends.sort(axis=1)
        boxes = {s: (a, b) for s, (a, b) in zip(symbols, ends, strict=True)}
        low, high = np.broadcast_arrays(*bound_expression(expression, boxes), np.empty(200))[:2]
        for share in rng.uniform(size=(20, len(symbols), 200)):
            values = to_numpy_function(symbols, [expression])(
                *(ends[:, 0] + share * np.ptp(ends, axis=1))
            )[0]
            slack = 1e-9 * np.abs(values)
            assert np.all(low - slack <= values)
            assert np.all(values <= high + slack)


def test_a_clip_to_a_bound_that_varies() -> None:
    box = {X: (np.array([2.0]), np.array([3.0])), Y: (np.array([1.0]), np.array([5.0]))}
    assert [float(side) for side in np.ravel(bound_expression(clip(X, Y), box))] == [1.0, 3.0]


@pytest.mark.parametrize("at", [0.37, 4.2e4])
def test_the_least_value_is_found_in_a_dip_between_grid_points(at: float) -> None:
    dip = 1 - 1.5 * sympy.exp(-((1e4 * (X - at) / at) ** 2)) + 0.1 / (1 + X)
    edges = np.geomspace(1e-3, 1e6, 37)
    found = find_minimum(lambda a, b: bound_expression(dip, {X: (a, b)})[0], edges)
    assert found.bound <= found.value == pytest.approx(0.1 / (1.0 + at) - 0.5, abs=1e-4)
    assert found.bound == pytest.approx(found.value, abs=1e-5)
    assert found.minimiser == pytest.approx(at, rel=1e-3)


def test_without_a_bound_the_search_ends() -> None:
    found = find_minimum(
        lambda a, b: bound_expression(sympy.gamma(X), {X: (a, b)})[0], np.array([1.0, 2.0])
    )
    assert found.bound == -inf
