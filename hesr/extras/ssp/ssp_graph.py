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
from hesr_model.findings import caution, log_findings
from hesr_model.support.ledger import find_close_names, format_suggestion
from hesr_model.support.text import quote

_NAME: TypeAdapter[str] = TypeAdapter(Name)


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """Map names of components to unique ones of allowed characters, numbered if they collide."""
    names = list(dict.fromkeys(names))
    unique_names = {name: name for name in names if _is_allowed(name)}
    used_names = set(unique_names)
    for name in names:
        if name in unique_names:
            continue
        cleaned = re.sub(r"[^0-9A-Za-z_]", "_", name)
        if not _is_allowed(cleaned):
            cleaned = f"_{cleaned}"
        numbered_names = (f"{cleaned}_{k}" for k in count(2))
        unique_names[name] = next(
            candidate
            for candidate in chain([cleaned], numbered_names)
            if candidate not in used_names
        )
        used_names.add(unique_names[name])
    return unique_names


def _is_allowed(name: str) -> bool:
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True


TRUE = ("true", "1")
FALSE = ("false", "0")

ElementPath = tuple[str, ...]  # names of elements from the root system on
ConnectorName = tuple[ElementPath, str]  # a connector
Unit = tuple[str, UnitExponents | None]
_EXPONENT_COUNT = len(SI) - 2
_RESULT_TYPES = {
    "Linear": ("Real",),
    "Boolean": ("Boolean",),
    "Enumeration": ("Integer", "Enumeration"),
    "Integer": ("Real", "Integer", "Enumeration"),
}
"""Types that transformations give; enumerations of FMI 3 are Integers here."""


@dataclass(frozen=True, kw_only=True)
class Transformation:
    """A linear transformation, or a table of texts."""

    kind: str
    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[str, Any] = field(default_factory=dict)  # targets by texts of sources

    def apply(self, value: Any, where: str) -> Any:
        """Return a transformed parameter; values outside the table keep theirs."""
        if self.kind == "Linear":
            try:
                return self.factor * value + self.offset
            except TypeError as error:
                sentence = f"{where}: its transformation does not fit {value!r}."
                raise ConfigError(sentence) from error
        text = str(value)
        if text in self.table:
            return self.table[text]
        if self.kind == "Enumeration":
            hint = format_suggestion(find_close_names(text, self.table))
            if hint:
                raise ConfigError(f"{where}: its transformation has no '{text}'; {hint}")
        return value


@dataclass(frozen=True, kw_only=True)
class Hop:
    """A connection to a connector."""

    target: ConnectorName
    suppressed: bool = False
    transformation: Transformation | None = None


@dataclass(frozen=True, kw_only=True)
class ParameterValue:
    """A value of a parameter set, its unit, and the transformation after its conversion."""

    value: Any
    unit: Unit | None = None
    transformation: Transformation | None = None
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
            raise ConfigError(
                f"'{format_connector(hop.target)}' is connected to "
                f"'{format_connector(self.find_source(hop.target))}' and to "
                f"'{format_connector(source)}'."
            )
        self.order[hop.target] = len(self.order)
        self.hops.setdefault(source, []).append(hop)

    def find_source(self, target: ConnectorName) -> ConnectorName:
        """Return the connector that gives a connected one its values."""
        for node, hops in self.hops.items():
            if any(hop.target == target for hop in hops):
                return node
        raise KeyError(target)

    def find_paths(
        self, node: ConnectorName, path: tuple[Hop, ...] = (), *, to_root: bool = False
    ) -> Iterator[tuple[Hop, ...]]:
        """Yield the ways from a connector to those of components, or of the whole system."""
        for hop in self.hops.get(node, ()):
            if hop in path:
                raise ConfigError(f"'{format_connector(node)}' is connected to itself.")
            extended_path = (*path, hop)
            has_arrived = hop.target[0] in self.variables
            if to_root:
                has_arrived = hop.target[0] == ()
            if has_arrived:
                yield extended_path
            elif hop.target[0] not in self.variables:
                yield from self.find_paths(hop.target, extended_path, to_root=to_root)

    def find_unit(self, node: ConnectorName) -> Unit | None:
        """Return the unit of a connector, that of the variable by default."""
        stated_unit = self.units.get(node)
        variables = self.variables.get(node[0])
        if variables is None:
            return stated_unit
        try:
            name, exponents = stated_unit or variables.unit(node[1])
            if variables.relative(node[1]):
                exponents = _remove_offset(exponents)
        except SimulationError:
            return stated_unit
        if name is None:
            return None
        return name, exponents

    def find_conversions(
        self, source: ConnectorName, path: Sequence[Hop], unit: Unit | None
    ) -> tuple[Conversion, ...]:
        """Return the conversions of a value in a unit along a way."""
        conversions: list[Conversion] = []
        for hop in path:
            where = f"connection '{format_connector(hop.target)}' = '{format_connector(source)}'"
            target_unit = self.find_unit(hop.target)
            if unit and target_unit and not hop.suppressed:
                conversions.append(find_conversion(unit, target_unit, where))
            unit = target_unit or unit
            if hop.transformation:
                conversions.append(
                    self._build_conversion(hop.transformation, source, path[-1].target, where)
                )
        return merge_conversions(conversions)

    def _build_conversion(
        self,
        transformation: Transformation,
        source: ConnectorName,
        target: ConnectorName,
        where: str,
    ) -> Conversion:
        kind = transformation.kind
        # An output of the whole system has the type that its transformation gives.
        if target[0]:
            target_type = self.variables[target[0]][target[1]].type
            if target_type not in _RESULT_TYPES.get(kind, ()):
                raise ConfigError(
                    f"{where}: its transformation does not fit the type {target_type}."
                )
        if kind == "Linear":
            return Conversion(factor=transformation.factor, offset=transformation.offset)
        table = dict[float, float]()
        for source_text, target_text in transformation.table.items():
            try:
                table[self._parse_number(kind, source_text, source)] = self._parse_number(
                    kind, target_text, target
                )
            except (ValueError, KeyError, AttributeError, SimulationError) as error:
                raise ConfigError(
                    f"{where}: the map entry '{source_text}' = '{target_text}' does not fit "
                    "the connectors."
                ) from error
        return Conversion(table=table)

    def _parse_number(self, kind: str, text: Any, end: ConnectorName) -> float:
        if kind == "Boolean":
            return float(str(text) == "True")
        if kind == "Integer":
            return float(int(text))
        items = self.variables[end[0]][end[1]].declaredType.items
        return float({item.name: item.value for item in items}[text])


def _remove_offset(exponents: UnitExponents | None) -> UnitExponents | None:
    return exponents and (*exponents[:-1], 0.0)


def convert_to_unit(variables: Variables, name: str, value: float, unit: Unit, where: str) -> float:
    """Return a number in the unit of an FMU's variable; unchanged if that has none."""
    variable_unit, exponents = variables.unit(name)
    if variables.relative(name):  # FMI: offsets do not apply to differences
        unit, exponents = (unit[0], _remove_offset(unit[1])), _remove_offset(exponents)
    if variable_unit is None:
        return value
    return find_conversion(unit, (variable_unit, exponents), where)(value)


def find_conversion(unit: Unit, target_unit: Unit, where: str) -> Conversion:
    """Return the conversion between two units; raise ConfigError if they differ in kind."""
    if unit[0] == target_unit[0] or unit[1] == target_unit[1] is not None:
        return Conversion()
    undefined = [name for name, base in (unit, target_unit) if base is None]
    if undefined:
        observation = f"the unit {quote(undefined[0])} is not defined, so that its values stay"
        remedy = "define it in SI base units if it is another one"
        log_findings(
            [caution(check="undefined-unit", where=where, found=observation, remedy=remedy)]
        )
        return Conversion()
    source_base = unit[1]
    target_base = target_unit[1]
    have_same_base = (
        source_base
        and target_base
        and source_base[:_EXPONENT_COUNT] == target_base[:_EXPONENT_COUNT]
    )
    if not (
        source_base
        and target_base
        and have_same_base
        and target_base[_EXPONENT_COUNT]
        and isfinite(source_base[_EXPONENT_COUNT])
    ):
        raise ConfigError(
            f"{where}: {unit[0]} cannot be converted into {target_unit[0]}; define both in SI "
            "base units."
        )
    source_factor = source_base[_EXPONENT_COUNT]
    target_factor = target_base[_EXPONENT_COUNT]
    return Conversion(
        factor=source_factor / target_factor,
        offset=(source_base[-1] - target_base[-1]) / target_factor,
    )


def merge_conversions(conversions: Sequence[Conversion]) -> tuple[Conversion, ...]:
    """Join linear conversions that follow each other, and drop those without effect."""
    joined: list[Conversion] = []
    for conversion in conversions:
        if joined and not conversion.table and not joined[-1].table:
            previous = joined.pop()
            conversion = Conversion(
                factor=previous.factor * conversion.factor,
                offset=conversion.factor * previous.offset + conversion.offset,
            )
        if conversion != Conversion():
            joined.append(conversion)
    return tuple(joined)


def format_connector(node: ConnectorName) -> str:
    """Return a connector in messages."""
    return ".".join((*node[0], node[1]))


def read_number(node: ET.Element, name: str, default: float, where: str) -> float:
    """Return a number in an attribute; raise ConfigError for other text."""
    text = node.get(name)
    if text is None:
        return default
    try:
        parsed_number = parse_float(text)
    except ValueError:
        parsed_number = nan
    if not isfinite(parsed_number):
        raise ConfigError(f"{where}: {name} is '{text}'; it must be a number.")
    return parsed_number


def parse_float(text: str) -> float:
    """Return a number; raise ValueError for what Python reads as one, but not XML."""
    _require_xml_digits(text)
    return float(text)


def parse_integer(text: str) -> int:
    """Return an integer; raise ValueError for what Python reads as one, but not XML."""
    _require_xml_digits(text)
    return int(text)


def _require_xml_digits(text: str) -> None:
    if "_" in text or not text.isascii():
        raise ValueError(text)


def read_boolean(text: str, where: str) -> bool:
    """Return a Boolean, in any case of letters; raise ConfigError for other text."""
    word = text.strip().lower()
    if word not in (*TRUE, *FALSE):
        raise ConfigError(f"{where} is '{text}'; write true or false.")
    return word in TRUE


def suggest(name: str, candidates: Iterable[str], default: str) -> str:
    """Return the end of a refusal: names that may have been meant, or a default."""
    return format_suggestion(find_close_names(name, candidates)) or f"{default}."


def read_transformation(node: ET.Element, where: str) -> Transformation | None:
    """Return the transformation in a connection or mapping, if any."""
    for child in node:
        kind, marker, _ = child.tag.rpartition("}")[2].partition("Transformation")
        if marker:
            kind = kind.removesuffix("Mapping")
            return Transformation(
                kind=kind,
                factor=read_number(child, "factor", 1.0, where),
                offset=read_number(child, "offset", 0.0, where),
                table=dict(
                    _read_entry(entry, kind, where) for entry in child.findall("{*}MapEntry")
                ),
            )
    return None


def _read_entry(entry: ET.Element, kind: str, where: str) -> tuple[str, Any]:
    """Return the source of a map entry as Python writes it, and its target."""
    source = entry.get("source")
    target = entry.get("target")
    where = f"{where}: the map entry '{source}' = '{target}'"
    if source is None or target is None:
        raise ConfigError(f"{where} needs a source and a target.")
    if kind == "Boolean":
        return (
            str(read_boolean(source, f"{where}: source")),
            read_boolean(target, f"{where}: target"),
        )
    if kind == "Integer":
        try:
            return str(parse_integer(source)), parse_integer(target)
        except ValueError as error:
            raise ConfigError(f"{where} needs two integers.") from error
    return source, target
