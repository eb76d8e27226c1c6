"""Symbols and functions from which friction laws are written.

SymPy's `sign` differentiates to a Dirac impulse and its `Abs` to a complex expression; friction
needs the derivative almost everywhere of a real argument, so both are defined here.
"""

from typing import Any

import numpy as np
import sympy
from sympy.printing.latex import LatexPrinter

DQ = sympy.Symbol("dq", real=True)
"""Joint velocity [rad/s]."""
Q = sympy.Symbol("q", real=True)
"""Joint position [rad]."""
TAU_LOAD = sympy.Symbol("tau_load", real=True)
"""Load torque on the joint [N.m]: the rigid-body torque of the motion."""

INPUTS = (DQ, Q, TAU_LOAD)
"""Inputs that a law may use, in the order in which every lowering passes them."""

INPUT_UNITS = {"dq": "rad/s", "q": "rad", "tau_load": "N.m"}
"""Of a joint that turns; `units.unit_of_joint` has those of one that slides."""


class sgn(sympy.Function):  # type: ignore[misc]  # noqa: N801 - printed under this name
    """Sign of a real argument, 0 at 0, with derivative 0 everywhere."""

    nargs = 1

    @classmethod
    def eval(cls, x: sympy.Expr) -> sympy.Expr | None:
        """Evaluate for numbers only."""
        return sympy.sign(x) if x.is_number else None

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        """Return the derivative, 0 almost everywhere."""
        del argindex
        return sympy.Integer(0)

    def _latex(self, printer: LatexPrinter, exp: str | None = None) -> str:
        power = f"^{{{exp}}}" if exp else ""
        return rf"\operatorname{{sgn}}{power}\left({printer.doprint(self.args[0])}\right)"


class absolute(sympy.Function):  # type: ignore[misc]  # noqa: N801 - printed under this name
    """Absolute value of a real argument, with derivative `sgn`."""

    nargs = 1

    @classmethod
    def eval(cls, x: sympy.Expr) -> sympy.Expr | None:
        """Evaluate for numbers only."""
        return sympy.Abs(x) if x.is_number else None

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        """Return the derivative."""
        del argindex
        return sgn(self.args[0])

    def _latex(self, printer: LatexPrinter, exp: str | None = None) -> str:
        power = f"^{{{exp}}}" if exp else ""
        return rf"\left|{printer.doprint(self.args[0])}\right|{power}"


def lowered(arguments: tuple[sympy.Symbol, ...], expressions: tuple[sympy.Expr, ...]) -> Any:
    """Return a NumPy function of `arguments` that returns the list of `expressions`."""
    own = {"sgn": np.sign, "absolute": np.abs}
    return sympy.lambdify(arguments, list(expressions), modules=[own, "numpy"], cse=True)
