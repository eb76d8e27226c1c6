"""Common part of the printers of languages with double literals: names, numbers and powers."""

from collections.abc import Mapping
from typing import ClassVar

import sympy
from sympy.printing.codeprinter import CodePrinter
from sympy.printing.precedence import PRECEDENCE

from hesr_model.errors import ExportError


class LanguagePrinter(CodePrinter):  # type: ignore[misc] # SymPy is not typed
    """Printer of symbols by given names, with every number as a float."""

    one: ClassVar[str]  # numerator of a reciprocal
    power: ClassVar[str]  # operator

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__()
        self._names = names

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    _print_Dummy = _print_Symbol

    def _print_Float(self, expr: sympy.Expr) -> str:
        return repr(float(expr))

    _print_Rational = _print_NumberSymbol = _print_Pi = _print_Exp1 = _print_Float

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.exp == sympy.S.Half:
            return f"{self.known_functions['sqrt']}({self._print(expr.base)})"
        if expr.exp.could_extract_minus_sign():
            return f"{self.one}/{self.parenthesize(expr.base**-expr.exp, PRECEDENCE['Mul'])}"
        base, power = (self.parenthesize(e, PRECEDENCE["Pow"]) for e in (expr.base, expr.exp))
        return f"{base}{self.power}{power}"

    def text(self, expression: sympy.Expr, level: int = 0, *, of: sympy.Expr | None = None) -> str:
        """Return an expression, in parentheses if `level` binds stronger; `of` is for messages."""
        try:
            return str(self.parenthesize(expression, level))
        except NotImplementedError as error:
            raise ExportError(
                f"friction law: '{of or expression}' has no counterpart in {self.language}."
            ) from error
