"""Systems of FMUs as SSP archives, which other co-simulation engines read.

The description keeps to the subset that FMPy, libcosim, ecos and OMSimulator read: one level, and
connectors at components only, each connected or observed (FMPy requires a connection for every
input with a connector). SSP has no steps; they are in annotations of the engines. Nor has it an
order of coupling: that of the system is in an annotation of ours, which `hesr simulate` reads and
the engines ignore:

    <ssc:Annotation type="hesr.coupling"><hesr:Coupling order="gauss_seidel" /></ssc:Annotation>
"""

import zipfile
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.export import record
from fmu_src.export.package import zip_members
from fmu_src.run.master import Element
from hesr.extras.ssp.contents import (
    COUPLING,
    COUPLING_ANNOTATION,
    NAMESPACES,
    SSD,
    SystemContents,
    UnitExponents,
    Version,
    add_units,
    build_parameter_set,
    format_value,
    read_contents,
)
from hesr.extras.ssp.ssp_results import result_files
from hesr_model.errors import ConfigError
from hesr_model.support.files import written_whole
from hesr_model.support.text import quote_names
from hesr_model.support.xml_files import to_bytes

PARAMETER_SET = "start"
"""Name of every component's parameter set; libcosim and ecos apply sets of one name together."""

OMSIMULATOR = "org.openmodelica"
OSP = "com.opensimulationplatform"
_ENGINE_NAMESPACES = {
    "xmlns:oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "xmlns:osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "xmlns:hesr": COUPLING,
}
_TOLERANCE = "0.0001"  # required by OMSimulator; FMUs with a fixed step ignore it


def export_ssp(system: SystemSpec, path: Path, output: Path, *, ssp: Version = "1.0") -> str | None:
    """Write the system of a file as an SSP; return a sentence on missing parts, if any."""
    contents = read_contents(system, path)
    write_ssp(contents, output, version=ssp)
    # Engines refuse connectors of unconnected inputs, parameters and local variables.
    used_outputs = set(contents.used_outputs)
    observed = [
        ".".join(element) for element in contents.wiring.observed if element not in used_outputs
    ]
    remarks = []
    if observed:
        remarks.append(f"observes outputs only, not {quote_names(observed)}")
    if system.limits:
        remarks.append(f"has no limits of {quote_names(system.limits)}")
    if not remarks:
        return None
    return f"The SSP {', and '.join(remarks)}."


def write_ssp(contents: SystemContents, path: Path, *, version: Version = "1.0") -> Path:
    """Write a system with its FMUs as an SSP and return the path; the bytes are reproducible.

    libcosim and ecos read version 1.0 only.
    """
    if path.suffix != ".ssp":
        raise ConfigError(f"{path}: the name of a packaged system ends in .ssp.")
    members = {SSD: to_ssd(contents, version)}
    for component in contents.system.components:
        name = component.name
        if contents.wiring.start[name]:
            members[resource(name, ".ssv")] = to_ssv(contents, name, version)
        members[resource(name, ".fmu")] = component.fmu.read_bytes()
    members |= result_files(contents)
    members[record.MEMBER] = record.write_record(members, _describe_origin(contents))
    with written_whole(path) as temporary:
        zip_members(temporary, members, contents.created)
    return path


def _describe_origin(contents: SystemContents) -> dict[str, Any]:
    """Return the origin of an SSP for its record: the FMUs, and their own records."""
    records: dict[str, str | None] = {}
    for component in contents.system.components:
        name = resource(component.name, ".fmu")
        records[name] = None
        with zipfile.ZipFile(component.fmu) as archive:
            if record.MEMBER in archive.namelist():
                records[name] = record.MEMBER
    return {"hesr": installed("hesr"), "records": records}


def resource(component: str, suffix: str) -> str:
    """Return the name of a component's file; OMSimulator needs one FMU per component."""
    return f"resources/{component}{suffix}"


def to_ssd(contents: SystemContents, version: Version) -> bytes:
    """Return SystemStructure.ssd."""
    system = contents.system
    root = ET.Element(
        "ssd:SystemStructureDescription",
        NAMESPACES | _ENGINE_NAMESPACES,
        version=version,
        name=system.name,
        generationTool=f"HESR {installed('hesr')}",
        generationDateAndTime=contents.created,
    )
    connectors = [*contents.wiring.sources, *contents.used_outputs]
    units = contents.units(connectors)
    system_node = ET.SubElement(root, "ssd:System", name=system.name)
    elements_node = ET.SubElement(system_node, "ssd:Elements")
    for component in system.components:
        elements_node.append(_build_component(contents, component, connectors, units))
    if contents.wiring.sources:
        connections_node = ET.SubElement(system_node, "ssd:Connections")
        for (target, input_name), (source, output_name) in contents.wiring.sources.items():
            ET.SubElement(
                connections_node,
                "ssd:Connection",
                startElement=source,
                startConnector=output_name,
                endElement=target,
                endConnector=input_name,
            )
    annotations = ET.SubElement(system_node, "ssd:Annotations")
    coupling = ET.SubElement(annotations, "ssc:Annotation", type=COUPLING_ANNOTATION)
    ET.SubElement(coupling, "hesr:Coupling", order=system.order)
    master = ET.SubElement(annotations, "ssc:Annotation", type=OMSIMULATOR)
    for tag in ("oms:Annotations", "oms:SimulationInformation"):
        master = ET.SubElement(master, tag)
    ET.SubElement(
        master,
        "oms:FixedStepMaster",
        description="oms-ma",
        stepSize=repr(system.step),
        absoluteTolerance=_TOLERANCE,
        relativeTolerance=_TOLERANCE,
    )
    add_units(root, "ssd:Units", units)
    experiment = ET.SubElement(
        root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(system.stop)
    )
    algorithm = ET.SubElement(_add_annotation(experiment, OSP), "osp:Algorithm")
    ET.SubElement(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(system.step))
    return to_bytes(root)


def _build_component(
    contents: SystemContents,
    component: ComponentSpec,
    connectors: list[Element],
    units: dict[str, UnitExponents],
) -> ET.Element:
    name = component.name
    node = ET.Element(
        "ssd:Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=resource(name, ".fmu"),
        implementation="CoSimulation",
    )
    component_connectors = [
        variable for component_name, variable in connectors if component_name == name
    ]
    if component_connectors:
        connectors_node = ET.SubElement(node, "ssd:Connectors")
        for variable in component_connectors:
            causality = contents.variables[name][variable].causality
            connector = ET.SubElement(
                connectors_node, "ssd:Connector", name=variable, kind=causality
            )
            kind = contents.find_type((name, variable))
            ET.SubElement(connector, f"ssc:{kind}", contents.unit((name, variable), units))
    if contents.wiring.start[name]:
        bindings_node = ET.SubElement(node, "ssd:ParameterBindings")
        ET.SubElement(bindings_node, "ssd:ParameterBinding", source=resource(name, ".ssv"))
    if contents.system.find_step_multiple(component) > 1:
        step_size = contents.system.find_step_multiple(component) * contents.system.step
        ET.SubElement(_add_annotation(node, OSP), "osp:StepSizeHint", value=repr(step_size))
    return node


def _add_annotation(parent: ET.Element, kind: str) -> ET.Element:
    return ET.SubElement(ET.SubElement(parent, "ssd:Annotations"), "ssc:Annotation", type=kind)


def to_ssv(contents: SystemContents, component: str, version: Version) -> bytes:
    """Return the start values of a component as a parameter set."""
    start_values = contents.wiring.start[component]
    units = contents.units((component, variable) for variable in start_values)
    root_attributes = {
        "version": version,
        "name": PARAMETER_SET,
        "generationTool": f"HESR {installed('hesr')}",
        "generationDateAndTime": contents.created,
    }
    values = []
    for variable, value in start_values.items():
        kind = contents.find_type((component, variable))
        attributes = {"value": format_value(kind, value)} | contents.unit(
            (component, variable), units
        )
        values.append((variable, kind, attributes))
    return to_bytes(build_parameter_set(values, units, root_attributes))
