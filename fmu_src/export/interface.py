"""Interface of an FMU: one table of variables for both the XML and the C.

The position of a variable in the table is its index in the C struct. Value references have a
separate table, because those of FMI 3.0 can denote arrays.
"""

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from itertools import groupby, product
from typing import Literal, NamedTuple

from hesr_model.errors import ExportError

Role = Literal["input", "output", "on_demand", "local", "state", "fixed", "tunable"]

# FMI attributes of each role: causality, variability and, if required, initial.
_ATTRIBUTES: dict[Role, tuple[str, str, str | None]] = {
    "input": ("input", "continuous", None),
    "output": ("output", "continuous", "calculated"),
    "on_demand": ("output", "discrete", "calculated"),
    "local": ("local", "continuous", "calculated"),
    "state": ("local", "continuous", "calculated"),
    "fixed": ("parameter", "fixed", "exact"),
    "tunable": ("parameter", "tunable", "exact"),
}

_PART = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
NAME = re.compile(rf"{_PART}(\.{_PART})*|der\({_PART}(\.{_PART})*\)", re.ASCII)
"""Structured names (FMI 2.0, 2.2.9) without quoted ones, so that no name needs escaping."""


@dataclass(frozen=True, kw_only=True)
class Enumeration:
    """A set of named choices with the values 1, 2, ..."""

    name: str
    items: tuple[tuple[str, str], ...]
    """Name and description of each choice."""


@dataclass(frozen=True)
class Variable:
    """One variable of an FMU, with a structured name such as `dq[1]` or `joint[1].alpha`.

    The unit, in FMI's spelling, is None only for an enumeration, an `integer` and a `boolean`.
    Solvers scale the tolerance of a state by its nominal value. `least` and `greatest` are
    recommended limits, values outside which are refused if `limited`; those of an integer always
    are.

    Initial dependencies count in addition until initialisation ends; for a state they are those of
    its initial value.
    """

    name: str
    role: Role
    description: str
    _: KW_ONLY
    unit: str | None = None
    enumeration: Enumeration | None = None
    start: float = 0.0
    nominal: float = 1.0
    least: float | None = None
    greatest: float | None = None
    limited: bool = False
    integer: bool = False
    boolean: bool = False
    derivative_of: str | None = None
    dependencies: tuple[str, ...] = ()
    initial_dependencies: tuple[str, ...] = ()

    @property
    def attributes(self) -> tuple[str, str, str | None]:
        """Causality, variability and initial (None if not written)."""
        causality, variability, initial = _ATTRIBUTES[self.role]
        if variability == "continuous" and (self.boolean or self.integer):
            variability = "discrete"
        return causality, variability, initial

    @property
    def computed(self) -> bool:
        """Whether the component computes it."""
        return self.role in ("output", "on_demand", "local")


@dataclass(frozen=True, kw_only=True)
class Interface:
    """All scalar variables of an FMU in index order.

    `own` is the number of doubles in the component's own memory. A component with `inner_steps`
    follows input slopes itself. Arrays in `connected` remain scalars in FMI 3.0, as members of
    terminals. Raises ExportError if a name is duplicate or invalid in FMI.
    """

    variables: tuple[Variable, ...]
    indicators: int = 0
    own: int = 0
    model_exchange: bool = True
    directional_derivatives: bool = True
    inner_steps: bool = False
    connected: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        names: set[str] = set()
        for variable in self.variables:
            problem = ""
            if variable.name in names:
                problem = "used twice"
            elif not NAME.fullmatch(variable.name):
                problem = "not a structured name of FMI"
            if problem:
                raise ExportError(
                    f"variable name '{variable.name}' is {problem}; expected distinct names of "
                    "letters, digits and underscores."
                )
            names.add(variable.name)

    @cached_property
    def places(self) -> dict[str, int]:
        """Index of each variable, its value reference in FMI 2.0, and first index of each array."""
        indices = {array.name: array.place for array in self.arrays}
        return indices | {variable.name: i for i, variable in enumerate(self.variables)}

    @cached_property
    def arrays(self) -> tuple["ArrayVariable", ...]:
        """The variables in order, grouped into arrays, with scalars.

        Elements of an array are consecutive, from `[1]` or `[1,1]` with the last index running
        first, and have one role and one unit.
        """
        arrays: list[ArrayVariable] = []
        counts = Counter(_split(variable.name)[0] for variable in self.variables)
        for (name, _), group in groupby(
            enumerate(self.variables), lambda pair: _array_key(pair[1])
        ):
            places, elements = zip(*group, strict=True)
            indices = [_split(variable.name)[1] for variable in elements]
            shape = indices[-1]
            full_indices = list(product(*(range(1, size + 1) for size in shape)))
            if name and indices == full_indices and len(full_indices) == counts[name]:
                arrays.append(ArrayVariable(name, shape, places[0], elements))
            else:
                arrays += _scalars(places[0], elements)
        return tuple(arrays)

    @cached_property
    def parts(self) -> tuple["ArrayVariable", ...]:
        """Variables of FMI 3.0: arrays, but scalars of states and of members of terminals."""
        parts: list[ArrayVariable] = []
        for array in self.arrays:
            if array.elements[0].role == "state" or array.name in self.connected:
                parts += _scalars(array.place, array.elements)
            else:
                parts.append(array)
        return tuple(parts)

    @cached_property
    def part_of(self) -> dict[str, "ArrayVariable"]:
        """The variable of FMI 3.0 that contains each variable."""
        part_of: dict[str, ArrayVariable] = {}
        for array in self.parts:
            part_of |= dict.fromkeys((variable.name for variable in array.elements), array)
        return part_of

    @cached_property
    def derivatives(self) -> tuple[Variable, ...]:
        """Time derivatives of the states, in the order of FMI's continuous states."""
        return tuple(variable for variable in self.variables if variable.derivative_of)

    def initially(self, variable: Variable) -> tuple[str, ...]:
        """Return the names, without states, that determine a variable at the start."""
        names = dict.fromkeys((*variable.dependencies, *variable.initial_dependencies))
        ahead = list(names)
        for name in ahead:  # grows by what determines states
            if name in self._states:
                initial_sources = self._states[name].initial_dependencies
                ahead += [source for source in initial_sources if source not in names]
                names |= dict.fromkeys(initial_sources)
        return tuple(name for name in names if name not in self._states)

    @cached_property
    def _states(self) -> dict[str, Variable]:
        names = [variable.derivative_of for variable in self.derivatives]
        return {
            variable.name: variable
            for variable in self.variables
            if variable.role == "state" or variable.name in names
        }

    def find_dependencies(
        self, variable: Variable, roles: Sequence[Role], *, initially: bool = False
    ) -> list[str]:
        """Return the names in `dependencies`, or in `initially`, of variables with some roles."""
        names = variable.dependencies
        if initially:
            names = self.initially(variable)
        return [name for name in names if self._role(name) in roles]

    def _role(self, name: str) -> Role:
        """Return the role of a variable; outputs with a derivative count as states."""
        if name in self._states:
            return "state"
        return self.variables[self.places[name]].role

    def first(self, names: Sequence[str]) -> int:
        """Index of the first of `names`, which must be consecutive."""
        start = self.places[names[0]]
        followers = self.variables[start : start + len(names)]
        if [variable.name for variable in followers] != list(names):
            raise ValueError(f"{names} are not consecutive variables")
        return start


@dataclass(frozen=True)
class ArrayVariable:
    """A variable with a shape, () for a scalar, and the index `place` of its first element."""

    name: str
    shape: tuple[int, ...]
    place: int
    elements: tuple[Variable, ...]


def _scalars(place: int, elements: Sequence[Variable]) -> list[ArrayVariable]:
    """Return consecutive variables from an index as scalars."""
    return [
        ArrayVariable(variable.name, (), i, (variable,))
        for i, variable in enumerate(elements, place)
    ]


def _split(name: str) -> tuple[str, tuple[int, ...]]:
    array, _, indices = name.removesuffix("]").rpartition("[")
    if not name.endswith("]"):
        return "", ()
    return array, tuple(map(int, indices.split(",")))


def _array_key(variable: Variable) -> tuple[str, object]:
    array, indices = _split(variable.name)
    kind = (variable.unit, variable.enumeration, variable.integer, variable.boolean)
    return array, (len(indices), variable.role, *kind)


def to_c(interface: Interface, guid: str, step_size: float) -> str:
    """Return interface.h: GUID, preferred step [s] and the table of variables for the C side."""
    variables = interface.variables
    places = interface.places
    last_input = 0
    watched = []
    for i, variable in enumerate(variables):
        if variable.role == "input":
            last_input = i
        elif variable.role in ("output", "local", "state") and not _is_derivative(variable):
            watched.append(i)
    states = [places[variable.derivative_of or ""] for variable in interface.derivatives]
    derivatives = [places[variable.name] for variable in interface.derivatives]
    numbers = [f"    {{{literal(variable.start)}, {_bounds(variable)}}}," for variable in variables]
    return _INTERFACE.format(
        guid=guid,
        step=literal(step_size),
        own=interface,
        derivable=interface.directional_derivatives,
        variables=len(variables),
        slopes=1 + last_input,  # up to the last input; C has no empty arrays
        states=len(states),
        booleans=sum(variable.boolean for variable in variables),
        watched=len(watched),
        rows="\n".join(_rows(interface)),
        numbers="\n".join(numbers),
        state_list=_list(states),
        derivative_list=_list(derivatives),
        nominal_list=_list([literal(variables[i].nominal) for i in states]),
        watched_list=_list(watched + derivatives),
    )


def _is_derivative(variable: Variable) -> bool:
    """Whether a variable is nothing but the derivative of a state; outputs may be one as well."""
    return bool(variable.derivative_of) and variable.role == "local"


class _Kind(NamedTuple):
    """What the C side distinguishes about a variable.

    Attributes
    ----------
    role, type : constants of variable.h.
    used : 1 if any result depends directly on it, 0 for an input without influence.
    bounds : of its values.
    is_free : whether a run of variables of this kind needs only one check.
    """

    role: str
    type: str
    used: int
    bounds: str
    is_free: bool


def _rows(interface: Interface) -> Iterator[str]:
    """Yield the rows of the table of variables, see variable.h."""
    used_names: set[str] = set()
    for variable in interface.variables:
        if variable.computed or variable.role == "state":
            used_names |= {*variable.dependencies, *variable.initial_dependencies}
    kinds = [_find_kind(variable, used_names) for variable in interface.variables]
    pairs = zip(kinds, interface.variables, strict=True)
    for kind, group in groupby(pairs, lambda pair: pair[0]):
        names = [variable.name for _, variable in group]
        for k, name in enumerate(names):
            alike = 0
            if kind.is_free:
                alike = len(names) - k
            yield f'    {{"{name}", {kind.role}, {kind.type}, {kind.used}, {alike}}},'


def _find_kind(variable: Variable, used_names: Collection[str]) -> _Kind:
    role = variable.role.upper()
    if _is_derivative(variable):
        role = "DERIVATIVE"
    bounds = _bounds(variable)
    is_unbounded = bounds == "-INFINITY, INFINITY"
    return _Kind(
        role=role,
        type=_c_type(variable),
        used=int(variable.role != "input" or variable.name in used_names),
        bounds=bounds,
        is_free=is_unbounded and role not in ("ON_DEMAND", "DERIVATIVE"),
    )


def _c_type(variable: Variable) -> str:
    if variable.boolean:
        return "LOGICAL"
    if variable.enumeration or variable.integer:
        return "INTEGER"
    return "REAL"


_MIN_INT32 = -(2.0**31)
_MAX_INT32 = 2.0**31 - 1.0


def _bounds(variable: Variable) -> str:
    """Return the bounds outside which values are refused, as C."""
    if variable.enumeration:
        return f"1.0, {literal(len(variable.enumeration.items))}"
    if variable.boolean:
        return "0.0, 1.0"
    lower = "-INFINITY"
    upper = "INFINITY"
    if variable.integer:
        lower = literal(_MIN_INT32)
        upper = literal(_MAX_INT32)
    if variable.integer or variable.limited:
        if variable.least is not None:
            lower = literal(variable.least)
        if variable.greatest is not None:
            upper = literal(variable.greatest)
    return f"{lower}, {upper}"


def _list(items: Sequence[object]) -> str:
    return f"[] = {{{', '.join(map(str, items or [0]))}}}"


_INTERFACE = """\
/* Generated: the variables of the FMU, whose value references are their indices. */
#ifndef INTERFACE_H
#define INTERFACE_H

#include "variable.h"

#define MODEL_GUID "{guid}"
#define PREFERRED_STEP {step} /* [s] */

enum {{ VARIABLES = {variables}, STATES = {states}, INDICATORS = {own.indicators} }};
enum {{ OWN = {own.own}, WATCHED = {watched}, SLOPES = {slopes} }};
enum {{ MODEL_EXCHANGE = {own.model_exchange:d}, DIRECTIONAL_DERIVATIVES = {derivable:d} }};
enum {{ INNER_STEPS = {own.inner_steps:d}, BOOLEANS = {booleans} }};

static const Variable variables[VARIABLES] = {{
{rows}
}};

/* Start value and bounds of each variable. An export overwrites this table in a compiled binary,
 * so it is volatile: no compiler may assume its numbers. */
static const volatile struct {{
    char mark[16], guid[40];
    struct {{
        double start, low, high;
    }} of[VARIABLES];
}} numbers = {{"hesr numbers 01", MODEL_GUID, {{
{numbers}
}}}};

/* Continuous states, their derivatives and nominal values; values that must stay finite, with
 * derivatives, which steps omit, behind WATCHED others. An empty list has one element. */
static const int states{state_list};
static const int derivatives{derivative_list};
static const double nominals{nominal_list};
static const int watched{watched_list};

#endif
"""


_TABLE = re.compile(r"(\} numbers = .*\n)((?:    \{.*\},\n)+)")
_GUID = re.compile(r'(#define MODEL_GUID ")(.*)"')
_GUID_SIZE = 40
NUMBERS = b"hesr numbers 01\0"
"""Bytes before the table of numbers in a binary."""


def extract_numbers(text: str) -> tuple[str, bytes]:
    """Return an interface.h with zeros for its numbers and GUID, and the bytes of its table."""
    table = _TABLE.search(text)
    guid = _GUID.search(text)
    if table is None or guid is None:
        raise ValueError("no interface.h of this version")
    words = table[2].replace("INFINITY", "inf").translate(str.maketrans("{},", "   ")).split()
    content = guid[2].encode().ljust(_GUID_SIZE, b"\0")
    content += struct.pack(f"<{len(words)}d", *map(float, words))
    zeros = re.sub(r"\{.*\}", "{0.0, 0.0, 0.0}", table[2])
    return _GUID.sub(r'\1"', text.replace(table[2], zeros)), content


def literal(value: float) -> str:
    """Return a C literal that reads back as the same double."""
    text = f"{value:.17g}"
    if not any(c in text for c in ".en"):  # else an integer in C
        text += ".0"
    return text
