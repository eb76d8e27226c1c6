"""Start values of a component as a parameter set of SSP."""

from collections.abc import Mapping
from importlib.metadata import version as installed
from xml.etree import ElementTree as ET

from cosim.package.contents import SystemContents, type_of, unit_of, units_of
from cosim.package.markup import NAMESPACES, Version, add_units, to_bytes
from cosim.variables import Variables

PARAMETER_SET = "start"
"""Name of every component's set: libcosim and ecos apply sets of one name together."""


def to_ssv(contents: SystemContents, component: str, version: Version) -> bytes:
    """Return the start values of a component, with the units that its FMU defines."""
    variables, start = contents.variables[component], contents.wiring.start[component]
    return parameter_set(variables, start, contents.created, version)


def parameter_set(
    variables: Variables, values: Mapping[str, float | str], created: str, version: Version
) -> bytes:
    """Return values of an FMU's variables, with the units that it defines.

    Parameters
    ----------
    variables : of the FMU.
    values : by scalar variable, in its unit.
    created : date, ISO 8601.
    version : of the standard.
    """
    units = units_of((variables, name) for name in values)
    root = ET.Element(
        "ssv:ParameterSet",
        {key: NAMESPACES[key] for key in ("xmlns:ssc", "xmlns:ssv")},
        version=version,
        name=PARAMETER_SET,
        generationTool=f"HESR {installed('hesr')}",
        generationDateAndTime=created,
    )
    parameters = ET.SubElement(root, "ssv:Parameters")
    for variable, value in values.items():
        kind = type_of(variables, variable)
        said = {"value": text_of(kind, value)} | unit_of(variables, variable, units)
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
