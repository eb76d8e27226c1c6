"""modelDescription.xml of FMI 2.0 or 3.0 as plain data; invalid numbers are None."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import prod

from lxml import etree

KINDS = {"ModelExchange": "model exchange", "CoSimulation": "co-simulation"}

STRUCTURE = ("Outputs", "Derivatives", "InitialUnknowns")  # lists of ModelStructure
FLOATS = ("Float32", "Float64")  # types of FMI 3.0 that may be continuous
_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
_INTEGER = re.compile(r"[+-]?[0-9]{1,20}")  # UInt64 has up to 20 digits
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?INF|NaN")


def integer(text: str | None) -> int | None:
    """Return an integer, None if invalid."""
    text = (text or "").strip()
    return int(text) if _INTEGER.fullmatch(text) else None


def real(text: str | None) -> float | None:
    """Return a number, None if invalid or NaN."""
    text = (text or "").strip()
    value = float(text) if _REAL.fullmatch(text) else math.nan
    return None if math.isnan(value) else value


@dataclass(frozen=True, kw_only=True)
class InterfaceKind:
    """Element ModelExchange, CoSimulation or ScheduledExecution."""

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
        value = self.attributes.get(capability, self.attributes.get(other, ""))
        return value.strip() in ("true", "1")


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
class ParsedVariable:
    """A variable; `type_attributes` are those of its Real, Integer, ... element."""

    index: int
    name: str
    reference: int | None
    causality: str
    variability: str
    declared_initial: str | None
    kind: str
    type_attributes: Mapping[str, str]
    type: SimpleType | None
    size: int | None = 1  # number of elements in FMI 3.0; None if unknown
    others: tuple[str, ...] = ()  # names of aliases in FMI 3.0

    def get(self, attribute: str) -> str | None:
        """Return an attribute, by default that of the declared type."""
        inherited = self.type.attributes.get(attribute) if self.type else None
        return self.type_attributes.get(attribute, inherited)


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """An entry of ModelStructure; indices count from 1."""

    index: int
    dependencies: tuple[int, ...] | None


@dataclass(frozen=True, kw_only=True)
class ParsedDescription:
    """All data of the rules; `lists` maps the keys of `structure` to elements."""

    fmi: int
    lists: Mapping[str, str]
    attributes: Mapping[str, str]
    kinds: tuple[InterfaceKind, ...]
    units: tuple[tuple[str, tuple[str, ...]], ...]
    types: tuple[SimpleType, ...]
    categories: tuple[str, ...]
    experiment: Mapping[str, str]
    variables: tuple[ParsedVariable, ...]
    structure: Mapping[str, tuple[Unknown, ...]]

    def name_index(self, index: int) -> str:
        """Return the text for a variable that does not exist."""
        return f"variable number {index}" if self.fmi == 2 else f"value reference {-1 - index}"

    @property
    def continuous(self) -> tuple[str, ...]:
        """Types of continuous variables."""
        return ("Real",) if self.fmi == 2 else FLOATS

    def variable(self, index: int | None) -> ParsedVariable | None:
        """Return the variable of an index that counts from 1, or None."""
        if index is None or not 0 < index <= len(self.variables):
            return None
        return self.variables[index - 1]


def read_description(
    root: etree._Element, build: etree._Element | None = None
) -> ParsedDescription:
    """Read the elements fmiModelDescription, of FMI 2.0 or 3.0, and fmiBuildDescription."""
    is_fmi3 = root.get("fmiVersion", "").startswith("3.")
    return (_Reader3(root, build) if is_fmi3 else _Reader(root)).description()


def read_name(element: etree._Element) -> str:
    """Return the name of an element, or ""."""
    return str(element.get("name", ""))


def read_names(elements: Iterable[etree._Element]) -> tuple[str, ...]:
    """Return the names of elements."""
    return tuple(map(read_name, elements))


def _attributes(element: etree._Element | None) -> dict[str, str]:
    return {} if element is None else {str(k): str(value) for k, value in element.attrib.items()}


class _Reader:
    fmi = 2
    kinds = tuple(KINDS)
    lists: Mapping[str, str] = {name: f"ModelStructure/{name}" for name in STRUCTURE}
    variables = "ModelVariables/ScalarVariable"
    types = "TypeDefinitions/SimpleType"
    unknown = "/Unknown"
    reference = "index"

    def __init__(self, root: etree._Element) -> None:
        self.root, self.elements = root, root.findall(self.variables)
        types = tuple(map(self._type, root.findall(self.types)))
        self._types = types
        self._by_name = {t.name: t for t in types}

    def description(self) -> ParsedDescription:
        root = self.root
        return ParsedDescription(
            fmi=self.fmi,
            lists=self.lists,
            attributes=_attributes(root),
            kinds=tuple(
                InterfaceKind(element=name, attributes=_attributes(e), sources=self.sources(e))
                for name in self.kinds
                for e in root.findall(name)
            ),
            units=tuple(
                (read_name(u), read_names(u.findall("DisplayUnit")))
                for u in root.findall("UnitDefinitions/Unit")
            ),
            types=self._types,
            categories=read_names(root.findall("LogCategories/Category")),
            experiment=_attributes(root.find("DefaultExperiment")),
            variables=tuple(self.variable(i, e) for i, e in enumerate(self.elements, start=1)),
            structure={
                name: tuple(self._unknowns(list_path)) for name, list_path in self.lists.items()
            },
        )

    def find_type_element(self, element: etree._Element) -> etree._Element | None:
        return next((child for child in element if child.tag in _TYPES), None)

    def sources(self, kind: etree._Element) -> tuple[str, ...]:
        return read_names(kind.findall("SourceFiles/File"))

    def number(self, text: str | None) -> int | None:
        return integer(text)

    def variable(self, index: int, element: etree._Element) -> ParsedVariable:
        type_element = self.find_type_element(element)
        type_attributes = _attributes(type_element)
        return ParsedVariable(
            index=index,
            name=read_name(element),
            reference=integer(element.get("valueReference")),
            causality=element.get("causality", "local"),
            variability=element.get("variability", "continuous"),
            declared_initial=element.get("initial"),
            kind="" if type_element is None else str(type_element.tag),
            type_attributes=type_attributes,
            type=self._by_name.get(type_attributes.get("declaredType", "")),
        )

    def _type(self, element: etree._Element) -> SimpleType:
        type_element = self.find_type_element(element)
        items = [] if type_element is None else type_element.findall("Item")
        return SimpleType(
            name=read_name(element),
            kind="" if type_element is None else str(type_element.tag).removesuffix("Type"),
            attributes=_attributes(type_element),
            items=tuple((read_name(item), integer(item.get("value"))) for item in items),
        )

    def _unknowns(self, list_path: str) -> Iterator[Unknown]:
        for element in self.root.findall(list_path + self.unknown):
            index = self.number(element.get(self.reference))
            if index is None:
                continue
            dependencies_text = element.get("dependencies")
            numbers = map(self.number, (dependencies_text or "").split())
            yield Unknown(
                index=index,
                dependencies=None
                if dependencies_text is None
                else tuple(n for n in numbers if n is not None),
            )


class _Reader3(_Reader):
    """Value references become indices of variables, unknown ones negative numbers."""

    fmi = 3
    kinds = (*_Reader.kinds, "ScheduledExecution")
    lists: Mapping[str, str] = {
        "Outputs": "ModelStructure/Output",
        "Derivatives": "ModelStructure/ContinuousStateDerivative",
        "InitialUnknowns": "ModelStructure/InitialUnknown",
    }
    variables = "ModelVariables/*"
    types = "TypeDefinitions/*"
    unknown = ""
    reference = "valueReference"

    def __init__(self, root: etree._Element, build: etree._Element | None) -> None:
        super().__init__(root)
        self._build = build
        self._numbers: dict[int | None, int] = {}
        self._sizes: dict[int | None, int | None] = {}
        for i, element in enumerate(self.elements, start=1):
            reference = integer(element.get("valueReference"))
            self._numbers.setdefault(reference, i)
            self._sizes[reference] = integer(element.get("start"))

    def find_type_element(self, element: etree._Element) -> etree._Element:
        return element

    def sources(self, kind: etree._Element) -> tuple[str, ...]:
        builds = [] if self._build is None else self._build.findall("BuildConfiguration")
        return tuple(
            name
            for build in builds
            if build.get("modelIdentifier", "") == kind.get("modelIdentifier", "")
            for name in read_names(build.findall("SourceFileSet/SourceFile"))
        )

    def number(self, text: str | None) -> int:
        reference = integer(text)
        return -1 if reference is None else self._numbers.get(reference, -1 - reference)

    def variable(self, index: int, element: etree._Element) -> ParsedVariable:
        variable = super().variable(index, element)
        type_attributes = dict(variable.type_attributes)
        if "start" not in type_attributes and element.find("Start") is not None:  # of a String
            type_attributes["start"] = " ".join(
                e.get("value", "") or "?" for e in element.findall("Start")
            )
        if "derivative" in type_attributes:
            type_attributes["derivative"] = str(self.number(type_attributes["derivative"]))
        sizes = [
            integer(d.get("start"))
            if "start" in d.attrib
            else self._sizes.get(integer(d.get("valueReference")))
            for d in element.findall("Dimension")
        ]
        known_sizes = [size for size in sizes if size is not None]
        usual = "continuous" if variable.kind in FLOATS else "discrete"
        updates = {
            "variability": element.get("variability", usual),
            "type_attributes": type_attributes,
            "size": prod(known_sizes) if len(known_sizes) == len(sizes) else None,
            "others": read_names(element.findall("Alias")),
        }
        return ParsedVariable(**(vars(variable) | updates))  # faster than `replace`
