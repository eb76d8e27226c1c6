"""What the XML files of an SSP share: namespaces, units, and how they are written."""

from collections.abc import Mapping
from typing import Literal
from xml.etree import ElementTree as ET

from cosim.systems.contents import Unit
from fmu_src.run.variables import SI

Version = Literal["1.0", "2.0"]
"""Of the SSP standard; 2.0 kept the namespaces, and all that is used here, of 1.0."""

_STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"

# Engines look for these very prefixes, not for the namespaces.
NAMESPACES = {
    "xmlns:ssc": f"{_STANDARD}Common",
    "xmlns:ssd": f"{_STANDARD}Description",
    "xmlns:ssv": f"{_STANDARD}ParameterValues",
}

_WITHOUT = {key: 1.0 if key == "factor" else 0.0 for key in SI}


def add_units(
    parent: ET.Element, tag: str, units: Mapping[str, Unit], prefix: str = "ssc:"
) -> None:
    """Add the definitions of units, where there are any; FMI has them alike, without prefix."""
    if not units:
        return
    definitions = ET.SubElement(parent, tag)
    for name, base in units.items():
        said = {
            key: repr(float(value)) if key in ("factor", "offset") else str(int(value))
            for key, value in zip(SI, base, strict=True)
            if float(value) != _WITHOUT[key]
        }
        unit = ET.SubElement(definitions, f"{prefix}Unit", name=name)
        ET.SubElement(unit, f"{prefix}BaseUnit", said)


def to_bytes(root: ET.Element) -> bytes:
    """Return the text of an XML file."""
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"
