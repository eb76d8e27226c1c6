"""What printers of languages with 64-bit literals share: names, and numbers to the last bit."""

from collections.abc import Mapping

import sympy
from sympy.printing.codeprinter import CodePrinter


class LanguagePrinter(CodePrinter):  # type: ignore[misc] # SymPy is not typed
    """Prints symbols by the names that they are given, and every number as a float."""

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__()
        self._names = names

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    _print_Dummy = _print_Symbol

    def _print_Float(self, expr: sympy.Expr) -> str:
        return repr(float(expr))

    _print_Rational = _print_Float
    _print_NumberSymbol = _print_Float
    _print_Pi = _print_Float
    _print_Exp1 = _print_Float
