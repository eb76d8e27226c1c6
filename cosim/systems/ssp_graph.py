"""Connectors of nested systems in an SSP: sources of inputs, conversions, targets of parameters."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree as ET

from cosim.systems.contents import UnitExponents
from cosim.systems.system import Conversion
from fmu_src.run.variables import SI, Variables
from hesr_model.errors import ConfigError, SimulationError

ElementPath = tuple[str, ...]  # names of elements from the root system on
ConnectorName = tuple[ElementPath, str]  # a connector
Unit = tuple[str, UnitExponents | None]
_EXPONENTS = len(SI) - 2


@dataclass(frozen=True, kw_only=True)
class Transformation:
    """A linear transformation, or a table of texts."""

    kind: str
    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[str, str] = field(default_factory=dict)

    def applied(self, value: Any) -> Any:
        """Return a transformed parameter; values outside the table keep theirs."""
        if self.kind == "Linear":
            return self.factor * value + self.offset
        text = str(value).lower() if isinstance(value, bool) else str(value)
        if text not in self.table:
            return value
        found = self.table[text]
        if self.kind == "Boolean":
            return found in ("true", "1")
        return found if self.kind == "Enumeration" else int(found)


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
        if own is not None or node[0] not in self.variables:
            return own
        try:
            name, base = self.variables[node[0]].unit(node[1])
        except SimulationError:
            return None
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
        if transformation.kind == "Linear":
            return Conversion(factor=transformation.factor, offset=transformation.offset)
        table, kind = dict[float, float](), transformation.kind
        for before, after in transformation.table.items():
            try:
                table[self._number(kind, before, source)] = self._number(kind, after, target)
            except (ValueError, KeyError, AttributeError, SimulationError) as error:
                raise ConfigError(
                    f"{where}: the map entry '{before}' = '{after}' does not fit the connectors."
                ) from error
        return Conversion(table=table)

    def _number(self, kind: str, text: str, end: ConnectorName) -> float:
        if kind == "Boolean":
            return float(text in ("true", "1"))
        if kind == "Integer":
            return float(int(text))
        items = self.variables[end[0]][end[1]].declaredType.items
        return float({item.name: item.value for item in items}[text])


def between(unit: Unit, into: Unit, where: str) -> Conversion:
    """Return the conversion between two units; raise ConfigError if they differ in kind."""
    if unit[0] == into[0] or unit[1] == into[1] is not None:
        return Conversion()
    one, other = unit[1], into[1]
    if one is None or other is None or one[:_EXPONENTS] != other[:_EXPONENTS]:
        raise ConfigError(
            f"{where}: the input is in {into[0]}, the output in {unit[0]}, which cannot be "
            "converted; define both in SI base units."
        )
    factor, size = one[_EXPONENTS], other[_EXPONENTS]
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
        return default if text is None else float(text)
    except ValueError as error:
        raise ConfigError(f"{where}: {name} is '{text}'; it must be a number.") from error


def transformation_of(node: ET.Element, where: str) -> Transformation | None:
    """Return the transformation in a connection or mapping, if any."""
    for child in node:
        kind, found, _ = child.tag.rpartition("}")[2].partition("Transformation")
        if found:
            kind = kind.removesuffix("Mapping")
            return Transformation(
                kind=kind,
                factor=number(child, "factor", 1.0, where),
                offset=number(child, "offset", 0.0, where),
                table={e.get("source", ""): e.get("target", "") for e in child},
            )
    return None
