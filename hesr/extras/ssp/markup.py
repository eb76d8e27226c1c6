"""XML of systems: namespaces, values and units."""

from collections.abc import Iterable, Mapping
from typing import Literal
from xml.etree import ElementTree as ET

from fmu_src.run.variables import SI
from hesr.extras.ssp.contents import UnitExponents
from hesr_model.errors import ConfigError

SSD = "SystemStructure.ssd"
Version = Literal["1.0", "2.0"]  # SSP standard; the parts used here are equal

_STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"

# Engines look for these prefixes, not for the namespaces.
NAMESPACES = {
    "xmlns:ssc": f"{_STANDARD}Common",
    "xmlns:ssd": f"{_STANDARD}Description",
    "xmlns:ssv": f"{_STANDARD}ParameterValues",
}

_DEFAULTS = {key: 1.0 if key == "factor" else 0.0 for key in SI}


def text_of(kind: str, value: float | str) -> str:
    """Return a value as in XML and JSON files, with all digits."""
    if kind == "String":
        return str(value)
    if kind == "Boolean":
        return "true" if value else "false"
    return repr(float(value)) if kind == "Real" else str(int(value))


def add_units(
    parent: ET.Element, tag: str, units: Mapping[str, UnitExponents], prefix: str = "ssc:"
) -> None:
    """Add the definitions of units, if any; those of FMI have no prefix."""
    if not units:
        return
    definitions = ET.SubElement(parent, tag)
    for name, base in units.items():
        said = {
            key: repr(float(value)) if key in ("factor", "offset") else str(int(value))
            for key, value in zip(SI, base, strict=True)
            if float(value) != _DEFAULTS[key]
        }
        unit = ET.SubElement(definitions, f"{prefix}Unit", name=name)
        ET.SubElement(unit, f"{prefix}BaseUnit", said)


def read_units(nodes: Iterable[ET.Element], where: str) -> dict[str, UnitExponents]:
    """Return the units defined by `ssc:Unit` elements; `where` is for messages."""
    found: dict[str, UnitExponents] = {}
    for node in nodes:
        name, base = node.get("name", ""), node.find("{*}BaseUnit")
        said = {} if base is None else base.attrib
        numbers = dict(_DEFAULTS)
        for key in (key for key in SI if key in said):
            try:
                numbers[key] = float(said[key])
            except ValueError as error:
                raise ConfigError(
                    f"{where}: {key} of unit '{name}' is '{said[key]}'; it must be a number."
                ) from error
        if base is not None:
            found[name] = tuple(numbers.values())
    return found
