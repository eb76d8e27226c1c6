"""The interface of an FMU: one table of variables, from which the XML and the C both come.

The position of a variable in the table is its FMI value reference and its index in the C struct.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from hesr_model.errors import ExportError

Role = Literal["input", "output", "local", "state", "fixed", "tunable"]

# FMI's attributes of each role: causality, variability and, where it must be written, initial.
ATTRIBUTES: dict[Role, tuple[str, str, str | None]] = {
    "input": ("input", "continuous", None),
    "output": ("output", "continuous", "calculated"),
    "local": ("local", "continuous", "calculated"),
    "state": ("local", "continuous", "exact"),
    "fixed": ("parameter", "fixed", "exact"),
    "tunable": ("parameter", "tunable", "exact"),
}

# Structured names of FMI 2.0 without the quoted ones, so that no name needs escaping anywhere.
_PART = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
_NAME = re.compile(rf"{_PART}(\.{_PART})*|der\({_PART}(\.{_PART})*\)", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Enumeration:
    """A set of named choices with the values 1, 2, ..."""

    name: str
    items: tuple[tuple[str, str], ...]
    """Name and description of each choice."""


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One variable of an FMU.

    Attributes
    ----------
    name : structured name, as `dq[1]` or `joint[1].alpha`.
    role : what it is to FMI; see `ATTRIBUTES`.
    description : for the user.
    unit : SI unit in FMI's spelling; None only for an enumeration.
    enumeration : its choices, if it is one; a Real otherwise.
    start : start value; for a computed variable it is not shown.
    derivative_of : name of the state whose time derivative this is.
    dependencies : for a computed variable, the names of all variables in its expression.
    """

    name: str
    role: Role
    description: str
    unit: str | None = None
    enumeration: Enumeration | None = None
    start: float = 0.0
    derivative_of: str | None = None
    dependencies: tuple[str, ...] = ()

    @property
    def computed(self) -> bool:
        """Whether the component computes it from others."""
        return self.role in ("output", "local")


@dataclass(frozen=True, kw_only=True)
class Interface:
    """All variables of an FMU in the order of their value references.

    Raises
    ------
    ExportError
        If a name occurs twice or is not a structured name of FMI.
    """

    variables: tuple[Variable, ...]

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for variable in self.variables:
            if not _NAME.fullmatch(variable.name) or variable.name in seen:
                raise ExportError(
                    f"variable name '{variable.name}' is {_odd(variable.name in seen)}; needed are "
                    "distinct names of letters, digits and underscores."
                )
            seen.add(variable.name)

    @cached_property
    def references(self) -> dict[str, int]:
        """Value reference of each name."""
        return {variable.name: i for i, variable in enumerate(self.variables)}

    def first(self, names: Sequence[str]) -> int:
        """Value reference of the first of `names`, which must stand one after the other."""
        start = self.references[names[0]]
        if [v.name for v in self.variables[start : start + len(names)]] != list(names):
            raise ValueError(f"{names} are not consecutive variables")
        return start


def _odd(twice: bool) -> str:
    return "used twice" if twice else "not a structured name of FMI"


def to_c(interface: Interface, guid: str) -> str:
    """Return interface.h: the GUID and the table of variables of the C side."""
    rows = []
    for variable in interface.variables:
        kind = (
            f"INTEGER, 1, {len(variable.enumeration.items)}"
            if variable.enumeration
            else "REAL, 0, 0"
        )
        start = literal(variable.start)
        rows.append(f'    {{"{variable.name}", {start}, {variable.role.upper()}, {kind}}},')
    return "\n".join(
        [
            "/* Generated: the variables of the FMU; an index is an FMI value reference. */",
            "#ifndef INTERFACE_H",
            "#define INTERFACE_H",
            "",
            '#include "variable.h"',
            "",
            f'#define MODEL_GUID "{guid}"',
            "",
            f"enum {{ VARIABLES = {len(rows)} }};",
            "",
            "static const Variable variables[VARIABLES] = {",
            *rows,
            "};",
            "",
            "#endif",
            "",
        ]
    )


def literal(value: float) -> str:
    """Return a C literal of a double that reads back as the same double."""
    text = f"{value:.17g}"
    return text if any(c in text for c in ".en") else f"{text}.0"
