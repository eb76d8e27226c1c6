"""SymPy to Modelica: the equations of a friction law.

`sign` and `abs` of Modelica trigger no events (noEvent), but a solver must stop where a law jumps
or bends. So the signs of inputs are variables, held between events.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from textwrap import fill

import sympy
from sympy.printing.precedence import PRECEDENCE

from fmu_src.equations.printer import LanguagePrinter
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import DT, Relaxation
from hesr_model.equations.program import Jumps, initial_state, initial_symbol
from hesr_model.friction.law import LawForm

_FUNCTION_NAMES = "abs acos asin atan atan2 cos cosh der exp log sign sin sinh sqrt tan tanh"
FUNCTIONS = tuple(_FUNCTION_NAMES.split())  # functions and operators of Modelica in use
_LINE_WIDTH = 96


class _Printer(LanguagePrinter):
    language = "Modelica"
    one = "1"
    power = "^"

    def __init__(self, derivatives: Mapping[sympy.Symbol, str]) -> None:
        super().__init__(derivatives)
        self.known_functions = {name: name for name in FUNCTIONS}
        self.known_functions |= {"sgn": "sign", "absolute": "abs"}

    # Magnitudes trigger no event in any tool.
    def _print_positive(self, expr: sympy.Expr) -> str:
        x = expr.args[0]
        return self._print_half(x + absolute(x))

    def _print_larger(self, expr: sympy.Expr) -> str:
        a, b = expr.args
        return self._print_half(a + b + absolute(a - b))

    def _print_clip(self, expr: sympy.Expr) -> str:
        x, b = expr.args
        return self._print_half(absolute(x + b) - absolute(x - b))

    def _print_half(self, expr: sympy.Expr) -> str:
        return f"(({self._print(expr)})/2)"  # an atom in any context

    def _print_over(self, expr: sympy.Expr) -> str:
        above, below, otherwise = expr.args
        first = self._print(above / below)
        second = self._print(otherwise)
        return f"(if {self._print(below)} > 0 then {first} else {second})"


@dataclass(frozen=True, kw_only=True)
class Equations:
    """A form in Modelica: signs of inputs held between events, equations and initial states."""

    signs: Mapping[str, str]
    lines: tuple[str, ...]
    beginning: tuple[tuple[str, str], ...]  # empty if a rate depends on its state: no closed form


def print_equations(form: LawForm) -> Equations:
    """Return `der(x) = drive - rate*x` of each state, and `tau`."""
    bends = Jumps(form.component, all_magnitudes=True).expressions
    signs = [
        sympy.Dummy(f"sign_{bend.name if bend.is_Symbol else i}", real=True)
        for i, bend in enumerate(bends, start=1)
    ]
    sign_symbols = {sgn(bend): sign for bend, sign in zip(bends, signs, strict=True)}
    sign_symbols |= {absolute(bend): sign * bend for bend, sign in zip(bends, signs, strict=True)}
    printer = _Printer({element.derivative: f"der({element.name})" for element in form.memory})

    def print_text(expression: sympy.Expr, level: int = 0, *, is_initial: bool = False) -> str:
        # No sign is held before the first event.
        substituted = expression if is_initial else expression.xreplace(sign_symbols)
        return printer.text(substituted, level, of=expression)

    lines = [
        f"der({element.name}) = {print_text(element.drive)} - "
        f"{print_text(element.rate, PRECEDENCE['Mul'])}*{element.name}"
        if isinstance(element, Relaxation)
        else f"der({element.name}) = {print_text(element.express_derivative())}"
        for element in form.memory
    ]
    return Equations(
        signs={
            sign.name: f"if {text} > 0 then 1 elseif {text} < 0 then -1 else 0"
            for sign, text in zip(signs, map(print_text, bends), strict=True)
        },
        lines=tuple(
            _wrap_line(line) for line in (*lines, f"tau = {print_text(form.output.subs(DT, 0))}")
        ),
        beginning=tuple(
            (name, _wrap_line(print_text(expression, is_initial=True)))
            for name, expression in _find_initial_equations(form).items()
        ),
    )


def _find_initial_equations(form: LawForm) -> dict[str, sympy.Expr]:
    if any(element.seeks for element in form.memory):
        return {}
    initial_expressions = initial_state(form.memory, form.component.settling)
    names = {
        element.state: sympy.Symbol(name_start_value(element.name), real=True)
        for element in form.memory
    }
    names |= {initial_symbol(element): element.state for element in form.memory}
    return {
        element.name: initial_expressions[initial_symbol(element)].xreplace(names)
        for element in form.memory
    }


def name_start_value(state: str) -> str:
    """Return the name of a state's start value."""
    return f"{state}_start"


def _wrap_line(line: str) -> str:
    return fill(
        line, _LINE_WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
