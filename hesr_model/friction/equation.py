"""A law with its numbers, as people write it (Table I of the paper)."""

import sympy

from hesr_model.friction.law import FrictionLaw

_DIGITS = 4


def equations(law: FrictionLaw) -> list[str]:
    """Return the torque and the states of a law as lines of text, numbers to four digits.

    A state's derivative dh is written h'.
    """
    numbers = {c.symbol: _rounded(law.values[c.name]) for c in law.form.coefficients}
    names = {r.derivative: sympy.Symbol(f"{r.name}'") for r in law.form.relaxations}

    def written(expression: sympy.Expr) -> str:
        shown = expression.subs(numbers).subs(names)
        shown = shown.xreplace({n: sympy.Float(n, _DIGITS) for n in shown.atoms(sympy.Float)})
        return str(sympy.sstr(shown)).replace("absolute(", "abs(")

    lines = [f"tau = {written(law.form.output)}"]
    lines += [
        f"{r.name}' = {written(r.drive)} - ({written(r.rate)})*{r.name}"
        for r in law.form.relaxations
    ]
    return lines


def coefficient_lines(law: FrictionLaw) -> list[str]:
    """Return each coefficient with its unit and, where known, its 95 % interval."""
    lines = []
    for c in law.form.coefficients:
        error = law.standard_errors.get(c.name)
        interval = "" if error is None else f" +- {1.96 * error:.2g}"
        unit = "" if c.unit == "1" else f" {c.unit}"
        lines.append(f"{c.name} = {law.values[c.name]:.5g}{interval}{unit}")
    return lines


def _rounded(value: float) -> sympy.Float:
    return sympy.Float(f"{value:.{_DIGITS}g}", _DIGITS)
