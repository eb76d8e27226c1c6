"""documentation/index.html of blocks and discrete friction: equations and all variables."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.printing.str import StrPrinter

from fmu_src.export.description import Description
from fmu_src.export.interface import ArrayVariable, Interface, Role, Variable
from fmu_src.pages.html import render_template
from hesr_model.equations.component import Choice, Component

_INDICES = "ik"  # of joints, then of harmonics
_GROUPS: Mapping[str, tuple[Role, ...]] = {
    "Inputs": ("input",),
    "Outputs": ("output", "on_demand"),
    "Parameters": ("fixed", "tunable"),
    "States": ("state", "local"),
}
_CHANGES = {"fixed": "before the run", "tunable": "at any time"}


@dataclass(frozen=True, kw_only=True)
class LawEntry:
    """Friction law of a joint: its title, and its equations as MathML."""

    name: str
    title: str
    equations: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class BlockPage:
    """Text of a block's page: equations as lines of text, and sentences about its use."""

    equations: Sequence[str]
    notes: Sequence[str] = ()
    refusals: Sequence[str] = ()
    laws: Sequence[LawEntry] = ()


def block_html(page: BlockPage, interface: Interface, about: Description) -> str:
    """Return the page as one self-contained file."""
    return render_template(
        "block.html.j2",
        about=about,
        page=page,
        groups=variable_groups(interface),
        exchange=interface.model_exchange,
    )


def variable_groups(interface: Interface) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of the tables of all variables, by their title."""
    groups = {title: list(_rows(interface, roles)) for title, roles in _GROUPS.items()}
    return {title: rows for title, rows in groups.items() if rows}


def component_page(component: Component, notes: Sequence[str] = ()) -> BlockPage:
    """Return the page of a component of equations."""
    refusals = [f"{r.name} must {r.text}." for r in component.requirements]
    return BlockPage(equations=equation_lines(component), notes=notes, refusals=refusals)


def equation_lines(component: Component) -> list[str]:
    """Return the equations of one joint as text, then the values before the first sample."""
    printer = _Printer([quantity for quantity in component.shared if isinstance(quantity, Choice)])
    lines: list[str] = []
    for equation in component.equations:
        lines += printer.lines(equation.name, equation.expression)
    starts = component.starts.items()
    return lines + [f"{name} = {printer.doprint(start)} at the start" for name, start in starts]


class _Printer(StrPrinter):  # type: ignore[misc] # SymPy is not typed
    """Printer of expressions with choices by name and conditions as words."""

    def __init__(self, choices: Iterable[Choice]) -> None:
        super().__init__()
        self._choices = {choice.symbol: choice for choice in choices}

    def lines(self, name: str, expression: sympy.Expr) -> Iterator[str]:
        """Yield the line of an equation, or the lines of its cases."""
        if not isinstance(expression, sympy.Piecewise):
            yield f"{name} = {self.doprint(expression)}"
            return
        prefix = f"{name} = "
        for value, condition in expression.args:
            case = "otherwise"
            if condition != sympy.true:
                case = f"if {self.doprint(condition)}"
            yield f"{prefix}{self.doprint(value)}, {case}"
            prefix = " " * len(prefix)  # further cases are aligned with the first

    def _print_Piecewise(self, expr: sympy.Piecewise) -> str:
        *cases, (last, condition) = expr.args
        texts = [f"{self._print(e)} if {self._print(c)}" for e, c in cases]
        otherwise = f"else {self._print(last)}"
        if condition != sympy.true:
            otherwise += f" if {self._print(condition)}"
        return f"{{{', '.join([*texts, otherwise])}}}"

    def _print_Relational(self, expr: sympy.Rel) -> str:
        if isinstance(expr, sympy.Eq) and expr.lhs in self._choices:
            name, _ = self._choices[expr.lhs].items[int(expr.rhs) - 1]
            return f"{expr.lhs} is {name}"
        return str(super()._print_Relational(expr))

    def _print_Float(self, expr: sympy.Float) -> str:
        return f"{float(expr):g}"

    def _print_absolute(self, expr: sympy.Expr) -> str:
        return f"abs({self._print(expr.args[0])})"


def _rows(interface: Interface, roles: Sequence[Role]) -> Iterator[dict[str, Any]]:
    for array in interface.arrays:
        first_variable = array.elements[0]
        if first_variable.role not in roles:
            continue
        start = ""
        if not first_variable.computed:
            start = _start_text(array)
        choices: list[tuple[int, str, str]] = []
        if first_variable.enumeration is not None:
            items = first_variable.enumeration.items
            choices = [(k, name, text) for k, (name, text) in enumerate(items, start=1)]
        yield {
            "name": _indexed_name(array),
            "unit": _unit_text(first_variable),
            "start": start,
            "changes": _CHANGES.get(first_variable.role, ""),
            "text": _common_text(array),
            "choices": choices,
        }


def _indexed_name(array: ArrayVariable) -> str:
    if not array.shape:
        return array.name
    return f"{array.name}[{','.join(_INDICES[: len(array.shape)])}]"


def _unit_text(variable: Variable) -> str:
    if variable.boolean:
        return "boolean"
    if variable.integer or variable.enumeration:
        return "integer"
    return variable.unit or "1"


def _start_text(array: ArrayVariable) -> str:
    if array.elements[0].boolean:
        values = [str(variable.start != 0.0).lower() for variable in array.elements]
    else:
        values = [f"{variable.start:.6g}" for variable in array.elements]
    if len(set(values)) == 1:
        return values[0]
    return ", ".join(values)


def _common_text(array: ArrayVariable) -> str:
    """Return the description of all elements, with letters for the indices that differ."""
    words = [variable.description.split(" ") for variable in array.elements]
    if len({len(w) for w in words}) > 1:
        return "; ".join(variable.description for variable in array.elements)
    columns = zip(*words, strict=True)
    return " ".join(_common_word(column, array) for column in columns)


def _common_word(column: Sequence[str], array: ArrayVariable) -> str:
    if len(set(column)) == 1:
        return column[0]
    indices = [
        variable.name.rpartition("[")[2].rstrip("]").split(",") for variable in array.elements
    ]
    for place, letter in enumerate(_INDICES[: len(array.shape)]):
        pairs = [(word, index[place]) for word, index in zip(column, indices, strict=True)]
        general = {word.replace(index, letter) for word, index in pairs if index in word}
        if len(general) == 1 and all(index in word for word, index in pairs):
            return general.pop()
    return "/".join(dict.fromkeys(word.rstrip(",:") for word in column))
