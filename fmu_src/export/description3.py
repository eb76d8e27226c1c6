"""Descriptions of FMI 3.0: the same interface, with arrays for numbered variables; terminals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree as ET

from fmu_src.export.description import (
    RUNNING_ROLES,
    STARTING_ROLES,
    Description,
    add_run,
    add_units,
    common_attributes,
    root_element,
    unit_attributes,
    values,
)
from fmu_src.export.interface import ArrayVariable, Interface, Role
from hesr_model.support.xml_files import to_bytes

_INDICATORS = "event_indicator"


_EXTENTS = """\
/* Generated: number of elements of the FMI 3.0 variable at an index, 0 within one. */
static const int extents[VARIABLES] = {{{}}};
"""


def to_extents(interface: Interface) -> str:
    """Return extents.h: number of elements of the variable that starts at an index, or 0."""
    extents = ["0"] * len(interface.variables)
    for array in interface.parts:
        extents[array.place] = str(len(array.elements))
    return _EXTENTS.format(", ".join(extents))


def to_xml3(interface: Interface, about: Description, token: str) -> bytes:
    """Return modelDescription.xml of FMI 3.0."""
    root = root_element(about, "3.0", {"instantiationToken": token})
    common = {
        "modelIdentifier": about.identifier,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": str(interface.directional_derivatives).lower(),
    }
    if interface.model_exchange:
        ET.SubElement(root, "ModelExchange", common, needsCompletedIntegratorStep="true")
    common |= {"canHandleVariableCommunicationStepSize": "true", "hasEventMode": "true"}
    early = str(interface.inner_steps).lower()
    ET.SubElement(root, "CoSimulation", common, mightReturnEarlyFromDoStep=early)
    add_units(root, interface)
    # fmi-sim reads units and nominal values from types only.
    types = ET.SubElement(root, "TypeDefinitions")
    kinds = ((variable.unit, variable.nominal) for variable in interface.variables if variable.unit)
    for unit, nominal in dict.fromkeys(kinds):
        element = ET.SubElement(types, "Float64Type", name=_name_type(unit, nominal), unit=unit)
        element.attrib.update(unit_attributes(unit))
        if nominal != 1.0:
            element.set("nominal", repr(nominal))
    add_run(root, about)
    variables = ET.SubElement(root, "ModelVariables")
    for array in interface.parts:
        variables.append(_variable(array, interface))
    time = {"name": "time", "valueReference": str(len(interface.variables))}
    time |= {"causality": "independent", "variability": "continuous"}
    ET.SubElement(variables, "Float64", time, description="simulation time")
    if interface.indicators and interface.model_exchange:
        about_signs = {"name": _INDICATORS, "valueReference": str(len(interface.variables) + 1)}
        about_signs |= {"causality": "local", "variability": "continuous", "initial": "calculated"}
        text = "positive while the signs that are held agree with the inputs"
        indicator = ET.SubElement(variables, "Float64", about_signs, description=text)
        ET.SubElement(indicator, "Dimension", start=str(interface.indicators))
    _structure(root, interface)
    return to_bytes(root)


def _name_type(unit: str, nominal: float) -> str:
    name = "number"
    if unit != "1":
        name += f" in {unit}"
    if nominal != 1.0:
        name += f" of about {nominal:g}"
    return name


def _variable(array: ArrayVariable, interface: Interface) -> ET.Element:
    first_variable = array.elements[0]
    text = first_variable.description
    if not first_variable.enumeration:
        text = _description(array)
    attributes = common_attributes(first_variable, array.name, array.place, text)
    attributes |= values(array.elements)
    if first_variable.enumeration or first_variable.integer:
        kind = "Int32"
    elif first_variable.boolean:
        kind = "Boolean"
    else:
        kind = "Float64"
        attributes["declaredType"] = _name_type(first_variable.unit or "1", first_variable.nominal)
    if first_variable.derivative_of:
        attributes["derivative"] = str(interface.part_of[first_variable.derivative_of].place)
    element = ET.Element(kind, attributes)
    for size in array.shape:
        ET.SubElement(element, "Dimension", start=str(size))
    return element


def _description(array: ArrayVariable) -> str:
    texts = [variable.description for variable in array.elements]
    if len(texts) == 1:
        return texts[0]
    words = [text.split(" ") for text in texts]
    if len({len(w) for w in words}) > 1:
        return "; ".join(texts)
    return " ".join(_column_text(column) for column in zip(*words, strict=True))


def _column_text(words: Sequence[str]) -> str:
    """Return one word, or a list of different words with the punctuation of the last one."""
    if len(set(words)) == 1:
        return words[0]
    stripped_words = [word.rstrip(":,") for word in words]
    return ", ".join(stripped_words) + words[-1][len(stripped_words[-1]) :]


def _structure(root: ET.Element, interface: Interface) -> None:
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [
        array for array in interface.parts if array.elements[0].role in ("output", "on_demand")
    ]
    rates: list[ArrayVariable] = []
    states: list[ArrayVariable] = []
    # States of a co-simulation are internal.
    if interface.model_exchange and interface.derivatives:
        parts = (interface.part_of[variable.name] for variable in interface.derivatives)
        rates = list(dict.fromkeys(parts))
        states = [array for array in interface.parts if array.elements[0].role == "state"]
    _unknowns(structure, "Output", outputs, interface, RUNNING_ROLES)
    _unknowns(structure, "ContinuousStateDerivative", rates, interface, RUNNING_ROLES)
    initial = dict.fromkeys((*outputs, *states, *rates))
    _unknowns(structure, "InitialUnknown", initial, interface, STARTING_ROLES, initially=True)
    if interface.indicators and interface.model_exchange:
        ET.SubElement(structure, "EventIndicator", valueReference=str(len(interface.variables) + 1))


def _unknowns(
    structure: ET.Element,
    kind: str,
    unknowns: Iterable[ArrayVariable],
    interface: Interface,
    roles: tuple[Role, ...],
    *,
    initially: bool = False,
) -> None:
    for array in unknowns:
        places: set[int] = set()
        for variable in array.elements:
            names = interface.find_dependencies(variable, roles, initially=initially)
            places |= {interface.part_of[name].place for name in names}
        attributes = {"valueReference": str(array.place)}
        ET.SubElement(structure, kind, attributes, dependencies=" ".join(map(str, sorted(places))))


def build_description(about: Description) -> bytes:
    """Return sources/buildDescription.xml."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=about.identifier)
    files = ET.SubElement(build, "SourceFileSet", language="C99")
    for source in about.sources:
        ET.SubElement(files, "SourceFile", name=source)
    return to_bytes(root)


TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
ICON = "terminalsAndIcons/icon.png"

Kind = Literal["signal", "inflow", "outflow"]
"""Kind of a member: a signal, or an inflow or outflow that sums to zero."""

_SIZE = "100"  # in the coordinates of the picture


@dataclass(frozen=True, kw_only=True)
class Terminal:
    """Connected variables, of one joint if they are scalars; `kind` may be a Modelica class."""

    name: str
    kind: str
    description: str
    members: Mapping[str, tuple[str, Kind]]


def to_terminals(
    interface: Interface, terminals: Sequence[Terminal], *, icon: bool
) -> bytes | None:
    """Return terminalsAndIcons.xml, or None if it would be empty."""
    if not terminals and not icon:
        return None
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    if icon:
        picture = ET.SubElement(root, "GraphicalRepresentation")
        place = {"x1": f"-{_SIZE}", "y1": f"-{_SIZE}", "x2": _SIZE, "y2": _SIZE}
        ET.SubElement(picture, "CoordinateSystem", place, suggestedScalingFactorTo_mm="0.1")
        ET.SubElement(picture, "Icon", place)
    if terminals:
        parent = ET.SubElement(root, "Terminals")
        names = [array.name for array in interface.parts]
        for terminal in terminals:
            first, _ = next(iter(terminal.members.values()))
            for name in names:
                if name.partition("[")[0] == first:
                    _add(parent, terminal, name.removeprefix(first))
    return to_bytes(root)


def _add(parent: ET.Element, terminal: Terminal, index: str) -> None:
    attributes = {
        "name": terminal.name + index,
        "matchingRule": "plug",
        "terminalKind": terminal.kind,
    }
    element = ET.SubElement(parent, "Terminal", attributes, description=terminal.description)
    for member, (variable, kind) in terminal.members.items():
        attributes = {"variableName": variable + index, "memberName": member, "variableKind": kind}
        ET.SubElement(element, "TerminalMemberVariable", attributes)
