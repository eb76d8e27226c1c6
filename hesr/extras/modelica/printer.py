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
    signs = {}
    held_signs = {}  # what the signs replace
    for i, bend in enumerate(bends, start=1):
        label = str(i)
        if bend.is_Symbol:
            label = bend.name
        sign = sympy.Dummy(f"sign_{label}", real=True)
        signs[bend] = sign
        held_signs[sgn(bend)] = sign
        held_signs[absolute(bend)] = sign * bend
    printer = _Printer({element.derivative: f"der({element.name})" for element in form.memory})

    def print_text(expression: sympy.Expr, level: int = 0) -> str:
        return printer.text(expression.xreplace(held_signs), level, of=expression)

    lines = []
    for element in form.memory:
        if isinstance(element, Relaxation):
            drive = print_text(element.drive)
            rate = print_text(element.rate, PRECEDENCE["Mul"])
            derivative = f"{drive} - {rate}*{element.name}"
        else:
            derivative = print_text(element.express_derivative())
        lines.append(f"der({element.name}) = {derivative}")
    lines.append(f"tau = {print_text(form.output.subs(DT, 0))}")
    sign_equations = {}
    for bend, sign in signs.items():
        text = print_text(bend)
        sign_equations[sign.name] = f"if {text} > 0 then 1 elseif {text} < 0 then -1 else 0"
    beginning = []
    for name, expression in _find_initial_equations(form).items():
        # No sign is held before the first event.
        beginning.append((name, _wrap_line(printer.text(expression, of=expression))))
    return Equations(
        signs=sign_equations,
        lines=tuple(_wrap_line(line) for line in lines),
        beginning=tuple(beginning),
    )


def _find_initial_equations(form: LawForm) -> dict[str, sympy.Expr]:
    if any(element.seeks for element in form.memory):
        return {}
    initial_expressions = initial_state(form.memory, form.component.settling)
    symbols = {}  # start values for states, and states for their settled values
    for element in form.memory:
        symbols[element.state] = sympy.Symbol(name_start_value(element.name), real=True)
        symbols[initial_symbol(element)] = element.state
    return {
        element.name: initial_expressions[initial_symbol(element)].xreplace(symbols)
        for element in form.memory
    }


def name_start_value(state: str) -> str:
    """Return the name of a state's start value."""
    return f"{state}_start"


def _wrap_line(line: str) -> str:
    return fill(
        line, _LINE_WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
