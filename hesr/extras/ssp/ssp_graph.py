"""Connectors of nested systems in an SSP: sources, conversions, parameters, names."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from math import isfinite, nan
from typing import Any
from xml.etree import ElementTree as ET

from pydantic import TypeAdapter, ValidationError

from cosim.systems.system import Conversion, Name
from fmu_src.run.variables import SI, Variables
from hesr.extras.ssp.contents import UnitExponents
from hesr_model.errors import ConfigError, SimulationError

_NAME: TypeAdapter[str] = TypeAdapter(Name)


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """Map names of components to unique ones of allowed characters, numbered if they collide."""
    names = list(dict.fromkeys(names))
    found = {name: name for name in names if _allowed(name)}
    taken = set(found)
    for name in names:
        if name in found:
            continue
        plain = re.sub(r"[^0-9A-Za-z_]", "_", name)
        plain = plain if _allowed(plain) else f"_{plain}"
        numbered = (f"{plain}_{k}" for k in count(2))
        found[name] = next(n for n in chain([plain], numbered) if n not in taken)
        taken.add(found[name])
    return found


def _allowed(name: str) -> bool:
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True


TRUE = ("true", "1")

ElementPath = tuple[str, ...]  # names of elements from the root system on
ConnectorName = tuple[ElementPath, str]  # a connector
Unit = tuple[str, UnitExponents | None]
_EXPONENTS = len(SI) - 2
_TAKEN = {"Linear": ("Real",), "Boolean": ("Boolean",), "Enumeration": ("Integer", "Enumeration")}
_TAKEN |= {"Integer": ("Real", "Integer", "Enumeration")}  # FMI 3: Enumerations are Integers here
"""Types that transformations give."""


@dataclass(frozen=True, kw_only=True)
class Transformation:
    """A linear transformation, or a table of texts."""

    kind: str
    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[str, Any] = field(default_factory=dict)  # targets by texts of sources

    def applied(self, value: Any, where: str) -> Any:
        """Return a transformed parameter; values outside the table keep theirs."""
        try:
            if self.kind == "Linear":
                return self.factor * value + self.offset
            found = self.table[str(value)]
            return found if self.kind in ("Boolean", "Enumeration") else int(found)
        except KeyError:
            return value
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{where}: its transformation does not fit {value!r}.") from error


@dataclass(frozen=True, kw_only=True)
class Hop:
    """A connection to a connector."""

    target: ConnectorName
    suppressed: bool = False
    transformation: Transformation | None = None


@dataclass(frozen=True, kw_only=True)
class ParameterValue:
    """A value of a parameter set, its unit, and what follows its conversion."""

    value: Any
    unit: Unit | None = None
    after: Transformation | None = None
    suppressed: bool = False


@dataclass(kw_only=True)
class ConnectorGraph:
    """Connectors with their units, FMUs of components, and connections by source."""

    units: dict[ConnectorName, Unit | None] = field(default_factory=dict)
    kinds: dict[ConnectorName, str] = field(default_factory=dict)
    variables: dict[ElementPath, Variables] = field(default_factory=dict)
    hops: dict[ConnectorName, list[Hop]] = field(default_factory=dict)
    order: dict[ConnectorName, int] = field(default_factory=dict)  # in the file

    def add(self, source: ConnectorName, hop: Hop) -> None:
        """Add a connection; raise ConfigError if its target is connected already."""
        if hop.target in self.order:
            others = (n for n, hops in self.hops.items() for h in hops if h.target == hop.target)
            raise ConfigError(
                f"'{shown(hop.target)}' is connected to '{shown(next(others))}' and to "
                f"'{shown(source)}'."
            )
        self.order[hop.target] = len(self.order)
        self.hops.setdefault(source, []).append(hop)

    def ends(self, node: ConnectorName, way: tuple[Hop, ...] = ()) -> Iterator[tuple[Hop, ...]]:
        """Yield the ways from a connector to connectors of components."""
        for hop in self.hops.get(node, ()):
            if hop in way:
                raise ConfigError(f"'{shown(node)}' is connected to itself.")
            whole = (*way, hop)
            if hop.target[0] in self.variables:
                yield whole
            else:
                yield from self.ends(hop.target, whole)

    def unit(self, node: ConnectorName) -> Unit | None:
        """Return the unit of a connector, that of the variable by default."""
        own = self.units.get(node)
        variables = self.variables.get(node[0])
        if variables is None:
            return own
        try:
            name, base = own or variables.unit(node[1])
            base = _without_offset(base) if variables.relative(node[1]) else base
        except SimulationError:
            return own
        return None if name is None else (name, base)

    def conversions(
        self, source: ConnectorName, way: Sequence[Hop], unit: Unit | None
    ) -> tuple[Conversion, ...]:
        """Return the conversions of a value in a unit along a way."""
        found: list[Conversion] = []
        for hop in way:
            where = f"connection '{shown(hop.target)}' = '{shown(source)}'"
            into = self.unit(hop.target)
            if unit and into and not hop.suppressed:
                found.append(between(unit, into, where))
            unit = into or unit
            if hop.transformation:
                found.append(self._of_values(hop.transformation, source, way[-1].target, where))
        return merged(found)

    def _of_values(
        self,
        transformation: Transformation,
        source: ConnectorName,
        target: ConnectorName,
        where: str,
    ) -> Conversion:
        kind = transformation.kind
        into = self.variables[target[0]][target[1]].type
        if into not in _TAKEN.get(kind, ()):
            raise ConfigError(f"{where}: its transformation does not fit the type {into}.")
        if kind == "Linear":
            return Conversion(factor=transformation.factor, offset=transformation.offset)
        table = dict[float, float]()
        for before, after in transformation.table.items():
            try:
                table[self._number(kind, before, source)] = self._number(kind, after, target)
            except (ValueError, KeyError, AttributeError, SimulationError) as error:
                raise ConfigError(
                    f"{where}: the map entry '{before}' = '{after}' does not fit the connectors."
                ) from error
        return Conversion(table=table)

    def _number(self, kind: str, text: Any, end: ConnectorName) -> float:
        if kind == "Boolean":
            return float(str(text) == "True")
        if kind == "Integer":
            return float(int(text))
        items = self.variables[end[0]][end[1]].declaredType.items
        return float({item.name: item.value for item in items}[text])


def _without_offset(base: UnitExponents | None) -> UnitExponents | None:
    return base and (*base[:-1], 0.0)


def convert_to_unit(variables: Variables, name: str, value: float, unit: Unit, where: str) -> float:
    """Return a number in the unit of an FMU's variable; unchanged if that has none."""
    own, base = variables.unit(name)
    if variables.relative(name):  # FMI: offsets do not apply to differences
        unit, base = (unit[0], _without_offset(unit[1])), _without_offset(base)
    return value if own is None else between(unit, (own, base), where)(value)


def between(unit: Unit, into: Unit, where: str) -> Conversion:
    """Return the conversion between two units; raise ConfigError if they differ in kind."""
    if unit[0] == into[0] or unit[1] == into[1] is not None:
        return Conversion()
    one = unit[1]
    other = into[1]
    alike = one and other and one[:_EXPONENTS] == other[:_EXPONENTS]
    if not (one and other and alike and other[_EXPONENTS] and isfinite(one[_EXPONENTS])):
        raise ConfigError(
            f"{where}: {unit[0]} cannot be converted into {into[0]}; define both in SI base units."
        )
    factor = one[_EXPONENTS]
    size = other[_EXPONENTS]
    return Conversion(factor=factor / size, offset=(one[-1] - other[-1]) / size)


def merged(conversions: Sequence[Conversion]) -> tuple[Conversion, ...]:
    """Join linear conversions that follow each other, and drop those without effect."""
    found: list[Conversion] = []
    for one in conversions:
        if found and not one.table and not found[-1].table:
            last = found.pop()
            one = Conversion(
                factor=last.factor * one.factor, offset=one.factor * last.offset + one.offset
            )
        if one != Conversion():
            found.append(one)
    return tuple(found)


def shown(node: ConnectorName) -> str:
    """Return a connector in messages."""
    return ".".join((*node[0], node[1]))


def number(node: ET.Element, name: str, default: float, where: str) -> float:
    """Return a number in an attribute; raise ConfigError for other text."""
    text = node.get(name)
    try:
        found = default if text is None else float(text)
    except ValueError:
        found = nan
    if not isfinite(found):
        raise ConfigError(f"{where}: {name} is '{text}'; it must be a number.")
    return found


def transformation_of(node: ET.Element, where: str) -> Transformation | None:
    """Return the transformation in a connection or mapping, if any."""
    for child in node:
        kind, found, _ = child.tag.rpartition("}")[2].partition("Transformation")
        if found:
            kind = kind.removesuffix("Mapping")
            table: dict[str, Any] = {e.get("source", ""): e.get("target", "") for e in child}
            if kind == "Boolean":
                table = {str(s in TRUE): t in TRUE for s, t in table.items()}
            return Transformation(
                kind=kind,
                factor=number(child, "factor", 1.0, where),
                offset=number(child, "offset", 0.0, where),
                table=table,
            )
    return None
