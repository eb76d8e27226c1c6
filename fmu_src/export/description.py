"""modelDescription.xml of an FMU, from its interface."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from xml.etree import ElementTree as ET

from fmu_src.export.interface import Interface, Role, Variable
from hesr_model.errors import ExportError
from hesr_model.support.owner import Owner
from hesr_model.support.xml_files import to_bytes

# Exponents of FMI's base units for the unit names of HESR.
_BASE: Mapping[str, Mapping[str, int]] = {
    "1": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "degC": {"K": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
}
QUANTITIES: Mapping[str, str] = {
    "rad": "Angle",
    "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration",
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "N.m": "Torque",
    "N": "Force",
    "W": "Power",
    "s": "Time",
    "kg": "Mass",
    "degC": "ThermodynamicTemperature",
    "kg.m2": "MomentOfInertia",
    "N.m/rad": "RotationalSpringConstant",
    "N.m.s/rad": "RotationalDampingConstant",
    "N/m": "TranslationalSpringConstant",
    "N.s/m": "TranslationalDampingConstant",
}
"""Quantity names by unit, as in Modelica.Units.SI."""

DISPLAY: Mapping[str, str] = {"rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2"}

RELEASE_DATE = "2026-11-22T00:00:00Z"
"""Date of this version, and of FMUs without newer content; the same as in CITATION.cff."""

OFFSETS: Mapping[str, float] = {"degC": 273.15}  # offset of a unit in SI, if not zero

DEGREES = 180.0 / math.pi
_EXPERIMENT_STEPS = 1000

_KINDS: Mapping[str, dict[str, str]] = {
    "ModelExchange": {"completedIntegratorStepNotNeeded": "false"},
    "CoSimulation": {
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "0",
        "canRunAsynchronuously": "false",
    },
}

RUNNING_ROLES: tuple[Role, ...] = ("input", "state")
STARTING_ROLES: tuple[Role, ...] = ("input", "fixed", "tunable")
"""Roles of the knowns of unknowns, during simulation and at initialisation."""

_FACTOR = re.compile(r"([A-Za-z]+|1)(-?[0-9]+)?")


CATEGORIES: Mapping[str, str] = {
    "logEvents": "initialisation, end and, in model exchange, changes of sign",
    "logStatusDiscard": "why a call was refused; the simulation can continue",
    "logStatusError": "why a call failed",
    "logAll": "all of these",
}


@dataclass(frozen=True, kw_only=True)
class Description:
    """Model description of an FMU apart from its variables.

    The C identifier is the name of the binaries; `created` is ISO 8601 in UTC with a final Z; the
    step is in s. `sources` are compiled from sources/, none if they need a library.
    """

    name: str
    identifier: str
    text: str
    version: str = field(default_factory=lambda: version("hesr"))
    created: str
    step: float
    sources: tuple[str, ...] = ("all.c",)
    owner: Owner = field(default_factory=Owner)

    @property
    def experiment(self) -> dict[str, str]:
        """Start and stop time of the default experiment [s]: a thousand preferred steps."""
        times = {"stopTime": _EXPERIMENT_STEPS * self.step, "stepSize": self.step}
        return {"startTime": "0"} | {name: f"{value:.12g}" for name, value in times.items()}


def unit_attributes(unit: str) -> dict[str, str]:
    """Return the attributes for the quantity and the display unit of a unit."""
    attributes = {"quantity": QUANTITIES.get(unit), "displayUnit": DISPLAY.get(unit)}
    return {name: text for name, text in attributes.items() if text}


def si_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of kg, m, s, A, K and rad of a unit; all after its slash divides."""
    exponents: dict[str, int] = {}
    for i, group in enumerate(unit.split("/")):
        for factor in group.removeprefix("(").removesuffix(")").split("."):
            match = _FACTOR.fullmatch(factor)
            if match is None or match[1] not in _BASE:
                raise ExportError(
                    f"unit '{unit}': '{factor}' is unknown; known are {', '.join(_BASE)}."
                )
            power = int(match[2] or 1)
            if i > 0:
                power = -power
            for base, exponent in _BASE[match[1]].items():
                exponents[base] = exponents.get(base, 0) + power * exponent
    return {base: exponent for base, exponent in exponents.items() if exponent}


def to_xml(interface: Interface, about: Description, guid: str) -> bytes:
    """Return modelDescription.xml.

    Dependencies are declared, because importers find false algebraic loops without them.
    """
    indicators = str(interface.indicators)
    root = root_element(about, "2.0", {"guid": guid}, numberOfEventIndicators=indicators)
    _add_kinds(root, interface, about)
    add_units(root, interface)
    _types(root, interface)
    add_run(root, about)
    variables = ET.SubElement(root, "ModelVariables")
    for i, variable in enumerate(interface.variables):
        variables.append(_scalar(variable, i, interface))
    _add_structure(root, interface)
    return to_bytes(root)


def _add_kinds(root: ET.Element, interface: Interface, about: Description) -> None:
    """Add the kinds of simulation with their capabilities and source files."""
    common = {
        "modelIdentifier": about.identifier,
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": str(interface.directional_derivatives).lower(),
    }
    for name, kind_attributes in _KINDS.items():
        if name == "CoSimulation" or interface.model_exchange:
            kind = ET.SubElement(root, name, common | kind_attributes)
            if about.sources:
                files = ET.SubElement(kind, "SourceFiles")
                for source in about.sources:
                    ET.SubElement(files, "File", name=source)


def _add_structure(root: ET.Element, interface: Interface) -> None:
    """Add outputs, derivatives and initial unknowns with what they depend on."""
    structure = ET.SubElement(root, "ModelStructure")
    outputs = []
    initial_unknowns = []
    for variable in interface.variables:
        is_output = variable.role in ("output", "on_demand")
        if is_output:
            outputs.append(variable)
        if is_output or variable.derivative_of or variable.role == "state":
            initial_unknowns.append(variable)
    _unknowns(structure, "Outputs", outputs, interface, RUNNING_ROLES)
    _unknowns(structure, "Derivatives", interface.derivatives, interface, RUNNING_ROLES)
    _unknowns(
        structure, "InitialUnknowns", initial_unknowns, interface, STARTING_ROLES, initially=True
    )


def root_element(
    about: Description, version: str, token: Mapping[str, str], **extra_attributes: str
) -> ET.Element:
    """Return the root of a description: FMI version, GUID and attributes of the FMU."""
    attributes = {
        "fmiVersion": version,
        "modelName": about.name,
        **token,
        "description": about.text,
        "version": about.version,
        "generationTool": f"HESR {about.version}",
        "generationDateAndTime": about.created,
        "variableNamingConvention": "structured",
        **extra_attributes,
        **about.owner.known,
    }
    return ET.Element("fmiModelDescription", attributes)


def add_units(root: ET.Element, interface: Interface) -> None:
    """Add the definitions of all units."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(variable.unit for variable in interface.variables if variable.unit):
        unit = ET.SubElement(definitions, "Unit", name=name)
        base = {base: str(exponent) for base, exponent in si_exponents(name).items()}
        if name in OFFSETS:
            base["offset"] = repr(OFFSETS[name])
        ET.SubElement(unit, "BaseUnit", base)
        display = DISPLAY.get(name)
        if display:
            ET.SubElement(unit, "DisplayUnit", name=display, factor=repr(DEGREES))


def add_run(root: ET.Element, about: Description) -> None:
    """Add the log categories and the default experiment."""
    categories = ET.SubElement(root, "LogCategories")
    for name, text in CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)
    ET.SubElement(root, "DefaultExperiment", about.experiment)


def _types(root: ET.Element, interface: Interface) -> None:
    enumerations = dict.fromkeys(
        variable.enumeration for variable in interface.variables if variable.enumeration
    )
    if not enumerations:
        return
    definitions = ET.SubElement(root, "TypeDefinitions")
    for enumeration in enumerations:
        choices = ", ".join(f"{i} = {text}" for i, (_, text) in enumerate(enumeration.items, 1))
        simple = ET.SubElement(definitions, "SimpleType", name=enumeration.name)
        simple.set("description", choices)
        ET.SubElement(simple, "Integer", min="1", max=str(len(enumeration.items)))


def common_attributes(variable: Variable, name: str, place: int, text: str) -> dict[str, str]:
    """Return the attributes of a variable common to both versions and all types.

    For an array, `variable` is its first element.
    """
    causality, variability, initial = variable.attributes
    if variable.enumeration:
        # Tools display the choices here, and `fmu_src.run.variables` reads them.
        names = (f"{i} = {name}" for i, (name, _) in enumerate(variable.enumeration.items, 1))
        text = f"{text}: {', '.join(names)}"
    attributes = {"name": name, "valueReference": str(place), "description": text}
    attributes |= {"causality": causality, "variability": variability}
    if initial is not None:
        attributes["initial"] = initial
    return attributes


def values(elements: Sequence[Variable]) -> dict[str, str]:
    """Return the attributes for start values and common limits of a variable or an array."""
    first_variable = elements[0]
    if first_variable.enumeration:
        count = len(first_variable.enumeration.items)
        return {"min": "1", "max": str(count), "start": str(int(first_variable.start))}
    attributes = {}
    if not (first_variable.computed or first_variable.role == "state"):
        attributes["start"] = " ".join(
            _value_text(variable, variable.start) for variable in elements
        )
    lower_limits = [variable.least for variable in elements if variable.least is not None]
    upper_limits = [variable.greatest for variable in elements if variable.greatest is not None]
    # Limits of all elements are the narrowest ones.
    if lower_limits:
        attributes["min"] = _value_text(first_variable, max(lower_limits))
    if upper_limits:
        attributes["max"] = _value_text(first_variable, min(upper_limits))
    return attributes


def _value_text(variable: Variable, value: float) -> str:
    if variable.boolean:
        return str(value != 0.0).lower()
    if variable.integer:
        return str(int(value))
    return repr(float(value))


def _scalar(variable: Variable, place: int, interface: Interface) -> ET.Element:
    attributes = common_attributes(variable, variable.name, place, variable.description)
    element = ET.Element("ScalarVariable", attributes)
    if variable.enumeration:
        # Maestro loads no FMU with an Enumeration, and libcosim sets none.
        declared = {"declaredType": variable.enumeration.name}
        ET.SubElement(element, "Integer", declared | values([variable]))
        return element
    if variable.boolean:
        ET.SubElement(element, "Boolean", values([variable]))
        return element
    if variable.integer:
        ET.SubElement(element, "Integer", values([variable]))
        return element
    unit = variable.unit or "1"
    real = {"unit": unit} | unit_attributes(unit) | values([variable])
    if variable.nominal != 1.0:
        real["nominal"] = repr(variable.nominal)
    if variable.derivative_of:
        real["derivative"] = str(interface.places[variable.derivative_of] + 1)
    ET.SubElement(element, "Real", real)
    return element


def _unknowns(
    structure: ET.Element,
    kind: str,
    unknowns: Sequence[Variable],
    interface: Interface,
    roles: Sequence[Role],
    *,
    initially: bool = False,
) -> None:
    if not unknowns:
        return
    parent = ET.SubElement(structure, kind)
    for variable in unknowns:
        names = interface.find_dependencies(variable, roles, initially=initially)
        numbers = " ".join(map(str, sorted({interface.places[name] + 1 for name in names})))
        ET.SubElement(
            parent, "Unknown", index=str(interface.places[variable.name] + 1), dependencies=numbers
        )
