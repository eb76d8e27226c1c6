"""Common part of the printers of languages with double literals: names and exact numbers."""

from collections.abc import Mapping

import sympy
from sympy.printing.codeprinter import CodePrinter


class LanguagePrinter(CodePrinter):  # type: ignore[misc] # SymPy is not typed
    """Printer of symbols by given names, with every number as a float."""

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__()
        self._names = names

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    _print_Dummy = _print_Symbol

    def _print_Float(self, expr: sympy.Expr) -> str:
        return repr(float(expr))

    _print_Rational = _print_NumberSymbol = _print_Pi = _print_Exp1 = _print_Float
