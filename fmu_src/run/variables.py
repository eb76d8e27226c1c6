"""The variables of one FMU, as its description lists them: found by name, start values checked."""

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from hesr_model.errors import SimulationError

Value = bool | float | int | str | tuple[float, ...] | list[float]
"""A start value: a number, a list for all elements of a vector, or the name of a choice."""

SI = ("kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset")
"""What FMI and SSP say of a unit: exponents of the base units, factor and offset."""

_INDEX = re.compile(r"\[\d+(,\d+)*\]$")
_CHOICE = re.compile(r"\b(\d+) = (\w+)")

_CLOSE = 0.6
"""Share of letters that names have in common, in order, from which on one may stand for another."""


def suggestion(name: str, known: Iterable[str], most: int) -> str:
    """Return "did you mean a, b or c?", the closest name first; nothing where none is close."""
    shares = {other: SequenceMatcher(None, other, name).ratio() for other in known}
    # Stable: names that are equally close stay in their own order.
    near = sorted((o for o, s in shares.items() if s >= _CLOSE), key=lambda o: -shares[o])[:most]
    if not near:
        return ""
    *others, last = near
    return f"did you mean {', '.join(others)} or {last}?" if others else f"did you mean {last}?"


class Variables:
    """Look-up in the description of an FMU.

    Parameters
    ----------
    fmu : the file, for messages.
    description : FMPy's model description.

    Raises
    ------
    SimulationError
        By every method: naming the FMU and what it does not have.
    """

    def __init__(self, fmu: Path, description: Any) -> None:
        self._fmu, self._description = fmu, description
        self._by_name = {v.name: v for v in description.modelVariables}
        self._units = {unit.name: unit.baseUnit for unit in description.unitDefinitions or ()}

    def __getitem__(self, name: str) -> Any:
        """Return the description of a variable."""
        try:
            return self._by_name[name]
        except KeyError:
            known = dict.fromkeys([*(_INDEX.sub("", n) for n in self._by_name), *self._by_name])
            hint = suggestion(name, known, 3)
            end = f"; {hint}" if hint else "."
            raise SimulationError(f"{self._fmu}: there is no variable '{name}'{end}") from None

    def elements(self, name: str) -> list[str]:
        """Return the variables that a name stands for: itself, or all elements of a vector."""
        if name in self._by_name:
            return [name]
        vector = re.compile(rf"{re.escape(name)}\[\d+(,\d+)*\]")
        return [n for n in self._by_name if vector.fullmatch(n)] or [self[name].name]

    def references(self, names: Sequence[str], kind: str) -> list[int]:
        """Return the value references of variables, all of which have to be of one type.

        Raises
        ------
        SimulationError
            If there is no such variable, or it is of another type.
        """
        for name in names:
            if self[name].type != kind:
                raise SimulationError(f"{self._fmu}: variable '{name}' is not a {kind}.")
        return [self._by_name[name].valueReference for name in names]

    def unit(self, name: str) -> tuple[str | None, tuple[float, ...] | None]:
        """Return the unit of a variable, and what it is in SI base units where that is said."""
        variable = self[name]
        unit = variable.unit or (variable.declaredType.unit if variable.declaredType else None)
        base = self._units.get(unit)
        return unit, None if base is None else tuple(getattr(base, key) for key in SI)

    @property
    def inputs(self) -> list[str]:
        """Names of all inputs."""
        return [n for n, v in self._by_name.items() if v.causality == "input"]

    @property
    def feedthrough(self) -> dict[str, list[str]]:
        """For each output the inputs on which it depends directly, all where none are declared."""
        return {u.variable.name: self._needed(u) for u in self._description.outputs}

    @property
    def declares_feedthrough(self) -> bool:
        """Whether every output says on which inputs it depends."""
        return all(unknown.dependencies is not None for unknown in self._description.outputs)

    @property
    def needed(self) -> list[str]:
        """Inputs that matter.

        An FMU for model exchange too shows all derivatives, hence what nothing depends on. One for
        co-simulation alone may use any input in its steps.
        """
        about = self._description
        if about.modelExchange is None:
            return self.inputs
        unknowns = (*about.outputs, *about.derivatives)
        used = {name for unknown in unknowns for name in self._needed(unknown)}
        return [name for name in self.inputs if name in used]

    def _needed(self, unknown: Any) -> list[str]:
        if unknown.dependencies is None:
            return self.inputs
        return [v.name for v in unknown.dependencies if v.causality == "input"]

    def expanded(self, values: Mapping[str, Value]) -> dict[str, float | str]:
        """Return values by variable, from numbers, lists for vectors, and names of choices.

        Raises
        ------
        SimulationError
            If there is no such variable, or the values do not fit it.
        """
        found: dict[str, float | str] = {}
        for name, value in values.items():
            elements = self.elements(name)
            parts: list[float | str] = (
                list(value) if isinstance(value, tuple | list) else [value] * len(elements)
            )
            if len(parts) != len(elements):
                raise SimulationError(
                    f"{self._fmu}: '{name}' has {len(elements)} element{'s'[: len(elements) > 1]}; "
                    f"{len(parts)} values are given."
                )
            found |= {e: self._checked(e, p) for e, p in zip(elements, parts, strict=True)}
        return found

    def _checked(self, name: str, value: float | str) -> float | str:
        """Return a start value as its variable's type takes it."""
        variable = self[name]
        if variable.type == "String":
            fits = isinstance(value, str)
        elif isinstance(value, str):
            return self._choice(name, value)
        elif variable.type == "Boolean" or isinstance(value, bool):
            fits = variable.type == "Boolean" and value in (0, 1)
        else:
            fits = variable.type == "Real" or float(value).is_integer()
        if not fits:
            raise SimulationError(
                f"{self._fmu}: '{name}' is of type {variable.type}; it cannot be {value!r}."
            )
        return value

    def _choice(self, name: str, value: str) -> int:
        """Return the value of a named choice.

        An Enumeration has them; an Integer's description may list them, as "1 = fourier, 2 = sine".
        """
        variable = self[name]
        declared = variable.declaredType
        items = {
            item.name: int(item.value) for item in (declared.items if declared else None) or ()
        }
        if variable.type == "Integer":
            items = {m[2]: int(m[1]) for m in _CHOICE.finditer(variable.description or "")}
        if value not in items:
            known = f"needed is one of {', '.join(items)}" if items else "it has no choices"
            raise SimulationError(f"{self._fmu}: '{name}' cannot be '{value}'; {known}.")
        return items[value]
