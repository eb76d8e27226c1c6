"""Interval arithmetic: valid and tight bounds, and places where guards act."""

from math import inf

import numpy as np
import pytest
import sympy
from oracles.intervals import Box, reach

from hesr_model.equations.functions import absolute, clip, larger, lowered, positive, sgn
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.registry import registry

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
    values = lowered((X, Y), [expression])(x, y)[0]
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
