"""Laws as text, with or without numbers (as in Table I of the paper)."""

import sympy

from hesr_model.equations.memory import DT, Relaxation
from hesr_model.friction.law import FrictionLaw, LawForm

_DIGITS = 4


def equations(law: FrictionLaw) -> list[str]:
    """Return torque and states of a law as lines of text, numbers to four digits.

    A relaxation's derivative is written x', a stop after a step x+.
    """
    rounded = {name: sympy.Float(f"{x:.{_DIGITS}g}", _DIGITS) for name, x in law.values.items()}
    return form_lines(law.form, {c.symbol: rounded[c.name] for c in law.form.coefficients})


def form_lines(form: LawForm, numbers: dict[sympy.Symbol, sympy.Expr] | None = None) -> list[str]:
    """Return the lines of a form, coefficients without numbers by name."""
    names = {m.derivative: sympy.Symbol(f"{m.name}'") for m in form.memory}

    def written(expression: sympy.Expr) -> str:
        return text_of(expression.xreplace(numbers or {}).xreplace(names))

    lines = [f"tau = {written(form.output)}"]
    for element in form.memory:
        first, second = (written(part) for part in element.parts)
        if isinstance(element, Relaxation):
            lines.append(f"{element.name}' = {first} - ({second})*{element.name}")
        else:
            lines.append(f"{element.name}+ = clip({element.name} + ({first})*{DT}, {second})")
    return lines


def text_of(expression: sympy.Expr) -> str:
    """Return an expression as text, numbers to four digits."""
    shown = expression.xreplace({n: sympy.Float(n, _DIGITS) for n in expression.atoms(sympy.Float)})
    return str(sympy.sstr(shown)).replace("absolute(", "abs(")


def coefficient_lines(law: FrictionLaw) -> list[str]:
    """Return each coefficient with unit and, if known, 95 % interval."""
    lines = []
    for c in law.form.coefficients:
        error = law.standard_errors.get(c.name)
        interval = "" if error is None else f" +- {1.96 * error:.2g}"
        unit = "" if c.unit == "1" else f" {c.unit}"
        lines.append(f"{c.name} = {law.values[c.name]:.5g}{interval}{unit}")
    return lines
