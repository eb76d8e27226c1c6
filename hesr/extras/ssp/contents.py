"""Contents of a packaged system, checked against its FMUs, and the XML of their units."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree as ET

from cosim.systems.system import SystemSpec
from cosim.systems.wiring import Wiring
from fmu_src.export.description import RELEASE_DATE
from fmu_src.run.master import Element
from fmu_src.run.variables import SI, Variables, model_description
from hesr_model.errors import ConfigError, SimulationError

_FIRST_DATE = datetime(1980, 1, 1, tzinfo=UTC)
_LAST_DATE = datetime(2107, 12, 31, tzinfo=UTC)  # range of zip archives

UnitExponents = tuple[float, ...]  # exponents of `fmu_src.run.variables.SI`


@dataclass(frozen=True, kw_only=True, eq=False)
class SystemContents:
    """A system and the descriptions of its FMUs."""

    system: SystemSpec
    path: Path  # file for messages
    descriptions: Mapping[str, Any]
    variables: Mapping[str, Variables]
    wiring: Wiring
    created: str  # newest FMU, ISO 8601 in UTC with a final Z

    @property
    def used_outputs(self) -> list[Element]:
        """Connected or observed outputs, in the order of the components."""
        referenced = {*self.wiring.sources.values(), *self.wiring.observed}
        used_outputs = []
        for name, variables in self.variables.items():
            outputs = [(name, output) for output in variables.feedthrough]
            used_outputs += [output for output in outputs if output in referenced]
        return used_outputs

    def units(self, elements: Iterable[Element]) -> dict[str, UnitExponents]:
        """Return the defined units of variables by name; the first one if definitions differ."""
        units_by_name: dict[str, UnitExponents] = {}
        for name, variable in elements:
            unit, exponents = self.variables[name].unit(variable)
            if unit and exponents is not None:
                units_by_name.setdefault(unit, exponents)
        return units_by_name

    def unit(self, element: Element, defined: Mapping[str, UnitExponents]) -> dict[str, str]:
        """Return the XML attribute of a variable's unit, if defined."""
        name, variable = element
        unit, exponents = self.variables[name].unit(variable)
        is_defined = unit and exponents is not None and defined.get(unit) == exponents
        if not is_defined or self.find_type(element) != "Real":
            return {}
        return {"unit": str(unit)}

    def find_type(self, element: Element) -> str:
        """Return the type of a variable; Integer for an Enumeration, which libcosim refuses."""
        kind = self.variables[element[0]][element[1]].type
        if kind == "Enumeration":
            return "Integer"
        return str(kind)


def read_contents(system: SystemSpec, path: Path) -> SystemContents:
    """Read the descriptions of a system's FMUs and check the system against them; see `Wiring`."""
    descriptions = {
        component.name: read_description(component.fmu, f"{path}: component '{component.name}'")
        for component in system.components
    }
    variables = {
        component.name: Variables(component.fmu, descriptions[component.name])
        for component in system.components
    }
    for target in (target for target, conversions in system.conversions.items() if conversions):
        raise ConfigError(f"{path}: connection of '{target}': a conversion cannot be exported.")
    if system.begin:
        raise ConfigError(f"{path}: starts at {system.begin:g} s; exports start at 0.")
    return SystemContents(
        system=system,
        path=path,
        descriptions=descriptions,
        variables=variables,
        wiring=Wiring(system, variables, path),
        created=_find_newest_date(
            description.generationDateAndTime for description in descriptions.values()
        ),
    )


def read_description(fmu: Path, where: str) -> Any:
    """Return FMPy's description of an FMI 2.0 FMU for co-simulation; `where` is for messages."""
    if not fmu.is_file():
        raise ConfigError(f"{where}: there is no FMU {fmu}.")
    try:
        description = model_description(fmu)
    except SimulationError as error:
        raise SimulationError(f"{where}: {error}") from error
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        raise ConfigError(f"{where}: {fmu} is not an FMI 2.0 FMU for co-simulation.")
    return description


def _find_newest_date(dates: Iterable[str | None]) -> str:
    valid_dates = []
    for text in dates:
        try:
            # Tools write fractions of seconds of any length.
            date = datetime.fromisoformat(re.sub(r"\.\d+", "", text or ""))
        except ValueError:
            continue
        if date.tzinfo is None:
            date = date.replace(tzinfo=UTC)
        valid_dates.append(date)
    newest = max(valid_dates, default=datetime.fromisoformat(RELEASE_DATE))
    return min(max(newest, _FIRST_DATE), _LAST_DATE).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


SSD = "SystemStructure.ssd"
Version = Literal["1.0", "2.0"]  # SSP standard; the parts used here are equal

_STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"

COUPLING_ANNOTATION = "hesr.coupling"
"""Type of the annotation with the order of the coupling, which SSP does not define."""
COUPLING = "urn:hesr:coupling:1"

# Engines look for these prefixes, not for the namespaces.
NAMESPACES = {
    "xmlns:ssc": f"{_STANDARD}Common",
    "xmlns:ssd": f"{_STANDARD}Description",
    "xmlns:ssv": f"{_STANDARD}ParameterValues",
}

UNIT_DEFAULTS = dict.fromkeys(SI, 0.0) | {"factor": 1.0}


def format_value(kind: str, value: float | str) -> str:
    """Return a value as in XML files, with all digits."""
    if kind == "String":
        return str(value)
    if kind == "Boolean":
        return str(bool(value)).lower()
    if kind == "Real":
        return repr(float(value))
    return str(int(value))


_UNIT_TYPES = {"factor": "Real", "offset": "Real"}  # others are exponents


def add_units(parent: ET.Element, tag: str, units: Mapping[str, UnitExponents]) -> None:
    """Add the definitions of units, if any."""
    if not units:
        return
    definitions = ET.SubElement(parent, tag)
    for name, exponents in units.items():
        attributes = {}
        for key, value in zip(SI, exponents, strict=True):
            if float(value) != UNIT_DEFAULTS[key]:
                kind = _UNIT_TYPES.get(key, "Integer")
                attributes[key] = format_value(kind, value)
        unit = ET.SubElement(definitions, "ssc:Unit", name=name)
        ET.SubElement(unit, "ssc:BaseUnit", attributes)


def build_parameter_set(
    values: Iterable[tuple[str, str, dict[str, str]]],
    units: Mapping[str, UnitExponents],
    root_attributes: dict[str, str],
) -> ET.Element:
    """Return `ssv:ParameterSet` of values, with `root_attributes` on its root."""
    namespaces = {key: NAMESPACES[key] for key in ("xmlns:ssc", "xmlns:ssv")}
    root = ET.Element("ssv:ParameterSet", namespaces | root_attributes)
    parameters = ET.SubElement(root, "ssv:Parameters")
    for name, kind, attributes in values:
        parameter = ET.SubElement(parameters, "ssv:Parameter", name=name)
        ET.SubElement(parameter, f"ssv:{kind}", attributes)
    add_units(root, "ssv:Units", units)
    return root


def read_units(nodes: Iterable[ET.Element], where: str) -> dict[str, UnitExponents]:
    """Return the units defined by `ssc:Unit` elements; `where` is for messages."""
    units: dict[str, UnitExponents] = {}
    for node in nodes:
        name = node.get("name", "")
        base_node = node.find("{*}BaseUnit")
        if base_node is None:
            continue
        attributes = base_node.attrib
        numbers = dict(UNIT_DEFAULTS)
        for key in (key for key in SI if key in attributes):
            try:
                numbers[key] = float(attributes[key])
            except ValueError as error:
                raise ConfigError(
                    f"{where}: {key} of unit '{name}' is '{attributes[key]}'; it must be a number."
                ) from error
        units[name] = tuple(numbers.values())
    return units
