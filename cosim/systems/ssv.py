"""Start values of a component as a parameter set of SSP."""

from importlib.metadata import version as installed
from xml.etree import ElementTree as ET

from cosim.systems.contents import SystemContents
from cosim.systems.markup import NAMESPACES, Version, add_units, to_bytes

PARAMETER_SET = "start"
"""Name of every component's set: libcosim and ecos apply sets of one name together."""


def to_ssv(contents: SystemContents, component: str, version: Version) -> bytes:
    """Return the start values of a component, with the units that its FMU defines."""
    start = contents.wiring.start[component]
    units = contents.units((component, variable) for variable in start)
    root = ET.Element(
        "ssv:ParameterSet",
        {key: NAMESPACES[key] for key in ("xmlns:ssc", "xmlns:ssv")},
        version=version,
        name=PARAMETER_SET,
        generationTool=f"HESR {installed('hesr')}",
        generationDateAndTime=contents.created,
    )
    parameters = ET.SubElement(root, "ssv:Parameters")
    for variable, value in start.items():
        kind = contents.type_of((component, variable))
        said = {"value": text_of(kind, value)} | contents.unit((component, variable), units)
        parameter = ET.SubElement(parameters, "ssv:Parameter", name=variable)
        ET.SubElement(parameter, f"ssv:{kind}", said)
    add_units(root, "ssv:Units", units)
    return to_bytes(root)


def text_of(kind: str, value: float | str) -> str:
    """Return a value as XML and JSON files have it, every digit of a number kept."""
    if kind == "String":
        return str(value)
    if kind == "Boolean":
        return "true" if value else "false"
    return repr(float(value)) if kind == "Real" else str(int(value))
