"""Equations of a law as MathML, typeset by the browser.

Terms of a sum are separate `math` elements, so that a narrow page can break lines between them.
"""

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

import sympy
from sympy.printing.mathml import MathMLPresentationPrinter

from hesr_model.equations.memory import Stop
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw, LawForm

MAX_TERMS = 12  # longer sums, such as those of networks, show their first terms and the last one

_DIGITS = 4

_LETTERS = ("alpha", "beta", "gamma", "delta", "kappa", "lambda", "mu", "sigma", "tau", "theta")
_GREEK = dict(zip(_LETTERS, "αβγδκλμστθ", strict=True))
_DERIVATIVES = {"dq": "q", "dh": "h", "dz": "z"}
_TIMES = '<mo lspace="0" rspace="0.17em">&#8290;</mo>'
"""Invisible multiplication with some space, because names may have several letters."""
_EQUALS, _PLUS, _MINUS = (f'<mo form="infix">{sign}</mo>' for sign in "=+−")
_FIRST_MINUS = "<mo>−</mo>"
_EXP = sympy.Function("exp")
_FUNCTIONS = {"positive": "max", "larger": "max", "cardinal_sine": "sinc"}
"""Displayed names of HESR's own functions, if they differ."""
_REPLACEMENTS = {
    "<mo>&InvisibleTimes;</mo>": _TIMES,
    "<mo>-</mo>": "<mo>−</mo>",
    "<mn>-": "<mo>−</mo><mn>",
}


def equations(law: FrictionLaw, *, numbers: bool = False) -> list[str]:
    """Return the equations of a law as MathML, on request with values of four digits for names."""
    values: Mapping[str, float] = {}
    if numbers:
        values = law.values
    printer = _Printer(law.form, values)
    lines = [[f"{_name('tau')}{_EQUALS}", *printer.terms(law.form.output)]]
    for element in law.form.memory:
        state = _name(element.name)
        rate = printer.text(element.parts[1])
        if isinstance(element, Stop):
            lines.append([f"{_add_dot(state)}{_EQUALS}", *printer.terms(element.parts[0])])
            lines.append([f"<mo>|</mo>{state}<mo>|</mo><mo>≤</mo>{rate}"])
            continue
        if isinstance(element.rate, sympy.Add):
            rate = f"<mrow><mo>(</mo>{rate}<mo>)</mo></mrow>"
        terms = (*printer.terms(element.drive), f"{_MINUS}{rate}{_TIMES}{state}")
        lines.append([f"{_add_dot(state)}{_EQUALS}", *terms])
    return list(map(_join_parts, lines))


def _join_parts(parts: Iterable[str]) -> str:
    """Return the parts of an equation as elements between which a line may break."""
    return " ".join(f'<math displaystyle="true">{part}</math>' for part in parts)


def symbol(name: str) -> str:
    """Return the name of a coefficient as MathML."""
    return f"<math>{_name(name)}</math>"


class _Printer(MathMLPresentationPrinter):  # type: ignore[misc] # SymPy is not typed
    """Printer whose symbols sort in the usual order: coefficients, states, inputs."""

    def __init__(self, form: LawForm, values: Mapping[str, float]) -> None:
        super().__init__()
        self._values = {
            quantity.symbol: sympy.Float(f"{values[quantity.name]:.{_DIGITS}g}")
            for quantity in form.coefficients
            if quantity.name in values
        }
        markup = {quantity.symbol: _name(quantity.name) for quantity in form.coefficients}
        for element in form.memory:
            markup |= {
                element.derivative: _add_dot(_name(element.name)),
                element.state: _name(element.name),
            }
        markup |= {Q: _name("q"), DQ: _name("dq"), TAU_LOAD: _name("tau_load")}
        self._replaced = {old: sympy.Symbol(f"{i:04d}", real=True) for i, old in enumerate(markup)}
        self._written = dict(zip(self._replaced.values(), markup.values(), strict=True))

    def terms(self, expression: sympy.Expr) -> list[str]:
        """Return the terms of a sum with their signs; a leading plus is omitted."""
        readable = self._readable(expression)
        terms = [readable]
        if isinstance(readable, sympy.Add):
            terms = self._as_ordered_terms(readable)
        parts: list[str] = []
        for term in terms:
            is_first = not parts
            if term.could_extract_minus_sign():
                sign = _FIRST_MINUS if is_first else _MINUS
                parts.append(sign + self._text(-term))
            else:
                sign = "" if is_first else _PLUS
                parts.append(sign + self._text(term))
        if len(parts) > MAX_TERMS:
            parts = [*parts[: MAX_TERMS // 2], f"{_PLUS}<mo>⋯</mo>", parts[-1]]
        return parts

    def text(self, expression: sympy.Expr) -> str:
        return self._text(self._readable(expression))

    def _readable(self, expression: sympy.Expr) -> sympy.Expr:
        return expression.xreplace(self._values).xreplace(self._replaced).replace(sympy.exp, _EXP)

    def _text(self, expression: sympy.Expr) -> str:
        markup: str = self._print(expression).toxml()
        # The printer keeps symbols as placeholders without XML escapes.
        for stand_in, text in self._written.items():
            markup = markup.replace(f"<mi>{stand_in.name}</mi>", text)
        for original, replacement in _REPLACEMENTS.items():
            markup = markup.replace(original, replacement)
        return markup

    def _print_Symbol(self, sym: sympy.Symbol, style: str = "plain") -> Any:
        del style
        return self._element("mi", sym.name)

    def _print_Float(self, expr: sympy.Float) -> Any:
        # SymPy's products have more digits than their factors.
        digits = 12
        if self._values:
            digits = _DIGITS
        text = f"{float(expr):.{digits}g}"
        if "e" not in text:
            return self._element("mn", text)
        mantissa, exponent = text.split("e")
        power = self.dom.createElement("msup")
        power.appendChild(self._element("mn", "10"))
        power.appendChild(self._element("mn", str(int(exponent)).replace("-", "−")))
        if mantissa == "1":
            return power
        return self._row(self._element("mn", mantissa), self._element("mo", "×"), power)

    def _print_positive(self, expr: sympy.Expr) -> Any:
        return self._write_application(expr, sympy.Integer(0))

    def _print_absolute(self, expr: sympy.Expr) -> Any:
        left_bar = self._element("mo", "|")
        right_bar = self._element("mo", "|")
        return self._row(left_bar, self._print(expr.args[0]), right_bar)

    def _write_application(self, expr: sympy.Expr, *extra_arguments: sympy.Expr) -> Any:
        name = expr.func.__name__
        inner = []
        for argument in (*expr.args, *extra_arguments):
            inner += [self._element("mo", ","), self._print(argument)]
        brackets = (self._element("mo", "("), *inner[1:], self._element("mo", ")"))
        return self._row(self._element("mi", _FUNCTIONS.get(name, name)), self._row(*brackets))

    _print_sgn = _print_larger = _print_cardinal_sine = _print_clip = _write_application

    def _row(self, *children: Any) -> Any:
        row = self.dom.createElement("mrow")
        for child in children:
            row.appendChild(child)
        return row

    def _element(self, tag: str, text: str) -> Any:
        element = self.dom.createElement(tag)
        element.appendChild(self.dom.createTextNode(text))
        return element


def _name(name: str) -> str:
    """Return a name with Greek letters and subscripts: `theta1_dq` is theta, index 1 and dq/dt."""
    first, *parts = name.split("_")
    letters = first.rstrip("0123456789")
    subscripts = [_part(part) for part in (first[len(letters) :], *parts) if part]
    if not subscripts:
        return _part(letters)
    return f"<msub>{_part(letters)}<mrow>{'<mo>,</mo>'.join(subscripts)}</mrow></msub>"


def _part(text: str) -> str:
    if text in _DERIVATIVES:
        return _add_dot(_part(_DERIVATIVES[text]))
    tag = "mn" if text.isdigit() else "mi"
    return f"<{tag}>{_GREEK.get(text, escape(text))}</{tag}>"


def _add_dot(written: str) -> str:
    return f'<mover>{written}<mo class="dot">˙</mo></mover>'
