"""Model descriptions: read, checked, and searched by variable name.

Variables of FMI 3.0 become those of FMI 2.0: a scalar per array element, in four types. Its
reference is the value reference of the array with the position of the element above bit 32.
"""

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.model_description import ModelDescription, read_model_description

from fmu_src.run.archive import MAX_TEXT_BYTES, Archive
from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.support.files import scratch_folder
from hesr_model.support.ledger import find_close_names, format_suggestion
from hesr_model.support.text import quote, sanitise

DESCRIPTION = "modelDescription.xml"

Value = bool | float | int | str | tuple[float, ...] | list[float]
"""Start value: a number, a list for all elements of a vector, or the name of a choice."""

Declared = tuple[int, str, str, list[Any]]
"""Value reference, name, FMI 3.0 type and start values of a variable."""

SI = ("kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset")
"""Unit attributes of FMI and SSP: exponents of the base units, factor and offset."""

_IDENTIFIER = re.compile(r"[A-Za-z_][0-9A-Za-z_]{0,199}")
_INDEX = re.compile(r"\[\d+(,\d+)*\]$")
_CHOICE = re.compile(r"\b(\d+) = (\w+)")

_MAX_VALUE_LENGTH = 40  # characters of a value in a message
_POSITION = 32  # lowest bit of an element's position in a reference
_MAX_ELEMENTS = 100_000
_BITS = (8, 16, 32, 64)
_RANGES: dict[str, tuple[int, int]] = {
    **{f"Int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in _BITS},
    **{f"UInt{bits}": (0, 2**bits - 1) for bits in _BITS},
}
"""Lowest and highest value by integer type of FMI 3.0; Integer of FMI 2.0 is Int32."""
_TYPES = {"Float64": "Real", "Enumeration": "Integer"} | dict.fromkeys(_RANGES, "Integer")
_LARGEST_VALUES = {"Real": sys.float_info.max, "Float32": float(np.finfo(np.float32).max)}
_BOOLEANS = {"true": 1, "false": 0}


def model_description(fmu: Path) -> ModelDescription:
    """Read the description of an FMU; see `read_packed_description`."""
    try:
        with Archive(fmu) as archive:
            return read_packed_description(archive)[0]
    except ArtifactError as error:
        raise SimulationError(f"{error}") from error


def read_packed_description(archive: Archive) -> tuple[ModelDescription, list[Declared]]:
    """Read the description in an FMU, and the variables of FMI 3.0 as declared.

    Raises ArtifactError if it is missing or damaged, SimulationError if it is not readable.
    """
    text = archive.read(DESCRIPTION, MAX_TEXT_BYTES)
    with scratch_folder() as folder:
        Path(folder, DESCRIPTION).write_bytes(text)
        return read_unpacked_description(Path(folder), archive.path)


def read_unpacked_description(folder: Path, fmu: Path) -> tuple[ModelDescription, list[Declared]]:
    """Read the description in the folder of an unpacked FMU; see `read_packed_description`."""
    try:
        model_description = read_model_description(str(folder), validate=False)
        declared = list[Declared]()
        if model_description.fmiVersion.startswith("3."):
            model_description, declared = _expand_arrays(model_description)
    except Exception as error:  # FMPy raises bare exceptions
        raise SimulationError(f"{fmu}: not a readable FMU ({sanitise(str(error))}).") from error
    for kind in (model_description.coSimulation, model_description.modelExchange):
        if kind is not None and not _IDENTIFIER.fullmatch(kind.modelIdentifier or ""):
            raise SimulationError(
                f"{fmu}: its modelIdentifier is {quote(str(kind.modelIdentifier))}; expected an "
                "identifier of C with at most 200 characters."
            )
    return model_description, declared


def split_reference(reference: int) -> tuple[int, int]:
    """Return the value reference of an array and the position of an element."""
    return reference & (1 << _POSITION) - 1, reference >> _POSITION


def _expand_arrays(model_description: Any) -> tuple[Any, list[Declared]]:
    _require_sizes(model_description.modelVariables)
    elements: dict[int, list[Any]] = {}
    declared: list[Declared] = []
    for variable in model_description.modelVariables:
        elements[id(variable)] = _elements(variable)
        declared.append((variable.valueReference, variable.name, variable.type, _starts(variable)))

    def all_elements(variables: Sequence[Any]) -> list[Any]:
        collected: list[Any] = []
        for variable in variables:
            collected += elements[id(variable)]
        return collected

    def scalars(unknowns: Sequence[Any]) -> list[Any]:
        scalar_unknowns: list[Any] = []
        for unknown in unknowns:
            dependencies = unknown.dependencies
            if dependencies:
                dependencies = all_elements(dependencies)
            scalar_unknowns += [
                _replace_fields(unknown, variable=variable, dependencies=dependencies)
                for variable in elements[id(unknown.variable)]
            ]
        return scalar_unknowns

    expanded = _replace_fields(
        model_description,
        modelVariables=all_elements(model_description.modelVariables),
        outputs=scalars(model_description.outputs),
        derivatives=scalars(model_description.derivatives),
        initialUnknowns=scalars(model_description.initialUnknowns),
    )
    return expanded, declared


def _replace_fields(original: Any, **values: Any) -> Any:
    duplicate = copy(original)
    for name, value in values.items():
        setattr(duplicate, name, value)
    return duplicate


def _require_sizes(variables: Sequence[Any]) -> None:
    for variable in variables:
        if not 0 <= variable.valueReference < 1 << _POSITION:
            raise ValueError(
                f"the value reference of '{variable.name}' is {variable.valueReference}"
            )
        if any(size < 0 for size in variable.shape):
            raise ValueError(f"a dimension of '{variable.name}' is {min(variable.shape)}")
    count = sum(prod(variable.shape) for variable in variables)
    if count > _MAX_ELEMENTS:
        raise ValueError(
            f"its variables have {count} elements; at most {_MAX_ELEMENTS} can be read"
        )


def _elements(variable: Any) -> list[Any]:
    kind = _TYPES.get(variable.type, variable.type)
    if not variable.dimensions:
        return [_replace_fields(variable, type=kind)]
    size = prod(variable.shape)
    starts: list[str | None] = list((variable.start or "").split())
    if not starts:
        starts = [None]
    if len(starts) == 1:  # for all elements
        starts *= size
    elements = []
    for position, index in enumerate(np.ndindex(*variable.shape)):
        numbers = ",".join(str(i + 1) for i in index)
        element = _replace_fields(
            variable,
            name=f"{variable.name}[{numbers}]",
            type=kind,
            valueReference=variable.valueReference | position << _POSITION,
            start=starts[position],
            dimensions=[],
            shape=(),
        )
        elements.append(element)
    return elements


def _starts(variable: Any) -> list[Any]:
    if variable.type in ("String", "Binary", "Clock"):
        return [variable.start or ""]
    size = prod(variable.shape or (1,))
    start_values = [_number(text) for text in str(variable.start or "").split()]
    if len(start_values) == size:
        return start_values
    # One value is for all elements; zero is the default.
    return (start_values or [0.0])[:1] * size


def _number(text: str) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    return float(text)


def _items(variable: Any) -> dict[str, int]:
    """Return the values of an enumeration by name."""
    declared = variable.declaredType
    if declared is None:
        return {}
    items: Sequence[Any] = declared.items or ()
    return {item.name: int(item.value) for item in items}


class Variables:
    """Variables of an FMU by name; `declared` are those of FMI 3.0. Raises SimulationError."""

    def __init__(self, fmu: Path, description: Any, declared: Iterable[Declared] = ()) -> None:
        self._fmu = fmu
        self._description = description
        self._types = {reference: kind for reference, _, kind, _ in declared}
        self._by_name = {variable.name: variable for variable in description.modelVariables}
        self._units = {unit.name: unit.baseUnit for unit in description.unitDefinitions or ()}

    def __getitem__(self, name: str) -> Any:
        try:
            return self._by_name[name]
        except KeyError:
            hint = format_suggestion(find_close_names(name, self.names))
            end = "."
            if hint:
                end = f"; {hint}"
            raise SimulationError(f"{self._fmu}: there is no variable '{name}'{end}") from None

    @property
    def names(self) -> list[str]:
        """Names of vectors and of all variables."""
        vectors = (_INDEX.sub("", name) for name in self._by_name)
        return list(dict.fromkeys([*vectors, *self._by_name]))

    def elements(self, name: str) -> list[str]:
        """Return the variable of this name, or all elements of the vector of this name."""
        if name in self._by_name:
            return [name]
        vector = re.compile(rf"{re.escape(name)}\[\d+(,\d+)*\]")
        return [n for n in self._by_name if vector.fullmatch(n)] or [self[name].name]

    def references(self, names: Sequence[str], kind: str) -> list[int]:
        """Return the value references of variables, which must be of one type."""
        for name in names:
            if self[name].type != kind:
                raise SimulationError(f"{self._fmu}: variable '{name}' is not a {kind}.")
        return [self._by_name[name].valueReference for name in names]

    def unit(self, name: str) -> tuple[str | None, tuple[float, ...] | None]:
        """Return the unit of a variable and, if defined, its value in SI base units."""
        variable = self[name]
        unit = variable.unit or None
        if unit is None and variable.declaredType:
            unit = variable.declaredType.unit
        base = self._units.get(unit)
        if base is None:
            return unit, None
        return unit, tuple(getattr(base, key) for key in SI)

    @property
    def inputs(self) -> list[str]:
        """Names of all inputs."""
        return [n for n, variable in self._by_name.items() if variable.causality == "input"]

    def relative(self, name: str) -> bool:
        """Return whether a variable is a difference, which the offset of a unit does not affect."""
        variable = self[name]
        if variable.relativeQuantity is None and variable.declaredType:
            return bool(variable.declaredType.relativeQuantity)
        return bool(variable.relativeQuantity)

    @property
    def feedthrough(self) -> dict[str, list[str]]:
        """Inputs with direct feedthrough to each output; all inputs if none are declared."""
        return {u.variable.name: self._find_inputs(u) for u in self._description.outputs}

    @property
    def declares_feedthrough(self) -> bool:
        """Whether the dependencies of every output are declared."""
        return all(unknown.dependencies is not None for unknown in self._description.outputs)

    @property
    def needed(self) -> list[str]:
        """Inputs that affect outputs or states; in FMUs for co-simulation alone all inputs."""
        description = self._description
        if description.modelExchange is None:
            return self.inputs
        used_inputs: set[str] = set()
        for unknown in (*description.outputs, *description.derivatives):
            used_inputs |= set(self._find_inputs(unknown))
        return [name for name in self.inputs if name in used_inputs]

    def _find_inputs(self, unknown: Any) -> list[str]:
        if unknown.dependencies is None:
            return self.inputs
        return [variable.name for variable in unknown.dependencies if variable.causality == "input"]

    def expand_values(self, values: Mapping[str, Value]) -> dict[str, float | str]:
        """Return values by variable from numbers, lists for vectors, and names of choices."""
        expanded: dict[str, float | str] = {}
        for name, value in values.items():
            elements = self.elements(name)
            parts: list[Any] = [value] * len(elements)
            if isinstance(value, tuple | list):
                parts = list(value)
            if len(parts) != len(elements):
                raise SimulationError(
                    f"{self._fmu}: '{name}' has {len(elements)} element{'s'[: len(elements) > 1]}; "
                    f"{len(parts)} values are given."
                )
            expanded |= {e: self._check_value(e, p) for e, p in zip(elements, parts, strict=True)}
        return expanded

    def _check_value(self, name: str, value: Any) -> float | str:
        """Return the value of a variable; raise SimulationError unless it has it exactly."""
        variable = self[name]
        kind = variable.type
        if kind in ("Binary", "Clock"):
            raise SimulationError(f"{self._fmu}: '{name}' is a {kind}, which has no start value.")
        if isinstance(value, str):
            if kind == "String":
                return value
            return self._choice(name, value)
        if kind == "String" or not isinstance(value, bool | int | float | np.number):
            raise self._misfit(name, value)
        if kind == "Boolean":
            if value not in (0, 1):
                raise self._misfit(name, value, "true or false")
            return bool(value)
        if isinstance(value, bool | np.bool_):
            raise self._misfit(name, value)
        if kind in _LARGEST_VALUES:
            return self._finite(name, value, _LARGEST_VALUES[kind])
        if isinstance(value, np.floating):
            value = float(value)
        return self._integer(name, value)

    def _finite(self, name: str, value: Any, largest: float) -> float:
        """Return the value of a Real or Float32, which must have a magnitude up to the largest."""
        if not -largest <= value <= largest:  # a NaN included
            raise self._misfit(name, value, f"a finite number up to {largest:.4g} in magnitude")
        return float(value)

    def _integer(self, name: str, value: Any) -> int:
        """Return the value of an Integer or Enumeration; the range is that of its type."""
        variable = self[name]
        declared = self._declared_type(variable)
        if declared == "Enumeration":
            items = _items(variable)
            if items and value not in items.values():
                choices = ", ".join(f"{number} = {item}" for item, number in items.items())
                raise self._misfit(name, value, f"one of {choices}")
        lowest, highest = _RANGES.get(declared, _RANGES["Int32"])
        if not lowest <= value <= highest or value != int(value):
            raise self._misfit(name, value, f"an integer from {lowest} to {highest}")
        return int(value)

    def _declared_type(self, variable: Any) -> str:
        """Return the type of a variable in its description, such as UInt8."""
        array, _ = split_reference(variable.valueReference)
        return self._types.get(array, str(variable.type))

    def _misfit(self, name: str, value: Any, expected: str = "") -> SimulationError:
        variable = self[name]
        kind = self._declared_type(variable)
        value_text = sanitise(repr(value), _MAX_VALUE_LENGTH)
        end = "."
        if expected:
            end = f"; it must be {expected}."
        return SimulationError(
            f"{self._fmu}: '{name}' is of type {kind}; it cannot be {value_text}{end}"
        )

    def _choice(self, name: str, value: str) -> int:
        """Return the value of a choice; an Integer may be described as "1 = fourier, 2 = sine"."""
        variable = self[name]
        items: Mapping[str, int] = _BOOLEANS
        if variable.type != "Boolean":
            items = _items(variable)
        if variable.type == "Integer" and not items:
            items = {m[2]: int(m[1]) for m in _CHOICE.finditer(variable.description or "")}
        numbers = {str(number): number for number in items.values()}  # as some tools write them
        choice = items.get(value, numbers.get(value))
        if choice is None:
            constraint = "it has no choices"
            if items:
                constraint = f"it must be one of {', '.join(items)}"
            raise SimulationError(f"{self._fmu}: '{name}' cannot be '{value}'; {constraint}.")
        return choice
