"""modelDescription.xml as plain data, read without trusting that it is valid.

A number that is none is None here: the schema has reported it.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from lxml import etree

KINDS = {"ModelExchange": "model exchange", "CoSimulation": "co-simulation"}

STRUCTURE = ("Outputs", "Derivatives", "InitialUnknowns")
"""Lists of ModelStructure."""

_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?INF|NaN")

DEFAULT_INITIAL = {
    ("parameter", "fixed"): "exact",
    ("parameter", "tunable"): "exact",
    ("calculatedParameter", "fixed"): "calculated",
    ("calculatedParameter", "tunable"): "calculated",
    ("structuralParameter", "fixed"): "exact",
    ("structuralParameter", "tunable"): "exact",
    ("output", "constant"): "exact",
    ("output", "discrete"): "calculated",
    ("output", "continuous"): "calculated",
    ("local", "constant"): "exact",
    ("local", "fixed"): "calculated",
    ("local", "tunable"): "calculated",
    ("local", "discrete"): "calculated",
    ("local", "continuous"): "calculated",
}


def integer(text: str | None) -> int | None:
    """Return an integer, None where the text is none."""
    text = (text or "").strip()
    return int(text) if _INTEGER.fullmatch(text) else None


def real(text: str | None) -> float | None:
    """Return a number, None where the text is none or NaN."""
    text = (text or "").strip()
    value = float(text) if _REAL.fullmatch(text) else math.nan
    return None if math.isnan(value) else value


def flag(text: str | None) -> bool:
    """Return the value of an XML boolean."""
    return (text or "").strip() in ("true", "1")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """The ModelExchange or the CoSimulation element."""

    element: str
    attributes: Mapping[str, str]
    sources: tuple[str, ...]

    @property
    def identifier(self) -> str:
        """Name of the binaries."""
        return self.attributes.get("modelIdentifier", "")

    def can(self, capability: str) -> bool:
        """Whether a capability flag is set; FMI 3.0 spells State with a capital."""
        other = capability.replace("FMUstate", "FMUState")
        return flag(self.attributes.get(capability, self.attributes.get(other)))


@dataclass(frozen=True, kw_only=True)
class SimpleType:
    """A type definition."""

    name: str
    kind: str
    attributes: Mapping[str, str]
    items: tuple[tuple[str, int | None], ...]

    @cached_property
    def values(self) -> frozenset[int | None]:
        """Values of its items."""
        return frozenset(value for _, value in self.items)


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A variable; `own` are the attributes of its Real, Integer, ... element.

    Of FMI 3.0, `size` is how many elements it has, None where that is not known, and `others` are
    the names of its aliases.
    """

    index: int
    name: str
    reference: int | None
    causality: str
    variability: str
    declared_initial: str | None
    kind: str
    own: Mapping[str, str]
    type: SimpleType | None
    size: int | None = 1
    others: tuple[str, ...] = ()

    @property
    def initial(self) -> str | None:
        """Its `initial`, or the default that causality and variability give."""
        return self.declared_initial or DEFAULT_INITIAL.get((self.causality, self.variability))

    def get(self, attribute: str) -> str | None:
        """Return an attribute, the declared type's where it has none of its own."""
        inherited = self.type.attributes.get(attribute) if self.type else None
        return self.own.get(attribute, inherited)


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """An entry of ModelStructure; indices count from 1."""

    index: int
    dependencies: tuple[int, ...] | None
    kinds: tuple[str, ...] | None


@dataclass(frozen=True, kw_only=True)
class Description:
    """All that the rules look at.

    Of FMI 3.0, `structure` has the names of FMI 2.0; `lists` has those of the file.
    """

    fmi: int = 2
    lists: Mapping[str, str] = field(default_factory=lambda: {name: name for name in STRUCTURE})
    attributes: Mapping[str, str]
    kinds: tuple[Kind, ...]
    units: tuple[tuple[str, tuple[str, ...]], ...]
    types: tuple[SimpleType, ...]
    categories: tuple[str, ...]
    experiment: Mapping[str, str]
    variables: tuple[Variable, ...]
    structure: Mapping[str, tuple[Unknown, ...]]

    @cached_property
    def exchanges(self) -> bool:
        """Whether it is for model exchange."""
        return any(kind.element == "ModelExchange" for kind in self.kinds)

    @cached_property
    def display_units(self) -> dict[str, frozenset[str]]:
        """Names of the display units of each unit."""
        return {name: frozenset(displays) for name, displays in self.units}

    def shown(self, index: int) -> str:
        """Return how the file names a variable that does not exist."""
        return f"variable number {index}" if self.fmi == 2 else f"value reference {-1 - index}"

    @property
    def continuous(self) -> tuple[str, ...]:
        """The types of which continuous variables are."""
        return ("Real",) if self.fmi == 2 else ("Float32", "Float64")

    def variable(self, index: int | None) -> Variable | None:
        """Return the variable of an index that counts from 1, None where there is none."""
        if index is None or not 0 < index <= len(self.variables):
            return None
        return self.variables[index - 1]


def read_description(root: etree._Element) -> Description:
    """Read the element fmiModelDescription."""
    types = tuple(map(_type, root.findall("TypeDefinitions/SimpleType")))
    by_name = {t.name: t for t in types}
    experiment = root.find("DefaultExperiment")
    return Description(
        attributes=attributes(root),
        kinds=tuple(_kind(e) for name in KINDS for e in root.findall(name)),
        units=tuple(
            (name_of(u), tuple(map(name_of, u.findall("DisplayUnit"))))
            for u in root.findall("UnitDefinitions/Unit")
        ),
        types=types,
        categories=tuple(map(name_of, root.findall("LogCategories/Category"))),
        experiment={} if experiment is None else attributes(experiment),
        variables=tuple(
            _variable(i, e, by_name)
            for i, e in enumerate(root.findall("ModelVariables/ScalarVariable"), start=1)
        ),
        structure={
            name: tuple(_unknowns(root.findall(f"ModelStructure/{name}/Unknown")))
            for name in STRUCTURE
        },
    )


def attributes(element: etree._Element) -> dict[str, str]:
    """Return the attributes of an element."""
    return {str(name): str(value) for name, value in element.attrib.items()}


def name_of(element: etree._Element) -> str:
    """Return its name, empty where it has none."""
    return str(element.get("name", ""))


def _first(element: etree._Element, names: Sequence[str]) -> etree._Element | None:
    return next((child for child in element if child.tag in names), None)


_BASE_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")


def _kind(element: etree._Element) -> Kind:
    return Kind(
        element=str(element.tag),
        attributes=attributes(element),
        sources=tuple(map(name_of, element.findall("SourceFiles/File"))),
    )


def _type(element: etree._Element) -> SimpleType:
    own = _first(element, _BASE_TYPES)
    items = [] if own is None else own.findall("Item")
    return SimpleType(
        name=name_of(element),
        kind="" if own is None else str(own.tag),
        attributes={} if own is None else attributes(own),
        items=tuple((name_of(item), integer(item.get("value"))) for item in items),
    )


def _variable(index: int, element: etree._Element, types: Mapping[str, SimpleType]) -> Variable:
    own = _first(element, _BASE_TYPES)
    given = {} if own is None else attributes(own)
    return Variable(
        index=index,
        name=name_of(element),
        reference=integer(element.get("valueReference")),
        causality=element.get("causality", "local"),
        variability=element.get("variability", "continuous"),
        declared_initial=element.get("initial"),
        kind="" if own is None else str(own.tag),
        own=given,
        type=types.get(given.get("declaredType", "")),
    )


def _unknowns(elements: Iterable[etree._Element]) -> Iterator[Unknown]:
    for element in elements:
        index = integer(element.get("index"))
        dependencies, kinds = element.get("dependencies"), element.get("dependenciesKind")
        if index is None:
            continue
        numbers = None if dependencies is None else map(integer, dependencies.split())
        yield Unknown(
            index=index,
            dependencies=None if numbers is None else tuple(n for n in numbers if n is not None),
            kinds=None if kinds is None else tuple(kinds.split()),
        )
