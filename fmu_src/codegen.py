"""SymPy to C99: the functions of friction laws.

Each distinct form becomes two functions,

    relaxations(k, u, drive, rate)      drive b and rate r of every state
    torque(k, u, x, dx)                 the output map

over its coefficients k, the inputs u = (dq, q, tau_load), the states x and their derivatives dx.
"""

from collections.abc import Mapping, Sequence

import sympy
from sympy.printing.c import C99CodePrinter

from fmu_src.interface import literal
from hesr_model.errors import ExportError
from hesr_model.friction.functions import INPUTS
from hesr_model.friction.law import LawForm

_POWERS = {2: "square", 3: "cube"}


class _Printer(C99CodePrinter):
    """C99 with our functions, literals that read back, and small powers without pow()."""

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__({"strict": False})
        self._names = names

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    def _print_Float(self, expr: sympy.Float) -> str:
        return literal(float(expr))

    def _print_NumberSymbol(self, expr: sympy.NumberSymbol) -> str:
        return literal(float(expr))

    _print_Pi = _print_NumberSymbol
    _print_Exp1 = _print_NumberSymbol

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.exp in _POWERS:
            return f"{_POWERS[int(expr.exp)]}({self._print(expr.base)})"
        return super()._print_Pow(expr)

    def _print_sgn(self, expr: sympy.Expr) -> str:
        return f"sgn({self._print(expr.args[0])})"

    def _print_absolute(self, expr: sympy.Expr) -> str:
        return f"fabs({self._print(expr.args[0])})"


def law_functions(form: LawForm, name: str) -> str:
    """Return the two C functions of a form, called `{name}_relaxations` and `{name}_torque`.

    Raises
    ------
    ExportError
        If an expression has a function that C does not have.
    """
    inner: dict[sympy.Symbol, tuple[str, str]] = {
        c.symbol: (f"k_{c.name}", f"k[{i}]") for i, c in enumerate(form.coefficients)
    }
    inner |= {symbol: (symbol.name, f"u[{i}]") for i, symbol in enumerate(INPUTS)}
    outer = dict(inner)
    for i, relaxation in enumerate(form.relaxations):
        outer[relaxation.state] = (f"x_{relaxation.name}", f"x[{i}]")
        outer[relaxation.derivative] = (f"d_{relaxation.name}", f"dx[{i}]")
    targets = {
        f"{kind}[{i}]": expression
        for i, r in enumerate(form.relaxations)
        for kind, expression in (("drive", r.drive), ("rate", r.rate))
    }
    return "\n".join(
        [
            f"static void {name}_relaxations(const double *k, const double *u, double *drive, "
            "double *rate)",
            *_body(targets, inner, ("k", "u", "drive", "rate")),
            "",
            f"static double {name}_torque(const double *k, const double *u, const double *x, "
            "const double *dx)",
            *_body({"return": form.output}, outer, ("k", "u", "x", "dx")),
            "",
        ]
    )


def _body(
    targets: Mapping[str, sympy.Expr],
    arguments: Mapping[sympy.Symbol, tuple[str, str]],
    pointers: Sequence[str],
) -> list[str]:
    """Lines of a function body that computes `targets` with common subexpressions shared."""
    shared, results = sympy.cse(
        list(targets.values()), symbols=sympy.numbered_symbols("t"), order="none"
    )
    printer = _Printer({symbol: name for symbol, (name, _) in arguments.items()})
    used = set().union(*(e.free_symbols for e in (*results, *(e for _, e in shared))))
    reads = [f"const double {name} = {place};" for symbol, (name, place) in arguments.items()
             if symbol in used]  # fmt: skip
    lines = [f"const double {symbol.name} = {_c(printer, e)};" for symbol, e in shared]
    lines += [
        f"return {_c(printer, e)};" if target == "return" else f"{target} = {_c(printer, e)};"
        for target, e in zip(targets, results, strict=True)
    ]
    touched = " ".join([*reads, *targets])
    unused = [p for p in pointers if f" {p}[" not in f" {touched}"]
    silence = [f"{', '.join(f'(void){p}' for p in unused)};"] if unused else []
    return ["{", *(f"    {line}" for line in (*silence, *reads, *lines)), "}"]


def _c(printer: _Printer, expression: sympy.Expr) -> str:
    text = str(printer.doprint(expression))
    if "Not supported" in text:
        raise ExportError(f"friction law: '{expression}' has no counterpart in C.")
    return text
