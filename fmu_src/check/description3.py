"""modelDescription.xml of FMI 3.0 in the terms of FMI 2.0.

Value references become indices of variables, which count from 1; unknown references become
negative.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import prod

from lxml import etree

from fmu_src.check.description import (
    FLOATS,
    ParsedDescription,
    ParsedVariable,
    Reader,
    integer,
    names_of,
)

_TYPES = (
    *FLOATS, *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)),
    "Boolean", "String", "Binary", "Enumeration", "Clock",
)  # fmt: skip


def read_description3(root: etree._Element, build: etree._Element | None) -> ParsedDescription:
    """Read the element fmiModelDescription, and the sources that fmiBuildDescription lists."""
    return _Reader3(root, build).description()


class _Reader3(Reader):
    fmi = 3
    kinds = (*Reader.kinds, "ScheduledExecution")
    lists: Mapping[str, str] = {
        "Outputs": "ModelStructure/Output",
        "Derivatives": "ModelStructure/ContinuousStateDerivative",
        "InitialUnknowns": "ModelStructure/InitialUnknown",
    }
    types = "TypeDefinitions/*"
    unknown, reference = "", "valueReference"

    def __init__(self, root: etree._Element, build: etree._Element | None) -> None:
        super().__init__(root)
        self._build = build
        self._numbers: dict[int | None, int] = {}
        self._sizes: dict[int | None, int | None] = {}
        for i, element in enumerate(self.elements(), start=1):
            reference = integer(element.get("valueReference"))
            self._numbers.setdefault(reference, i)
            self._sizes[reference] = integer(element.get("start"))

    def elements(self) -> list[etree._Element]:
        return [e for e in self.root.findall("ModelVariables/*") if e.tag in _TYPES]

    def own(self, element: etree._Element) -> etree._Element:
        return element

    def sources(self, kind: etree._Element) -> tuple[str, ...]:
        builds = [] if self._build is None else self._build.findall("BuildConfiguration")
        return tuple(
            name
            for build in builds
            if build.get("modelIdentifier", "") == kind.get("modelIdentifier", "")
            for name in names_of(build.findall("SourceFileSet/SourceFile"))
        )

    def number(self, text: str | None) -> int:
        reference = integer(text)
        return -1 if reference is None else self._numbers.get(reference, -1 - reference)

    def variable(self, index: int, element: etree._Element) -> ParsedVariable:
        found = super().variable(index, element)
        own = dict(found.own)
        if "start" not in own and element.find("Start") is not None:  # of a String
            own["start"] = " ".join(e.get("value", "") or "?" for e in element.findall("Start"))
        if "derivative" in own:
            own["derivative"] = str(self.number(own["derivative"]))
        parts = [
            integer(d.get("start"))
            if "start" in d.attrib
            else self._sizes.get(integer(d.get("valueReference")))
            for d in element.findall("Dimension")
        ]
        known = [size for size in parts if size is not None]
        usual = "continuous" if found.kind in FLOATS else "discrete"
        return replace(
            found,
            variability=element.get("variability", usual),
            own=own,
            size=prod(known) if len(known) == len(parts) else None,
            others=names_of(element.findall("Alias")),
        )
