"""The variables of FMI 3.0 as those of FMI 2.0: one for each element of an array, in four types.

The reference of an element is the value reference of its array and, above it, the element's place.
"""

from collections.abc import Sequence
from copy import copy
from math import prod
from typing import Any

import numpy as np

Declared = tuple[int, str, str, list[Any]]
"""Value reference, name, type in FMI 3.0 and start values of a variable."""

_PLACE = 32  # bits of a value reference
_MOST_ELEMENTS = 100_000
_TYPES = {"Float64": "Real", "Enumeration": "Integer"} | {
    f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)
}


def reference_of(array: int, place: int) -> int:
    """Return the reference of an element of an array."""
    return array | place << _PLACE


def element_of(reference: int) -> tuple[int, int]:
    """Return the value reference of an array, and the place of an element in it."""
    return reference & (1 << _PLACE) - 1, reference >> _PLACE


def with_scalars(about: Any) -> tuple[Any, list[Declared]]:
    """Return FMPy's description of FMI 3.0 with a variable for each element, and its variables.

    What depends on an array depends on each element; names are as FMI 2.0 structures them, `dq[1]`.

    Raises
    ------
    ValueError
        If a size, a value reference or a start value is none, or there are too many elements.
    """
    _require_sizes(about.modelVariables)
    elements = {id(v): _elements(v) for v in about.modelVariables}
    declared = [(v.valueReference, v.name, v.type, _starts(v)) for v in about.modelVariables]

    def scalars(unknowns: Sequence[Any]) -> list[Any]:
        return [
            _changed(
                unknown, variable=variable, dependencies=_every(unknown.dependencies, elements)
            )
            for unknown in unknowns
            for variable in elements[id(unknown.variable)]
        ]

    found = _changed(
        about,
        modelVariables=[e for v in about.modelVariables for e in elements[id(v)]],
        outputs=scalars(about.outputs),
        derivatives=scalars(about.derivatives),
        initialUnknowns=scalars(about.initialUnknowns),
    )
    return found, declared


def arrays_of(about: Any, declared: Sequence[Declared]) -> dict[str, tuple[str, ...]]:
    """Return the names of the elements of each array, by its own name."""
    found: dict[int, list[str]] = {}
    for variable in about.modelVariables:
        found.setdefault(element_of(variable.valueReference)[0], []).append(variable.name)
    return {name: tuple(found[array]) for array, name, _, _ in declared if name not in found[array]}


def _changed(one: Any, **values: Any) -> Any:
    other = copy(one)
    for name, value in values.items():
        setattr(other, name, value)
    return other


def _every(variables: Sequence[Any] | None, elements: dict[int, list[Any]]) -> list[Any] | None:
    return None if variables is None else [e for v in variables for e in elements[id(v)]]


def _require_sizes(variables: Sequence[Any]) -> None:
    count = 0
    for v in variables:
        if not 0 <= v.valueReference < 1 << _PLACE:
            raise ValueError(f"the value reference of '{v.name}' is {v.valueReference}")
        if any(size < 0 for size in v.shape):
            raise ValueError(f"a dimension of '{v.name}' is {min(v.shape)}")
        count += prod(v.shape)
    if count > _MOST_ELEMENTS:
        raise ValueError(
            f"its variables have {count} elements; at most {_MOST_ELEMENTS} can be read"
        )


def _elements(variable: Any) -> list[Any]:
    kind = _TYPES.get(variable.type, variable.type)
    if not variable.dimensions:
        return [_changed(variable, type=kind)]
    starts = (variable.start or "").split()
    return [
        _changed(
            variable,
            name=f"{variable.name}[{','.join(str(i + 1) for i in index)}]",
            type=kind,
            valueReference=reference_of(variable.valueReference, place),
            start=starts[place if len(starts) > 1 else 0] if starts else None,
            dimensions=[],
            shape=(),
        )
        for place, index in enumerate(np.ndindex(*variable.shape))
    ]


def _starts(variable: Any) -> list[Any]:
    """Return the start value of each element, zeros where none are given."""
    if variable.type in ("String", "Binary", "Clock"):
        return [variable.start or ""]
    size = int(np.prod(variable.shape or (1,)))
    given = [_number(text) for text in (str(variable.start or "")).split()]
    return given if len(given) == size else (given or [0.0])[:1] * size


def _number(text: str) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    return float(text)
