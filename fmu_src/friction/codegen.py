"""SymPy to C99: the functions of friction laws.

Each distinct form becomes five functions,

    switches(k, u, z)                          arguments of the signs that are held between events
    relaxations(k, u, s, drive, rate)          drive b and rate r of every state
    torque(k, u, s, x, dx)                     the output map
    relaxations_tangent, torque_tangent        their derivatives along dk, du, (tx, tdx)

over its coefficients k, the inputs u = (dq, q, tau_load), the held signs s, the states x and their
derivatives dx. A solver inside an FMU, which wants values and derivatives of the same place, gets
three that share what both have in common,

    switches(k, u, z)
    relaxations(k, u, s, du, drive, rate, d_drive, d_rate)
    torque(k, u, s, x, dx, du, tx, tdx, slope)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import sympy
from sympy.printing.c import C99CodePrinter

from fmu_src.interface import literal
from hesr_model.errors import ExportError
from hesr_model.friction.functions import INPUTS, absolute, sgn
from hesr_model.friction.law import LawForm

_POWERS = {2: "square", 3: "cube"}


class _Printer(C99CodePrinter):  # type: ignore[misc] # SymPy is not typed
    """C99 with our functions, literals that read back, and small powers without pow()."""

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__({"strict": False})
        self._names = names

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    _print_Dummy = _print_Symbol

    def _print_Float(self, expr: sympy.Float) -> str:
        return literal(float(expr))

    def _print_NumberSymbol(self, expr: sympy.NumberSymbol) -> str:
        return literal(float(expr))

    _print_Pi = _print_NumberSymbol
    _print_Exp1 = _print_NumberSymbol

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.exp in _POWERS:
            return f"{_POWERS[int(expr.exp)]}({self._print(expr.base)})"
        if -expr.exp in _POWERS:
            return f"(1.0/{_POWERS[int(-expr.exp)]}({self._print(expr.base)}))"
        return str(super()._print_Pow(expr))

    def _print_sgn(self, expr: sympy.Expr) -> str:
        return f"sgn({self._print(expr.args[0])})"

    def _print_absolute(self, expr: sympy.Expr) -> str:
        return f"fabs({self._print(expr.args[0])})"


@lru_cache(maxsize=256)
def switches(form: LawForm) -> tuple[sympy.Expr, ...]:
    """Return the expressions of inputs at whose zeros the law jumps or bends.

    Those inside `sgn` and `absolute`; signs of states alone stay as they are, since a solver does
    not integrate what only the output depends on.
    """
    known = {*INPUTS, *(c.symbol for c in form.coefficients)}
    parts = [form.output, *(e for r in form.relaxations for e in (r.drive, r.rate))]
    found = {node.args[0] for e in parts for node in e.atoms(sgn, absolute)}
    held = [e for e in found if e.free_symbols <= known and e.free_symbols & set(INPUTS)]
    return tuple(sorted(held, key=sympy.default_sort_key))


@dataclass(frozen=True)
class _Arguments:
    """The symbols that a C function reads, each with its name and its place there."""

    places: Mapping[sympy.Symbol, tuple[str, str]] = field(default_factory=dict)
    seeds: Mapping[sympy.Symbol, sympy.Symbol] = field(default_factory=dict)
    """For each symbol the symbol of its change along the direction of a tangent."""

    def plus(self, symbols: Iterable[sympy.Symbol], array: str, change: str) -> "_Arguments":
        """Add the elements of an array, and of the array of their changes if there is one."""
        places, seeds = dict(self.places), dict(self.seeds)
        for i, symbol in enumerate(symbols):
            places[symbol] = (f"{array}_{symbol.name}", f"{array}[{i}]")
            if change:
                seed = sympy.Dummy(f"{change}_{symbol.name}", real=True)
                places[seed] = (seed.name, f"{change}[{i}]")
                seeds[symbol] = seed
        return _Arguments(places, seeds)

    def tangent(self, expression: sympy.Expr) -> sympy.Expr:
        """Return the derivative of an expression along the direction of the seeds."""
        used = sorted(expression.free_symbols & set(self.seeds), key=sympy.default_sort_key)
        return sympy.Add(*(expression.diff(symbol) * self.seeds[symbol] for symbol in used))


@dataclass(frozen=True)
class _Lowered:
    """A form with held signs, and what its functions read."""

    bends: tuple[sympy.Expr, ...]
    moving: Mapping[str, sympy.Expr]
    """Drive and rate of every state, by where they are written."""
    torque: sympy.Expr
    inner: _Arguments
    """Coefficients and inputs."""
    smooth: _Arguments
    """These and the held signs."""
    outer: _Arguments
    """These, the states and their derivatives."""


def _lowered(form: LawForm, *, tunable: bool) -> _Lowered:
    """Return a form with held signs; `tunable` says whether tangents follow the coefficients."""
    bends = switches(form)
    signs = [sympy.Dummy(f"{i}", real=True) for i, _ in enumerate(bends, start=1)]
    held = {sgn(e): s for e, s in zip(bends, signs, strict=True)}
    held |= {absolute(e): s * e for e, s in zip(bends, signs, strict=True)}
    inner = _Arguments().plus((c.symbol for c in form.coefficients), "k", "dk" if tunable else "")
    inner = inner.plus(INPUTS, "u", "du")
    smooth = inner.plus(signs, "s", "")
    outer = smooth.plus((r.state for r in form.relaxations), "x", "tx")
    return _Lowered(
        bends=bends,
        moving={
            f"{kind}[{i}]": expression.xreplace(held)
            for i, r in enumerate(form.relaxations)
            for kind, expression in (("drive", r.drive), ("rate", r.rate))
        },
        torque=form.output.xreplace(held),
        inner=inner,
        smooth=smooth,
        outer=outer.plus((r.derivative for r in form.relaxations), "dx", "tdx"),
    )


_Function = tuple[str, str, _Arguments, Mapping[str, sympy.Expr], str, str]
"""What it returns and is called, its arguments, what it computes, what it reads and writes."""


def law_functions(form: LawForm, name: str, *, tunable: bool = True) -> str:
    """Return the C functions of a form, called `{name}_relaxations` and so on.

    Parameters
    ----------
    form : expressions of the law.
    name : prefix of the functions.
    tunable : whether the coefficients can change, so that tangents follow them.

    Raises
    ------
    ExportError
        If an expression has a function that C does not have.
    """
    own = _lowered(form, tunable=tunable)
    tangents = {place: own.smooth.tangent(e) for place, e in own.moving.items()}
    slope = {"return": own.outer.tangent(own.torque)}
    return _written(
        name,
        _switches(own),
        ("void", "relaxations", own.smooth, own.moving, "k u s", "drive rate"),
        ("double", "torque", own.outer, {"return": own.torque}, "k u s x dx", ""),
        ("void", "relaxations_tangent", own.smooth, tangents, "k u s dk du", "drive rate"),
        ("double", "torque_tangent", own.outer, slope, "k u s x dx dk du tx tdx", ""),
    )


def law_functions_with_slopes(form: LawForm, name: str) -> str:
    """Return C functions of a form that give values and derivatives at once, for a solver.

    Parameters and errors are those of `law_functions`; coefficients do not change here.
    """
    own = _lowered(form, tunable=False)
    slopes = {f"d_{place}": own.smooth.tangent(e) for place, e in own.moving.items()}
    both = {**own.moving, **slopes}
    torque = {"slope[0]": own.outer.tangent(own.torque), "return": own.torque}
    return _written(
        name,
        _switches(own),
        ("void", "relaxations", own.smooth, both, "k u s du", "drive rate d_drive d_rate"),
        ("double", "torque", own.outer, torque, "k u s x dx du tx tdx", "slope"),
    )


def _switches(own: _Lowered) -> _Function:
    targets = {f"z[{i}]": e for i, e in enumerate(own.bends)}
    return ("void", "switches", own.inner, targets, "k u", "z")


def _written(name: str, *functions: _Function) -> str:
    lines: list[str] = []
    for kind, function, arguments, targets, reads, writes in functions:
        pointers = [f"const double *{p}" for p in reads.split()]
        pointers += [f"double *{p}" for p in writes.split()]
        lines += [f"static {kind} {name}_{function}({', '.join(pointers)})"]
        lines += [*_body(targets, arguments.places, (*reads.split(), *writes.split())), ""]
    return "\n".join(lines)


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
