"""A system of FMUs as the description in an SSP.

It keeps to what FMPy, libcosim, ecos and OMSimulator all read: one level, connectors at components
only, and only those that are connected or observed (FMPy wants every input that has a connector to
be connected). Steps are no part of SSP, so they stand in annotations of the engines' own.
"""

from importlib.metadata import version as installed
from xml.etree import ElementTree as ET

from cosim.systems.contents import SystemContents, Unit
from cosim.systems.markup import NAMESPACES, Version, add_units, to_bytes
from cosim.systems.system import ComponentSpec
from fmu_src.run.master import Element

SSD = "SystemStructure.ssd"
"""Name of the description in an SSP."""

OMSIMULATOR = "org.openmodelica"
OSP = "com.opensimulationplatform"
_ENGINES = {
    "xmlns:oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "xmlns:osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}
_TOLERANCE = "0.0001"  # OMSimulator wants one; FMUs with a fixed step do not use it


def resource(component: str, suffix: str) -> str:
    """Return the name of a component's file in the SSP.

    Every component has an FMU of its own, since OMSimulator looks for it by the component's name.
    """
    return f"resources/{component}{suffix}"


def to_ssd(contents: SystemContents, version: Version) -> bytes:
    """Return SystemStructure.ssd."""
    spec = contents.spec
    root = ET.Element(
        "ssd:SystemStructureDescription",
        NAMESPACES | _ENGINES,
        version=version,
        name=spec.name,
        generationTool=f"HESR {installed('hesr')}",
        generationDateAndTime=contents.created,
    )
    connectors = [*contents.wiring.sources, *contents.used]
    units = contents.units(connectors)
    system = ET.SubElement(root, "ssd:System", name=spec.name)
    elements = ET.SubElement(system, "ssd:Elements")
    for component in spec.components:
        elements.append(_component(contents, component, connectors, units))
    if contents.wiring.sources:
        connections = ET.SubElement(system, "ssd:Connections")
        for (target, into), (source, out) in contents.wiring.sources.items():
            ET.SubElement(
                connections,
                "ssd:Connection",
                startElement=source,
                startConnector=out,
                endElement=target,
                endConnector=into,
            )
    master = _annotation(system, OMSIMULATOR)
    for tag in ("oms:Annotations", "oms:SimulationInformation"):
        master = ET.SubElement(master, tag)
    ET.SubElement(
        master,
        "oms:FixedStepMaster",
        description="oms-ma",
        stepSize=repr(spec.step),
        absoluteTolerance=_TOLERANCE,
        relativeTolerance=_TOLERANCE,
    )
    add_units(root, "ssd:Units", units)
    experiment = ET.SubElement(
        root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(spec.stop)
    )
    algorithm = ET.SubElement(_annotation(experiment, OSP), "osp:Algorithm")
    ET.SubElement(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(spec.step))
    return to_bytes(root)


def _component(
    contents: SystemContents,
    component: ComponentSpec,
    connectors: list[Element],
    units: dict[str, Unit],
) -> ET.Element:
    name = component.name
    node = ET.Element(
        "ssd:Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=resource(name, ".fmu"),
        implementation="CoSimulation",
    )
    own = [variable for owner, variable in connectors if owner == name]
    if own:
        table = ET.SubElement(node, "ssd:Connectors")
        for variable in own:
            causality = contents.variables[name][variable].causality
            connector = ET.SubElement(table, "ssd:Connector", name=variable, kind=causality)
            kind = contents.type_of((name, variable))
            ET.SubElement(connector, f"ssc:{kind}", contents.unit((name, variable), units))
    if contents.wiring.start[name]:
        bindings = ET.SubElement(node, "ssd:ParameterBindings")
        ET.SubElement(bindings, "ssd:ParameterBinding", source=resource(name, ".ssv"))
    if contents.spec.every(component) > 1:
        step = contents.spec.every(component) * contents.spec.step
        ET.SubElement(_annotation(node, OSP), "osp:StepSizeHint", value=repr(step))
    return node


def _annotation(parent: ET.Element, kind: str) -> ET.Element:
    annotations = ET.SubElement(parent, "ssd:Annotations")
    return ET.SubElement(annotations, "ssc:Annotation", type=kind)
