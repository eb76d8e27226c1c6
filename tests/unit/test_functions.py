"""The functions available to laws: derivatives, NumPy code and LaTeX."""

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from hesr_model.equations.functions import (
    NUMPY,
    SCALAR,
    absolute,
    cardinal_sine,
    cardinal_slope,
    clip,
    decay,
    exceeds,
    larger,
    over,
    positive,
    sgn,
    share,
    to_numpy_function,
)
from hesr_model.equations.stepping import numpy_function
from hesr_model.friction.inputs import DQ, INPUT_UNITS, INPUTS, TAU_LOAD, Q

X = sympy.Symbol("x", real=True)
numbers = st.floats(-1e6, 1e6)


def test_inputs_are_ordered_and_have_si_units() -> None:
    assert INPUTS == (DQ, Q, TAU_LOAD)
    assert INPUT_UNITS == {"dq": "rad/s", "q": "rad", "tau_load": "N.m"}


@pytest.mark.parametrize(("value", "expected"), [(-2.5, -1), (0, 0), (3, 1)])
def test_sgn_of_a_number_is_its_sign(value: float, expected: int) -> None:
    assert sgn(sympy.sympify(value)) == expected


def test_absolute_of_a_number_is_its_magnitude() -> None:
    assert absolute(sympy.Integer(-3)) == 3
    assert absolute(sympy.Float(-0.25)) == 0.25
    assert absolute(sympy.Integer(0)) == 0


def test_functions_of_a_symbol_are_not_evaluated() -> None:
    assert sgn(X).func is sgn
    assert absolute(X).func is absolute


def test_derivatives_hold_almost_everywhere_without_impulses() -> None:
    assert sgn(X).diff(X) == 0
    assert absolute(X).diff(X) == sgn(X)
    assert absolute(X).diff(X, 2) == 0
    assert absolute(3 * X**2).diff(X) == 6 * X * sgn(3 * X**2)
    assert (sgn(X) * X).diff(X) == sgn(X)
    for expression in (sgn(X), absolute(X)):
        assert not expression.diff(X).atoms(sympy.DiracDelta, sympy.Derivative)


@given(st.lists(numbers, min_size=1, max_size=20))
def test_lowered_functions_are_numpys_own(values: list[float]) -> None:
    x = np.array(values)
    sign, size = to_numpy_function((X,), (sgn(X), absolute(X)))(x)
    np.testing.assert_array_equal(sign, np.sign(x))
    np.testing.assert_array_equal(size, np.abs(x))


@pytest.mark.parametrize("x", [0.0, 1e-9, 4e-4, -9.9e-4, 1.1e-3, 0.7, -40.0])
def test_cardinal_sine_and_slope_are_exact_near_zero(x: float) -> None:
    z = sympy.Symbol("z", real=True)
    exact = sympy.sin(z) / z
    # Just above the end of its series the slope is a difference of large numbers.
    cases = ((cardinal_sine(z), exact, 1e-14), (cardinal_slope(z), exact.diff(z), 1e-10))
    for form, right, tolerance in cases:
        (found,) = to_numpy_function((z,), (form,))(np.array([x]))
        wanted = (
            float(right.subs(z, sympy.Rational(x)).evalf(40)) if x else float(right.limit(z, 0))
        )
        np.testing.assert_allclose(found, [wanted], rtol=tolerance, atol=1e-300)


def test_lowered_functions_take_their_arguments_in_the_given_order() -> None:
    y = sympy.Symbol("y", real=True)
    difference, product = to_numpy_function((y, X), (X - 2 * y, X * y))(3.0, 10.0)
    assert (difference, product) == (4.0, 30.0)


def test_a_lowered_constant_is_a_number() -> None:
    assert to_numpy_function((X,), (sympy.Integer(2),))(np.zeros(3)) == [2]


def test_latex_uses_textbook_notation() -> None:
    assert sympy.latex(sgn(X)) == r"\operatorname{sgn}\left(x\right)"
    assert sympy.latex(absolute(X)) == r"\left|x\right|"
    assert sympy.latex(sgn(X) ** 2) == r"\operatorname{sgn}^{2}\left(x\right)"
    assert sympy.latex(absolute(X) ** 2) == r"\left|x\right|^{2}"


@pytest.mark.parametrize("z", [1e-300, 1e-9, 0.99e-3, 1.01e-3, 0.02, 0.9, 7.0, 200.0])
def test_relaxation_factors_over_a_step(z: float) -> None:
    """exp(-z) - 1, (1 - exp(-z)) / z and its slope, on both sides of the switch to series."""
    with mpmath.workdps(700):
        x = mpmath.mpf(z)
        left = mpmath.exp(-x)
        falls, taken = float(left - 1), float((1 - left) / x)
        slope = float((left * (x + 1) - 1) / x**2)
    e = NUMPY["decay"](z, 0.0)
    assert e == pytest.approx(falls, rel=1e-15, abs=0.0)
    assert NUMPY["share"](z, e, 0.0) == pytest.approx(taken, rel=1e-15, abs=0.0)
    # The quotient loses digits down to the switch.
    accuracy = 1e-15 if z < 1e-3 else 2e-10
    assert NUMPY["share_slope"](z, e, 0.0) == pytest.approx(slope, rel=accuracy, abs=0.0)
    by_euler = [NUMPY["decay"](z, 1.0), *(NUMPY[n](z, -z, 1.0) for n in ("share", "share_slope"))]
    assert by_euler == [-z, 1.0, 0.0]


def test_bounds_and_comparisons_of_arrays() -> None:
    x = np.array([-3.0, -1.0, 0.0, 2.0, 9.0])
    np.testing.assert_array_equal(NUMPY["clip"](x, 2.0), [-2.0, -1.0, 0.0, 2.0, 2.0])
    np.testing.assert_array_equal(NUMPY["exceeds"](x, 2.0), [0.0, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(NUMPY["positive"](np.append(x, np.nan)), [0, 0, 0, 2, 9, 0])
    np.testing.assert_array_equal(NUMPY["larger"](x, 1.0), [1.0, 1.0, 1.0, 2.0, 9.0])


@pytest.mark.parametrize(("x", "slope"), [(3.0, 6.0), (0.5, 1.0), (-2.0, -4.0)])
def test_a_maximum_has_the_slope_of_the_larger_argument(x: float, slope: float) -> None:
    for pair in (larger(X**2, X), larger(X, X**2)):
        (found,) = to_numpy_function([X], [pair.diff(X)])(x)
        assert found == slope


@pytest.mark.parametrize(
    ("a", "b", "values"),
    [
        (3.0, 2.0, (1.5, 0.5, -0.75, 0.0)),
        (3.0, 0.0, (7.0, 0.0, 0.0, 1.0)),
        (3.0, -2.0, (7.0, 0.0, 0.0, 1.0)),
    ],
)
def test_a_quotient_and_its_slopes_at_a_zero_divisor(
    a: float, b: float, values: tuple[float, ...]
) -> None:
    p, q, r = sympy.symbols("p q r", real=True)
    whole = over(p, q, r)
    found = to_numpy_function([p, q, r], [whole, *(whole.diff(x) for x in (p, q, r))])(a, b, 7.0)
    assert tuple(map(float, found)) == values


SLOPED = {
    "sgn": (sgn(X), (-0.3, 2.0)),
    "absolute": (absolute(X), (-0.3, 2.0)),
    "positive": (positive(X), (-0.3, 2.0)),
    "larger": (larger(X, 0.5), (-0.3, 2.0)),
    "clip to a bound": (clip(X, 0.5), (-0.7, -0.3, 0.3, 2.0)),
    "clip to x": (clip(0.5, X), (0.3, 2.0)),
    "negative clip to x": (clip(-0.5, X), (0.3, 2.0)),
    "exceeds": (exceeds(X, 0.5), (-0.3, 2.0)),
    "decay": (decay(X, 0.0), (0.1, 2.0)),
    "decay by Euler": (decay(X, 1.0), (0.1, 2.0)),
    "share": (share(X, decay(X, 0.0), 0.0), (5e-4, 0.1, 2.0)),
    "share by Euler": (share(X, decay(X, 1.0), 1.0), (0.1, 2.0)),
    "cardinal_sine": (cardinal_sine(X), (-0.7, 5e-4, 3.0)),
}


@pytest.mark.parametrize("name", SLOPED)
def test_slopes_match_differences(name: str) -> None:
    whole, places = SLOPED[name]
    value, slope = to_numpy_function([X], [whole]), to_numpy_function([X], [whole.diff(X)])
    for x in places:
        step = 1e-5 * abs(x)
        difference = (value(x + step)[0] - value(x - step)[0]) / (2.0 * step)
        assert float(slope(x)[0]) == pytest.approx(float(difference), rel=1e-6, abs=1e-6)


VALUES = (-3.0, -0.5, -4e-4, 0.0, 4e-4, 0.5, 3.0)


@pytest.mark.parametrize("name", sorted(SCALAR))
def test_functions_of_one_number_match_those_of_arrays(name: str) -> None:
    count = {"sgn": 1, "absolute": 1, "positive": 1, "cardinal_sine": 1, "over": 3, "share": 3}
    for x in VALUES:
        for y in VALUES[: 1 if count.get(name, 2) == 1 else None]:
            rest = (y, 0.0)[: count.get(name, 2) - 1]
            if name == "cardinal_sine" and x == 0.0:
                continue
            if name in ("decay", "share"):
                rest = (float(y > 0.0),) if name == "decay" else (np.expm1(-x), float(y > 0.0))
            if name == "clip":
                rest = (abs(y),)
            found = SCALAR[name](x, *rest)
            assert found == pytest.approx(float(NUMPY[name](x, *rest)), rel=1e-12, abs=0.0), (
                x,
                rest,
            )


def test_numpy_functions_of_programs_keep_the_order_of_operations() -> None:
    a, b, c, total, result = sympy.symbols("a b c total result", real=True)
    evaluate = numpy_function([a, b, c], {total: c + b, result: total + a}, [result])
    [found] = evaluate(np.array([1.0, 2.0]), -1e16, 1e16)
    assert found.tolist() == [1.0, 2.0]  # (a + b) + c would be 0 and 2
