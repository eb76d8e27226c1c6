"""The functions from which laws are written: derivatives that friction needs, NumPy and LaTeX."""

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from hesr_model.friction.functions import (
    DQ,
    INPUT_UNITS,
    INPUTS,
    TAU_LOAD,
    Q,
    absolute,
    lowered,
    sgn,
)

X = sympy.Symbol("x", real=True)
numbers = st.floats(-1e6, 1e6)


def test_inputs_stand_in_the_order_of_every_lowering_and_have_si_units() -> None:
    assert INPUTS == (DQ, Q, TAU_LOAD)
    assert INPUT_UNITS == {"dq": "rad/s", "q": "rad", "tau_load": "N.m"}


@pytest.mark.parametrize(("value", "expected"), [(-2.5, -1), (0, 0), (3, 1)])
def test_sgn_of_a_number_is_its_sign(value: float, expected: int) -> None:
    assert sgn(sympy.sympify(value)) == expected


def test_absolute_of_a_number_is_its_size() -> None:
    assert absolute(sympy.Integer(-3)) == 3
    assert absolute(sympy.Float(-0.25)) == 0.25
    assert absolute(sympy.Integer(0)) == 0


def test_functions_of_a_symbol_stay_as_they_are() -> None:
    assert sgn(X).func is sgn
    assert absolute(X).func is absolute


def test_derivatives_are_those_almost_everywhere_and_no_impulses() -> None:
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
    sign, size = lowered((X,), (sgn(X), absolute(X)))(x)
    np.testing.assert_array_equal(sign, np.sign(x))
    np.testing.assert_array_equal(size, np.abs(x))


def test_lowered_functions_take_their_arguments_in_the_given_order() -> None:
    y = sympy.Symbol("y", real=True)
    difference, product = lowered((y, X), (X - 2 * y, X * y))(3.0, 10.0)
    assert (difference, product) == (4.0, 30.0)


def test_a_lowered_constant_is_a_number() -> None:
    assert lowered((X,), (sympy.Integer(2),))(np.zeros(3)) == [2]


def test_latex_is_what_is_printed_in_books() -> None:
    assert sympy.latex(sgn(X)) == r"\operatorname{sgn}\left(x\right)"
    assert sympy.latex(absolute(X)) == r"\left|x\right|"
    assert sympy.latex(sgn(X) ** 2) == r"\operatorname{sgn}^{2}\left(x\right)"
    assert sympy.latex(absolute(X) ** 2) == r"\left|x\right|^{2}"
