"""Fitted laws for reading: SymPy expressions, LaTeX and tables of coefficients."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import sympy

from hesr_model.equations.memory import DT, Element, Relaxation
from hesr_model.support import frames

_LATEX_NAMES = {
    "dq": r"\dot{q}",
    "dt": r"\Delta t",
    "tau_load": r"\tau_\mathrm{load}",
    "tau": r"\tau",
}
INTERVAL = 1.96  # standard errors on each side of a 95 % interval


@dataclass(frozen=True, kw_only=True)
class LawExpressions:
    """Expressions of a law with named symbols.

    Attributes
    ----------
    torque : friction torque of inputs, states and coefficients.
    derivatives : x' of each state x of the memory.
    values : fitted value of each coefficient.
    units : unit of each symbol.
    """

    torque: sympy.Expr
    derivatives: Mapping[sympy.Symbol, sympy.Expr] = field(default_factory=dict)
    values: Mapping[sympy.Symbol, float] = field(default_factory=dict)
    units: Mapping[sympy.Symbol, str] = field(default_factory=dict)

    @property
    def numeric(self) -> sympy.Expr:
        """The torque with numbers for coefficients."""
        return self.torque.subs(dict(self.values))

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {sympy.latex(self.torque, symbol_names=_name(self.torque))}$"


def format_latex(
    torque: sympy.Expr, memory: Sequence[Element], numbers: Mapping[sympy.Symbol, sympy.Expr]
) -> str:
    """Return torque, derivatives x' and moved stops x+ as an `aligned` environment."""

    def convert(expression: sympy.Expr) -> str:
        shown = expression.xreplace(dict(numbers))
        names = _name(shown)
        for element in memory:
            names[element.derivative] = rf"\dot{{{sympy.latex(element.state)}}}"
        return str(sympy.latex(shown, symbol_names=names))

    lines = [rf"\tau &= {convert(torque)}"]
    for element in memory:
        state = convert(element.state)
        first, second = (convert(part) for part in element.parts)
        if isinstance(element, Relaxation):
            lines.append(rf"\dot{{{state}}} &= {first} - \left({second}\right) {state}")
        else:
            step = rf"{state} + \left({first}\right) {_LATEX_NAMES[str(DT)]}"
            lines.append(
                rf"{state}^{{+}} &= \operatorname{{clip}}\left({step}, \pm {second}\right)"
            )
    rows = " \\\\\n".join(lines)
    return f"\\begin{{aligned}}\n{rows}\n\\end{{aligned}}"


def _name(expression: sympy.Expr) -> dict[sympy.Symbol, str]:
    """Return the LaTeX of symbols that have a usual sign."""
    symbols = expression.free_symbols
    return {symbol: _LATEX_NAMES[str(symbol)] for symbol in symbols if str(symbol) in _LATEX_NAMES}


@dataclass(frozen=True, kw_only=True)
class CoefficientRow:
    """Coefficient of a joint's law.

    Attributes
    ----------
    value, unit : in SI.
    standard_error, lower, upper : with the 95 % interval; None if unknown.
    at_bound : True if the search ended at a bound, on which all intervals are conditional.
    """

    joint: str
    name: str
    value: float
    unit: str
    standard_error: float | None
    lower: float | None
    upper: float | None
    at_bound: bool
    description: str


@dataclass(frozen=True, kw_only=True)
class CoefficientTable:
    """Coefficients of all joints, and the origin of the fit (files with hashes, seed, versions)."""

    law: str
    rows: tuple[CoefficientRow, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[CoefficientRow]:
        return iter(self.rows)

    def __getitem__(self, k: int) -> CoefficientRow:
        return self.rows[k]

    def __str__(self) -> str:
        lines = []
        for row in self.rows:
            interval = "" if row.standard_error is None else f" +- {row.standard_error:.2g}"
            mark = "  (at a bound)" if row.at_bound else ""
            lines.append(f"{row.joint}  {row.name} = {row.value:.5g}{interval} {row.unit}{mark}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        head = ("joint", "name", "value", "unit", "standard error", "95 % interval", "at a bound")
        rows = []
        for row in self.rows:
            interval = ""
            if row.lower is not None:
                interval = f"{row.lower:.4g} to {row.upper:.4g}"
            error = "" if row.standard_error is None else row.standard_error
            bound = "yes" if row.at_bound else ""
            rows.append((row.joint, row.name, row.value, row.unit, error, interval, bound))
        return frames.html_table(f"Coefficients of the law '{self.law}'", head, rows)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame`, one row per coefficient; ConfigError without pandas."""
        records = [asdict(row) for row in self.rows]
        columns = {}
        for name in records[0]:
            columns[name] = [record[name] for record in records]
        return frames.pandas_frame(columns)
