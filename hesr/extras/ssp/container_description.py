"""modelDescription.xml of a container."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version as installed
from typing import Any
from xml.etree import ElementTree as ET

from fmu_src.export.description import to_bytes
from fmu_src.run.master import Element
from hesr.extras.ssp.contents import SystemContents, UnitExponents, add_units, text_of

_PART = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
_STRUCTURED = re.compile(rf"{_PART}(\.{_PART})*", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Exposed:
    """A variable of a component, exposed as `component.variable`."""

    element: Element
    causality: str
    initial: str | None
    start: float | str | None


def exposed_variables(contents: SystemContents) -> Iterator[Exposed]:
    """Yield the exposed variables.

    Outputs are the observed signals, or all outputs if none is observed; the others are local.
    Unconnected inputs, parameters, and variables with a start value are also exposed.
    """
    wiring = contents.wiring
    observed = set(wiring.observed)
    for name, described in contents.descriptions.items():
        for variable in described.modelVariables:
            element = (name, variable.name)
            fed, shown = element in wiring.sources, element in observed
            given = None if fed else wiring.start[name].get(variable.name)
            if (seen := variable.causality) == "output":
                seen = "output" if shown or not observed else "local"
            elif seen != "parameter" and (fed or seen != "input"):
                if seen == "independent" or not (shown or given is not None):
                    continue
                # FMI: an output cannot change with parameters alone.
                follows = variable.variability in ("fixed", "tunable")
                seen = "output" if shown and not follows else "local"
            start = _own_start(variable) if given is None else given
            initial = None if seen == "input" else variable.initial
            yield Exposed(
                element=element,
                causality=seen,
                initial="calculated" if fed else initial,
                start=None if fed else start,
            )


def to_description(
    contents: SystemContents, exposed: list[Exposed], identifier: str, guid: str
) -> bytes:
    """Return modelDescription.xml."""
    spec = contents.spec
    structured = all(_STRUCTURED.fullmatch(".".join(shown.element)) for shown in exposed)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=spec.name,
        guid=guid,
        description=f"System of {len(spec.components)} FMUs, stepped every {spec.step:g} s.",
        generationTool=f"HESR {installed('hesr')}",
        generationDateAndTime=contents.created,
        # names such as "der(x)" are flat
        variableNamingConvention="structured" if structured else "flat",
        numberOfEventIndicators="0",
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier,
        needsExecutionTool="false",
        canHandleVariableCommunicationStepSize="true",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="false",
    )
    units = contents.units(e.element for e in exposed)
    add_units(root, "UnitDefinitions", units, prefix="")
    ET.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime=repr(spec.stop), stepSize=repr(spec.step)
    )
    variables = ET.SubElement(root, "ModelVariables")
    for reference, shown in enumerate(exposed, start=1):  # 0 is the time
        variables.append(_scalar(contents, shown, reference, units))
    _unknowns(ET.SubElement(root, "ModelStructure"), contents, exposed)
    return to_bytes(root)


def _scalar(
    contents: SystemContents, shown: Exposed, reference: int, units: Mapping[str, UnitExponents]
) -> ET.Element:
    component, name = shown.element
    variable = contents.variables[component][name]
    said = {
        "name": f"{component}.{name}",
        "valueReference": str(reference),
        "description": _text(variable),
        "causality": shown.causality,
        "variability": variable.variability,
        "initial": shown.initial,
    }
    scalar = ET.Element("ScalarVariable", {k: v for k, v in said.items() if v is not None})
    kind = ET.SubElement(
        scalar, contents.type_of(shown.element), contents.unit(shown.element, units)
    )
    for key in ("min", "max"):
        if (bound := getattr(variable, key)) is not None:
            kind.set(key, bound)
    if shown.start is not None:
        kind.set("start", text_of(contents.type_of(shown.element), shown.start))
    return scalar


def _text(variable: Any) -> str | None:
    described: str | None = variable.description
    if variable.type != "Enumeration":
        return described
    choices = ", ".join(f"{item.value} = {item.name}" for item in variable.declaredType.items)
    return f"{described or variable.name}: {choices}"


def _own_start(variable: Any) -> float | str | None:
    text: str | None = variable.start
    if text is None or variable.type == "String":
        return text
    if variable.type == "Boolean":
        return float(text in ("true", "1"))
    return float(text)


def _unknowns(structure: ET.Element, contents: SystemContents, exposed: list[Exposed]) -> None:
    index = {shown.element: i for i, shown in enumerate(exposed, start=1)}
    shown_as_output = [shown for shown in exposed if shown.causality == "output"]
    outputs = [shown.element for shown in shown_as_output]
    unknown = [shown.element for shown in shown_as_output if shown.initial != "exact"]
    for tag, elements, needs in (
        ("Outputs", outputs, {n: v.feedthrough for n, v in contents.variables.items()}),
        ("InitialUnknowns", unknown, {n: _at_start(contents, n) for n in contents.variables}),
    ):
        if elements:
            parent = ET.SubElement(structure, tag)
        for element in elements:
            known = sorted(index[e] for e in _known(contents, element, needs) if e in index)
            ET.SubElement(
                parent, "Unknown", index=str(index[element]), dependencies=" ".join(map(str, known))
            )


def _at_start(contents: SystemContents, component: str) -> dict[str, list[str]]:
    described = contents.descriptions[component]
    everything = [v.name for v in described.modelVariables if v.causality in ("input", "parameter")]
    return {
        unknown.variable.name: everything
        if unknown.dependencies is None
        else [v.name for v in unknown.dependencies]
        for unknown in described.initialUnknowns
    }


def _known(
    contents: SystemContents, output: Element, needs: Mapping[str, Mapping[str, list[str]]]
) -> set[Element]:
    sources = contents.wiring.sources
    # An observed connected input is its source.
    seen, left = set[Element](), [sources.get(output, output)]
    while left:
        component, name = left.pop()
        for needed in needs[component].get(name, contents.variables[component].inputs):
            element = (component, needed)
            if element in seen:
                continue
            seen.add(element)
            if element in sources:
                left.append(sources[element])
    return seen - sources.keys()
