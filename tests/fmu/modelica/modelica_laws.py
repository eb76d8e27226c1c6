"""Laws of the package exported for the compilers."""

from pathlib import Path

import sympy
from registry_models import STUDIED

from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm

LIBRARY = Path(__file__).parent / "library"
"""Folder of the replacement for the Modelica Standard Library."""

ADDED = ("ripple", "gaussians", "start", "shapes")
"""One law with ripple in the joint angle, one with 90 coefficients, one with a non-zero start, one
with expressions that are easily misprinted."""

EVERY = (*STUDIED, *ADDED)
"""Names of the joints' laws: all of the registry, and those above."""

STOPS = ("parfam_s", "parfam_s_load", "parfam_s_v")
"""Laws with stops, whose event-free form is stiff."""


def shapes() -> FrictionLaw:
    """Powers of powers, quotients of quotients, signs of states and products."""
    own = tuple(Coefficient(name=n, unit="1", description=f'"{n}"') for n in "abcn")
    a, b, c, n = (coefficient.symbol for coefficient in own)
    h = Relaxation(
        name="h", unit="1", drive=b * DQ - a * sgn(DQ * (1 + DQ**2)), rate=-a * b * absolute(b * DQ)
    )
    x, dx = h.state, h.derivative
    terms = (
        (c**n) ** DQ,
        c ** (n**2),
        1 / (c * (1 + DQ**2)) / c,
        -((DQ - c) ** 3) / c**-n,
        (-DQ) ** 2 * sympy.Rational(-1, 3),
        c ** (-a / b),
        sympy.sqrt(c + x**2) + 1 / sympy.sqrt(c + x**2),
        (2 + x**2) ** sympy.Rational(-3, 2),
        (c + x**2) ** sympy.Float(-1.7),
        sympy.log(c) * sympy.pi * sympy.E,
        sympy.atan2(DQ, c) - sympy.atan(TAU_LOAD / c) * sympy.cosh(Q),
        sympy.sin(-Q) * sympy.tan(Q / 2) / (-c),
        absolute(x) * sgn(x - 100) - sgn(x + dx - 1000) ** 2,
        sgn(b * DQ) * absolute(TAU_LOAD),
    )
    form = LawForm(coefficients=own, memory=(h,), output=sympy.Add(*terms))
    return FrictionLaw(
        name="real", form=form, values={"a": -0.7, "b": 1e-05 + 3.0, "c": 1.9, "n": 2.5}
    )
