"""modelDescription.xml of FMI 3.0 as the rules look at it, in the terms of FMI 2.0.

What refers to a variable by its value reference becomes its number, which counts from 1; what
refers to none becomes a negative number.
"""

from collections.abc import Iterator, Mapping
from math import prod

from lxml import etree

from fmu_src.check.description import (
    STRUCTURE,
    Description,
    Kind,
    SimpleType,
    Unknown,
    Variable,
    attributes,
    integer,
    name_of,
)

KINDS = ("ModelExchange", "CoSimulation", "ScheduledExecution")
FLOATS = ("Float32", "Float64")

_LISTS = dict(
    zip(STRUCTURE, ("Output", "ContinuousStateDerivative", "InitialUnknown"), strict=True)
)
_TYPES = (
    *FLOATS, *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)),
    "Boolean", "String", "Binary", "Enumeration", "Clock",
)  # fmt: skip


def read_description3(root: etree._Element, build: etree._Element | None) -> Description:
    """Read the element fmiModelDescription, and the sources that fmiBuildDescription lists."""
    types = tuple(_type(e) for e in root.findall("TypeDefinitions/*"))
    by_name = {t.name: t for t in types}
    elements = [e for e in root.findall("ModelVariables/*") if e.tag in _TYPES]
    numbers = {
        reference: i
        for i, e in reversed(list(enumerate(elements, start=1)))
        if (reference := integer(e.get("valueReference"))) is not None
    }
    sizes = {integer(e.get("valueReference")): integer(e.get("start")) for e in elements}
    sources = _sources(build)
    experiment = root.find("DefaultExperiment")
    return Description(
        fmi=3,
        lists=_LISTS,
        attributes=attributes(root),
        kinds=tuple(
            Kind(
                element=name,
                attributes=attributes(e),
                sources=sources.get(e.get("modelIdentifier", ""), ()),
            )
            for name in KINDS
            for e in root.findall(name)
        ),
        units=tuple(
            (name_of(u), tuple(map(name_of, u.findall("DisplayUnit"))))
            for u in root.findall("UnitDefinitions/Unit")
        ),
        types=types,
        categories=tuple(map(name_of, root.findall("LogCategories/Category"))),
        experiment={} if experiment is None else attributes(experiment),
        variables=tuple(
            _variable(i, e, by_name, numbers, sizes) for i, e in enumerate(elements, start=1)
        ),
        structure={
            name: tuple(_unknowns(root, element, numbers)) for name, element in _LISTS.items()
        },
    )


def _sources(build: etree._Element | None) -> dict[str, tuple[str, ...]]:
    """Return the source files of each modelIdentifier."""
    found: dict[str, tuple[str, ...]] = {}
    for one in () if build is None else build.findall("BuildConfiguration"):
        names = tuple(map(name_of, one.findall("SourceFileSet/SourceFile")))
        identifier = str(one.get("modelIdentifier", ""))
        found[identifier] = (*found.get(identifier, ()), *names)
    return found


def _type(element: etree._Element) -> SimpleType:
    return SimpleType(
        name=name_of(element),
        kind=str(element.tag).removesuffix("Type"),
        attributes=attributes(element),
        items=tuple((name_of(i), integer(i.get("value"))) for i in element.findall("Item")),
    )


def _variable(
    index: int,
    element: etree._Element,
    types: Mapping[str, SimpleType],
    numbers: Mapping[int, int],
    sizes: Mapping[int | None, int | None],
) -> Variable:
    own = attributes(element)
    kind, causality = str(element.tag), element.get("causality", "local")
    if "start" not in own and element.find("Start") is not None:  # of texts
        own["start"] = " ".join(e.get("value", "") or "?" for e in element.findall("Start"))
    if "derivative" in own:
        own["derivative"] = str(_number(own["derivative"], numbers))
    initial = element.get("initial")
    parts = [
        integer(d.get("start"))
        if "start" in d.attrib
        else sizes.get(integer(d.get("valueReference")))
        for d in element.findall("Dimension")
    ]
    known = [size for size in parts if size is not None]
    return Variable(
        index=index,
        name=name_of(element),
        reference=integer(element.get("valueReference")),
        causality=causality,
        variability=element.get("variability", "continuous" if kind in FLOATS else "discrete"),
        # Inputs have no other.
        declared_initial=None if causality == "input" and initial == "exact" else initial,
        kind=kind,
        own=own,
        type=types.get(own.get("declaredType", "")),
        size=prod(known) if len(known) == len(parts) else None,
        others=tuple(map(name_of, element.findall("Alias"))),
    )


def _number(text: str, numbers: Mapping[int, int]) -> int:
    reference = integer(text)
    if reference is None:
        return -1
    return numbers.get(reference, -1 - reference)


def _unknowns(root: etree._Element, name: str, numbers: Mapping[int, int]) -> Iterator[Unknown]:
    for element in root.findall(f"ModelStructure/{name}"):
        known, kinds = element.get("dependencies"), element.get("dependenciesKind")
        yield Unknown(
            index=_number(element.get("valueReference", ""), numbers),
            dependencies=None
            if known is None
            else tuple(_number(n, numbers) for n in known.split()),
            kinds=None if kinds is None else tuple(kinds.split()),
        )
