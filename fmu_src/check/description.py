"""modelDescription.xml of FMI 2.0 or 3.0 as plain data; invalid numbers are None."""

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
    digits = (text or "").strip()
    if _INTEGER.fullmatch(digits) is None:
        return None
    return int(digits)


def real(text: str | None) -> float | None:
    """Return a number, None if invalid or NaN."""
    number_text = (text or "").strip()
    if _REAL.fullmatch(number_text) is None or number_text == "NaN":
        return None
    return float(number_text)


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

    def get(self, attribute: str) -> str | None:
        """Return an attribute."""
        return self.attributes.get(attribute)


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
        if attribute in self.type_attributes or self.type is None:
            return self.type_attributes.get(attribute)
        return self.type.get(attribute)


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """An entry of ModelStructure; indices count from 1."""

    index: int
    dependencies: tuple[int, ...] | None
    dependency_kinds: tuple[str, ...]


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
        if self.fmi == 2:
            return f"variable number {index}"
        return f"value reference {-1 - index}"

    @property
    def continuous(self) -> tuple[str, ...]:
        """Types of continuous variables."""
        if self.fmi == 2:
            return ("Real",)
        return FLOATS

    @cached_property
    def state_indices(self) -> frozenset[int | None]:
        """Indices of the variables that have a derivative."""
        derivatives = (v.type_attributes.get("derivative") for v in self.variables)
        return frozenset(integer(state) for state in derivatives)

    def has_kind(self, element: str) -> bool:
        """Whether the FMU is for a kind of simulation."""
        return any(kind.element == element for kind in self.kinds)

    def variable(self, index: int | None) -> ParsedVariable | None:
        """Return the variable of an index that counts from 1, or None."""
        if index is None or not 0 < index <= len(self.variables):
            return None
        return self.variables[index - 1]


def read_description(
    root: etree._Element, build: etree._Element | None = None
) -> ParsedDescription:
    """Read the elements fmiModelDescription, of FMI 2.0 or 3.0, and fmiBuildDescription."""
    if root.get("fmiVersion", "").startswith("3."):
        return _Reader3(root, build).description()
    return _Reader(root).description()


def read_name(element: etree._Element) -> str:
    """Return the name of an element, or ""."""
    return str(element.get("name", ""))


def read_names(elements: Iterable[etree._Element]) -> tuple[str, ...]:
    """Return the names of elements."""
    return tuple(map(read_name, elements))


def _attributes(element: etree._Element | None) -> dict[str, str]:
    if element is None:
        return {}
    return {str(key): str(value) for key, value in element.attrib.items()}


def _read_tag(element: etree._Element | None) -> str:
    if element is None:
        return ""
    return str(element.tag)


class _Reader:
    fmi = 2
    kinds = tuple(KINDS)
    lists: Mapping[str, str] = {name: f"ModelStructure/{name}" for name in STRUCTURE}
    variables = "ModelVariables/ScalarVariable"
    types = "TypeDefinitions/SimpleType"
    unknown = "/Unknown"
    reference = "index"

    def __init__(self, root: etree._Element) -> None:
        self.root = root
        self.elements = root.findall(self.variables)
        self._types = [self._type(element) for element in root.findall(self.types)]
        self._type_by_name = {simple_type.name: simple_type for simple_type in self._types}

    def description(self) -> ParsedDescription:
        root = self.root
        structure = {name: tuple(self._unknowns(path)) for name, path in self.lists.items()}
        return ParsedDescription(
            fmi=self.fmi,
            lists=self.lists,
            attributes=_attributes(root),
            kinds=tuple(self._interface_kinds()),
            units=tuple(self._units()),
            types=tuple(self._types),
            categories=read_names(root.findall("LogCategories/Category")),
            experiment=_attributes(root.find("DefaultExperiment")),
            variables=tuple(self.variable(i, e) for i, e in enumerate(self.elements, start=1)),
            structure=structure,
        )

    def _interface_kinds(self) -> Iterator[InterfaceKind]:
        for name in self.kinds:
            for element in self.root.findall(name):
                yield InterfaceKind(
                    element=name,
                    attributes=_attributes(element),
                    sources=tuple(self.sources(element)),
                )

    def _units(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield each unit with its display units."""
        for unit in self.root.findall("UnitDefinitions/Unit"):
            yield read_name(unit), read_names(unit.findall("DisplayUnit"))

    def find_type_element(self, element: etree._Element) -> etree._Element | None:
        return next((child for child in element if child.tag in _TYPES), None)

    def sources(self, kind: etree._Element) -> Iterable[str]:
        return read_names(kind.findall("SourceFiles/File"))

    def number(self, text: str | None) -> int | None:
        return integer(text)

    def variable(self, index: int, element: etree._Element) -> ParsedVariable:
        type_element = self.find_type_element(element)
        type_attributes = _attributes(type_element)
        declared_type = type_attributes.get("declaredType", "")
        return ParsedVariable(
            index=index,
            name=read_name(element),
            reference=integer(element.get("valueReference")),
            causality=element.get("causality", "local"),
            variability=element.get("variability", "continuous"),
            declared_initial=element.get("initial"),
            kind=_read_tag(type_element),
            type_attributes=type_attributes,
            type=self._type_by_name.get(declared_type),
        )

    def _type(self, element: etree._Element) -> SimpleType:
        type_element = self.find_type_element(element)
        items: list[tuple[str, int | None]] = []
        if type_element is not None:
            item_elements = type_element.findall("Item")
            items += [(read_name(item), integer(item.get("value"))) for item in item_elements]
        return SimpleType(
            name=read_name(element),
            kind=_read_tag(type_element).removesuffix("Type"),
            attributes=_attributes(type_element),
            items=tuple(items),
        )

    def _unknowns(self, list_path: str) -> Iterator[Unknown]:
        for element in self.root.findall(list_path + self.unknown):
            index = self.number(element.get(self.reference))
            if index is None:
                continue
            dependencies = None
            dependencies_text = element.get("dependencies")
            if dependencies_text is not None:
                numbers = [self.number(word) for word in dependencies_text.split()]
                dependencies = tuple(number for number in numbers if number is not None)
            kinds = tuple(element.get("dependenciesKind", "").split())
            yield Unknown(index=index, dependencies=dependencies, dependency_kinds=kinds)


class _Reader3(_Reader):
    """Value references become indices of variables, unknown ones negative numbers."""

    fmi = 3
    kinds = (*_Reader.kinds, "ScheduledExecution")
    lists: Mapping[str, str] = {
        "Outputs": "ModelStructure/Output",
        "Derivatives": "ModelStructure/ContinuousStateDerivative",
        "InitialUnknowns": "ModelStructure/InitialUnknown",
        "ClockedStates": "ModelStructure/ClockedState",
        "EventIndicators": "ModelStructure/EventIndicator",
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
            is_structural = element.get("causality") == "structuralParameter"
            if element.tag == "UInt64" and (
                is_structural or element.get("variability") == "constant"
            ):
                self._sizes[reference] = integer(element.get("start"))

    def find_type_element(self, element: etree._Element) -> etree._Element:
        return element

    def sources(self, kind: etree._Element) -> Iterator[str]:
        if self._build is None:
            return
        for build in self._build.findall("BuildConfiguration"):
            if build.get("modelIdentifier", "") == kind.get("modelIdentifier", ""):
                yield from read_names(build.findall("SourceFileSet/SourceFile"))

    def number(self, text: str | None) -> int:
        reference = integer(text)
        if reference is None:
            return -1
        return self._numbers.get(reference, -1 - reference)

    def variable(self, index: int, element: etree._Element) -> ParsedVariable:
        variable = super().variable(index, element)
        updates = {
            "variability": element.get("variability", _find_usual_variability(variable.kind)),
            "type_attributes": self._complete_attributes(element, variable.type_attributes),
            "size": self._read_size(element),
            "others": read_names(element.findall("Alias")),
        }
        return ParsedVariable(**(vars(variable) | updates))  # faster than `replace`

    def _complete_attributes(
        self, element: etree._Element, attributes: Mapping[str, str]
    ) -> dict[str, str]:
        """Return attributes with the start values of texts, and indices for value references."""
        completed = dict(attributes)
        starts = element.findall("Start")  # of a String or Binary
        if starts and "start" not in completed:
            completed["start"] = " ".join(start.get("value", "") or "?" for start in starts)
        for name in ("derivative", "previous", "clocks"):
            if name in completed:
                indices = [str(self.number(word)) for word in completed[name].split()]
                completed[name] = " ".join(indices)
        return completed

    def _read_size(self, element: etree._Element) -> int | None:
        """Return the number of elements of a variable; None if a dimension is unknown."""
        sizes = []
        for dimension in element.findall("Dimension"):
            size = integer(dimension.get("start"))
            reference = integer(dimension.get("valueReference"))
            if size is None:
                size = self._sizes.get(reference)
            elif reference is not None:
                size = None  # either a size or a reference
            if size is None:
                return None
            sizes.append(size)
        return prod(sizes)


def _find_usual_variability(kind: str) -> str:
    if kind in FLOATS:
        return "continuous"
    return "discrete"
