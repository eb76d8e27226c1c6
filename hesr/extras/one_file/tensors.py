"""Tensor export for PyTorch or JAX; the module `xp` has the functions of the same name in both."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from math import frexp, ldexp
from pathlib import Path
from typing import Any, Literal

import sympy

from fmu_src.equations.printer import LanguagePrinter
from fmu_src.friction.validity import discretisation_of, require_exportable
from fmu_src.pages.friction_page import model_title
from fmu_src.pages.html import code_templates
from hesr.extras.one_file.c_header import TEMPLATES, write_beside
from hesr_model.equations.memory import DT, EULER
from hesr_model.equations.program import (
    Assignments,
    initial_state,
    initial_symbol,
    moved,
    sampled,
    straight_line,
)
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import INPUTS, Q
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel

Library = Literal["torch", "jax"]

_TITLES: Mapping[Library, str] = {"torch": "PyTorch", "jax": "JAX"}
_SHARED = ("exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt")
_ARCS = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}
_OWN = ("positive", "larger", "clip", "exceeds", "over")

_HIGH_BITS = 12
"""High bits of a factor on the position, half of single precision, so that products are exact."""
_DIGITS = 40


class _turned(sympy.Function):  # type: ignore[misc] # noqa: N801 - SymPy is not typed
    """factor * position minus whole turns, without loss of precision."""

    nargs = 2


class _Printer(LanguagePrinter):
    language = "tensor code"
    one = "1.0"
    power = "**"

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__(names)
        self.known_functions = {name: f"xp.{name}" for name in _SHARED}
        self.known_functions |= {name: f"xp.{other}" for name, other in _ARCS.items()}
        self.known_functions |= {name: f"_{name}" for name in _OWN}
        self.known_functions |= {"sgn": "xp.sign", "absolute": "xp.abs", "Abs": "xp.abs"}

    def _print_Pow(self, expr: sympy.Pow) -> str:
        return self._print_Float(expr) if expr.is_number else super()._print_Pow(expr)

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
        turns = (sympy.Rational(float(factor)) / (2 * sympy.pi)).evalf(_DIGITS)
        mantissa, exponent = frexp(float(turns))
        high = ldexp(round(ldexp(mantissa, _HIGH_BITS)), exponent - _HIGH_BITS)
        return f"_wrapped({self._print(position)}, {high!r}, {float(turns - high)!r})"


def _function(
    form: LawForm,
    name: str,
    program: Assignments,
    more: Sequence[sympy.Symbol],
    read: Sequence[sympy.Symbol],
    ends: Sequence[sympy.Symbol],
) -> str:
    """Return the text of `name(c, dq, q, tau_load, *more, x_0, ..)`: outputs and ends of states."""
    program = {symbol: _wrapped(e) for symbol, e in program.items()}
    lines, names = straight_line(program, (*read, *ends))
    states = [f"x_{i}" for i, _ in enumerate(form.memory)]
    known = {quantity.symbol: f'c["{quantity.name}"]' for quantity in form.coefficients}
    known |= {element.state: x for element, x in zip(form.memory, states, strict=True)}
    known |= {symbol: symbol.name for symbol in (*INPUTS, DT, EULER)}
    printer = _Printer(known | names)
    body = [f"{names.get(symbol, str(symbol))} = {printer.text(e)}" for symbol, e in lines.items()]
    ended = "".join(f"{names[symbol]}, " for symbol in ends)
    arguments = ", ".join(("c", *(symbol.name for symbol in (*INPUTS, *more)), *states))
    first = "".join(f"{names[symbol]}, " for symbol in read)
    result = f"return {first}({ended.rstrip(' ')})"
    return "\n".join([f"def {name}({arguments}):", *(f"    {line}" for line in (*body, result))])


def _wrapped(expression: sympy.Expr) -> sympy.Expr:
    def wave(node: sympy.Expr) -> sympy.Expr:
        angle = sympy.expand(node.args[0])
        factor = angle.coeff(Q, 1)
        rest = sympy.expand(angle - factor * Q)
        if not factor.is_number or factor == 0 or Q in rest.free_symbols:
            return node
        return node.func(_turned(sympy.Float(factor), Q) + rest)

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
    return write_beside(path, tensor_code(model, library), model)


def tensor_code(model: FrictionModel, library: Library) -> str:
    """Return the text of a Python file that needs only PyTorch or JAX.

    It steps batches of robots with their hidden states, all joints of one form together.
    """
    require_exportable(model, "a file of tensors")
    discretisation = discretisation_of(model)
    groups: dict[LawForm, list[int]] = {}
    for i, law in enumerate(model.laws):
        groups.setdefault(law.form, []).append(i)
    laws = [
        _law(f"_law_{n}", form, joints, [model.laws[i] for i in joints])
        for n, (form, joints) in enumerate(groups.items(), start=1)
    ]
    template = code_templates(TEMPLATES).get_template(f"law_{library}.py.j2")
    title = f"Friction of {model.robot} by {model_title(model)}"
    rendered: str = template.render(
        title=title.replace("\\", "/").replace('"', "'"),
        library=_TITLES[library],
        version=version("hesr"),
        joints=tuple(model.joints),
        slides=any(model.slides),
        sample_time=model.sample_time,
        euler=discretisation == "euler",
        laws=laws,
    )
    return rendered


def _law(name: str, form: LawForm, joints: list[int], laws: list[FrictionLaw]) -> dict[str, Any]:
    torque = form.component.outputs[0].symbol
    ends = [moved(element) for element in form.memory]
    start = initial_state(form.memory, form.component.settling)
    first = [initial_symbol(element) for element in form.memory]
    return {
        "name": name,
        "function": _function(form, name, sampled(form.component), (DT,), (torque,), ends),
        "begin": _function(form, f"{name}_begin", start, (), (), first),
        "joints": tuple(joints),
        "values": {
            quantity.name: tuple(law.values[quantity.name] for law in laws)
            for quantity in form.coefficients
        },
        "units": {quantity.name: quantity.unit for quantity in form.coefficients},
        "starts": {
            element.name: tuple(law.start[i] for law in laws)
            for i, element in enumerate(form.memory)
        },
    }
