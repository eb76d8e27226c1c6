"""Tensor export for PyTorch or JAX; the module `xp` has the functions of the same name in both."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from math import frexp, ldexp
from pathlib import Path
from typing import Any, Literal

import sympy

from fmu_src.equations.printer import LanguagePrinter
from fmu_src.friction.validity import find_discretisation, require_exportable
from fmu_src.pages.friction_page import model_title
from fmu_src.pages.html import code_templates
from hesr.extras.one_file.c_header import TEMPLATES, write_code_and_data
from hesr_model.equations.memory import DT, EULER
from hesr_model.equations.program import (
    Assignments,
    build_step,
    build_straight_line,
    initial_state,
    initial_symbol,
    moved_symbol,
)
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import INPUTS, Q
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel

Library = Literal["torch", "jax"]

_TITLES: Mapping[Library, str] = {"torch": "PyTorch", "jax": "JAX"}
_COMMON_FUNCTIONS = ("exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt")
_ARC_FUNCTIONS = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}
_HELPER_FUNCTIONS = ("positive", "larger", "clip", "exceeds", "over")

_HIGH_BITS = 12
"""High bits of a factor on the position, half of single precision, so that products are exact."""
_TURN_DIGITS = 40


class _turned(sympy.Function):  # type: ignore[misc] # noqa: N801 - SymPy is not typed
    """factor * position minus whole turns, without loss of precision."""

    nargs = 2


class _Printer(LanguagePrinter):
    language = "tensor code"
    one = "1.0"
    power = "**"

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__(names)
        self.known_functions = {name: f"xp.{name}" for name in _COMMON_FUNCTIONS}
        self.known_functions |= {name: f"xp.{other}" for name, other in _ARC_FUNCTIONS.items()}
        self.known_functions |= {name: f"_{name}" for name in _HELPER_FUNCTIONS}
        self.known_functions |= {"sgn": "xp.sign", "absolute": "xp.abs", "Abs": "xp.abs"}

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.is_number:
            return self._print_Float(expr)
        return super()._print_Pow(expr)

    def _print_Function(self, expr: sympy.Function) -> str:
        if expr.is_number:
            return self._print_Float(expr)
        name = expr.func.__name__
        if name not in self.known_functions:
            raise ExportError(f"friction law: '{expr}' has no counterpart in tensor code.")
        arguments = ", ".join(map(self._print, expr.args))
        return f"{self.known_functions[name]}({arguments})"

    _print_exp = _print_Function
    _print_Abs = _print_Function

    def _print_decay(self, expr: sympy.Function) -> str:
        return f"_decay({self._print(expr.args[0])})"

    def _print_cardinal_sine(self, expr: sympy.Function) -> str:
        """Print sin(x) / x by the libraries' sinc(u), which is sin(pi u) / (pi u)."""
        return f"xp.sinc({self._print(expr.args[0] / sympy.pi)})"

    def _print_share(self, expr: sympy.Function) -> str:
        z, e, _ = map(self._print, expr.args)
        return f"_share({z}, {e})"

    def _print__turned(self, expr: sympy.Function) -> str:
        factor, position = expr.args
        # Use more digits than those of a double, because whole turns are dropped.
        turns = (sympy.Rational(float(factor)) / (2 * sympy.pi)).evalf(_TURN_DIGITS)
        mantissa, exponent = frexp(float(turns))
        high_part = ldexp(round(ldexp(mantissa, _HIGH_BITS)), exponent - _HIGH_BITS)
        return f"_wrapped({self._print(position)}, {high_part!r}, {float(turns - high_part)!r})"


def _write_function(
    form: LawForm,
    name: str,
    program: Assignments,
    extra_symbols: Sequence[sympy.Symbol],
    output_symbols: Sequence[sympy.Symbol],
    end_symbols: Sequence[sympy.Symbol],
) -> str:
    """Return the text of `name(c, dq, q, tau_load, *more, x_0, ..)`: outputs and ends of states."""
    program = {symbol: _wrap_angles(expression) for symbol, expression in program.items()}
    lines, names = build_straight_line(program, (*output_symbols, *end_symbols))
    printed_names = {}
    for coefficient in form.coefficients:
        printed_names[coefficient.symbol] = f'c["{coefficient.name}"]'
    states = []
    for i, element in enumerate(form.memory):
        states.append(f"x_{i}")
        printed_names[element.state] = states[i]
    for symbol in (*INPUTS, DT, EULER):
        printed_names[symbol] = symbol.name
    printer = _Printer(printed_names | names)

    inputs = [symbol.name for symbol in (*INPUTS, *extra_symbols)]
    text = [f"def {name}({', '.join(['c', *inputs, *states])}):"]
    for symbol, expression in lines.items():
        text.append(f"    {names.get(symbol, str(symbol))} = {printer.text(expression)}")
    # Each name has its comma: a tuple of one end needs it.
    outputs = "".join(f"{names[symbol]}, " for symbol in output_symbols)
    ends = "".join(f"{names[symbol]}, " for symbol in end_symbols)
    text.append(f"    return {outputs}({ends.rstrip(' ')})")
    return "\n".join(text)


def _wrap_angles(expression: sympy.Expr) -> sympy.Expr:
    """Replace the multiple of the position in each sine and cosine by its part of a turn."""

    def wave(node: sympy.Expr) -> sympy.Expr:
        angle = sympy.expand(node.args[0])
        factor = angle.coeff(Q, 1)
        remainder = sympy.expand(angle - factor * Q)
        if not factor.is_number or factor == 0 or Q in remainder.free_symbols:
            return node
        return node.func(_turned(sympy.Float(factor), Q) + remainder)

    return expression.replace(lambda node: isinstance(node, sympy.cos | sympy.sin), wave)


def export_torch(model: FrictionModel, path: Path) -> Path:
    """Write `tensor_code` for PyTorch, and its test data next to it."""
    return _export(model, path, "torch")


def export_jax(model: FrictionModel, path: Path) -> Path:
    """Write `tensor_code` for JAX, and its test data next to it."""
    return _export(model, path, "jax")


def _export(model: FrictionModel, path: Path, library: Library) -> Path:
    if path.suffix != ".py":
        raise ExportError(f"{path}: a file for {_TITLES[library]} ends in .py.")
    return write_code_and_data(path, tensor_code(model, library), model)


def tensor_code(model: FrictionModel, library: Library) -> str:
    """Return the text of a Python file that needs only PyTorch or JAX.

    It steps batches of robots with their hidden states, all joints of one form together.
    """
    require_exportable(model, "a file of tensors")
    discretisation = find_discretisation(model)
    groups: dict[LawForm, dict[int, FrictionLaw]] = {}
    for j, law in enumerate(model.laws):
        groups.setdefault(law.form, {})[j] = law
    laws = []
    for number, (form, laws_by_joint) in enumerate(groups.items(), start=1):
        laws.append(_describe_law(f"_law_{number}", form, laws_by_joint))
    template = code_templates(TEMPLATES).get_template(f"law_{library}.py.j2")
    title = f"Friction of {model.robot} by {model_title(model)}"
    module_text: str = template.render(
        title=title.replace("\\", "/").replace('"', "'"),
        library=_TITLES[library],
        version=version("hesr"),
        joints=tuple(model.joints),
        slides=any(model.slides),
        sample_time=model.sample_time,
        euler=discretisation == "euler",
        laws=laws,
    )
    return module_text


def _describe_law(
    name: str, form: LawForm, laws_by_joint: Mapping[int, FrictionLaw]
) -> dict[str, Any]:
    """Return the functions and numbers of the joints with a common form, for the template."""
    laws = laws_by_joint.values()
    torque = form.component.outputs[0].symbol
    end_symbols = [moved_symbol(element) for element in form.memory]
    initial_states = initial_state(form.memory, form.component.settling)
    initial_symbols = [initial_symbol(element) for element in form.memory]
    units = {}
    values = {}
    for coefficient in form.coefficients:
        units[coefficient.name] = coefficient.unit
        values[coefficient.name] = tuple(law.values[coefficient.name] for law in laws)
    starts = {}
    for i, element in enumerate(form.memory):
        starts[element.name] = tuple(law.start[i] for law in laws)
    return {
        "name": name,
        "function": _write_function(
            form, name, build_step(form.component), (DT,), (torque,), end_symbols
        ),
        "begin": _write_function(form, f"{name}_begin", initial_states, (), (), initial_symbols),
        "joints": tuple(laws_by_joint),
        "values": values,
        "units": units,
        "starts": starts,
    }
