"""Systems of FMUs read from an SSP of any tool."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from posixpath import normpath
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from cosim.systems.system import Conversion, SystemSpec
from fmu_src.run.archive import MOST_BYTES, MOST_TEXT, Archive
from fmu_src.run.variables import Variables, model_description
from hesr.extras.ssp.contents import (
    COUPLING,
    COUPLING_ANNOTATION,
    NAMESPACES,
    SSD,
    read_units,
)
from hesr.extras.ssp.ssp_graph import (
    TRUE,
    ConnectorGraph,
    ConnectorName,
    ElementPath,
    Hop,
    ParameterValue,
    between,
    convert_to_unit,
    number,
    safe_names,
    shown,
    transformation_of,
)
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.support.files import scratch_folder

_PREFIXES = {key.removeprefix("xmlns:"): uri for key, uri in NAMESPACES.items()}
_PREFIXES["ssm"] = _PREFIXES["ssv"].replace("Values", "Mapping")
_COUPLING = f"ssd:Annotations/ssc:Annotation[@type='{COUPLING_ANNOTATION}']/{{{COUPLING}}}Coupling"
# Steps in annotations of the engines, in any namespace because tools differ.
_STEPS = ((".//{*}FixedStepAlgorithm", "baseStepSize"), (".//{*}FixedStepMaster", "stepSize"))

_LONGEST = 100  # characters of a file name
_ROWS = 500  # by default, if neither the SSP nor its FMUs name a step
_GIVES = ("output", "local", "calculatedParameter", "constant")
_SYSTEM_GIVES = ("input", "parameter", "structuralParameter")
"""Kinds of connectors that give values: of elements, and of the enclosing system."""


class UnsupportedError(ConfigError):
    """A part of the standard is not supported."""


@contextmanager
def opened_ssp(
    path: Path, times: Mapping[str, float | None], values: Mapping[str, Any]
) -> Iterator[SystemSpec]:
    """Yield the system of an SSP as one level with all outputs observed; see `opened_system`."""
    with Archive(path, "SSP") as archive, scratch_folder() as folder:
        reader = _Reader(path, archive, Path(folder))
        try:
            content = reader.system(times, values)
        except ConfigError as error:
            if str(error).startswith(str(path)):
                raise
            raise ConfigError(f"{path}: {error}") from error
        yield SystemSpec.validated(path, content)


@dataclass(frozen=True)
class _Reader:
    path: Path
    archive: Archive
    folder: Path
    graph: ConnectorGraph = field(default_factory=ConnectorGraph)
    fmus: dict[ElementPath, Path] = field(default_factory=dict)
    steps: dict[ElementPath, str] = field(default_factory=dict)  # [s] of components
    start: dict[ElementPath, dict[str, Any]] = field(default_factory=dict)
    places: list[ElementPath] = field(default_factory=list)

    def error(self, text: str) -> ConfigError:
        return ConfigError(f"{self.path}: {text}")

    def member(self, name: str, where: str = "", most: int = MOST_BYTES) -> bytes:
        # Sources are URIs, but some tools write plain names.
        names = self.archive.names
        candidates = (normpath(n) for n in (unquote(name), name))
        member = next((n for n in candidates if n in names), None)
        if member is None:
            raise self.error(f"{where}{name} is missing.")
        return self.archive.read(member, most)

    def parsed(self, name: str, where: str = "") -> ET.Element:
        try:
            return ET.fromstring(self.member(name, where, MOST_TEXT))
        except (ET.ParseError, LookupError, ValueError) as error:  # or an unknown encoding
            raise self.error(f"{where}{name} is not valid XML ({error}).") from error

    def attribute(self, node: ET.Element, name: str, where: str) -> str:
        value = node.get(name)
        if value is None:
            raise self.error(f"{where}: attribute '{name}' is missing.")
        return value

    def refuse(self, what: str) -> UnsupportedError:
        return UnsupportedError(f"{self.path}: {what} not supported.")

    def system(
        self, times: Mapping[str, float | None], values: Mapping[str, Any]
    ) -> dict[str, Any]:
        root = self.parsed(SSD)
        system = _one(root, "ssd:System")
        if system is None:
            raise self.error(f"{SSD} contains no system.")
        where = f"{self.path}: {SSD}"
        self.elements(system, (), read_units(_all(root, "ssd:Units/ssc:Unit"), where))
        self.parameters(system, ())
        for name, value in values.items():
            if not self.assign((), name, ParameterValue(value=value)):
                raise self.error(f"--set '{name}' is no variable of the system.")
        names = safe_names("\0".join(place) for place in self.fmus)  # names may contain dots
        of = {place: names["\0".join(place)] for place in self.fmus}
        connections = {}
        conversions = {}
        for into, out, steps in sorted(self.sources(), key=lambda s: self.graph.order[s[0]]):
            target, source = (self.signal(of[place], own) for place, own in (into, out))
            connections[target] = source
            conversions[target] = steps
        return {
            "name": root.get("name", self.path.stem),
            **self.times(root, times),
            **self.order(system),
            "components": [
                {"name": of[place], "fmu": fmu, "start": self.start.get(place, {})}
                | ({"step": self.steps[place]} if place in self.steps else {})
                for place, fmu in self.fmus.items()
            ],
            "connections": connections,
            "conversions": conversions,
            "open_inputs": True,
            "observe": [self.signal(of[place], own) for place, own in self.outputs()],
        }

    def times(self, root: ET.Element, given: Mapping[str, float | None]) -> dict[str, Any]:
        experiment = _one(root, "ssd:DefaultExperiment")
        own = ET.Element("none") if experiment is None else experiment
        begin = given.get("start")
        stop = given.get("stop")
        begin = number(own, "startTime", 0.0, SSD) if begin is None else begin
        if stop is None and own.get("stopTime") is None:
            raise self.error("the default experiment has no stopTime; give --stop.")
        stop = number(own, "stopTime", 0.0, SSD) if stop is None else stop
        step = given.get("step")
        if step is not None:
            return {"begin": begin, "stop": stop, "step": step}
        for tag, key in _STEPS:
            node = root.find(tag)
            if node is not None and (text := node.get(key)):
                return {"begin": begin, "stop": stop, "step": text}
        steps = [
            float(about.defaultExperiment.stepSize)
            for fmu in self.fmus.values()
            if (about := model_description(fmu)).defaultExperiment
            and about.defaultExperiment.stepSize
        ]
        count = ceil((stop - begin) / min(steps) - 1e-6) if steps else _ROWS
        return {"begin": begin, "stop": stop, "step": (stop - begin) / max(count, 1)}

    def order(self, system: ET.Element) -> dict[str, str]:
        """Return the order of the coupling in our annotation; SSPs of other tools have none."""
        coupling = _one(system, _COUPLING)
        return {} if coupling is None else {"order": self.attribute(coupling, "order", SSD)}

    def elements(self, system: ET.Element, place: ElementPath, units: Mapping[str, Any]) -> None:
        """Read connectors and elements of a system, then its connections."""
        self.places.append(place)
        self.connectors(system, place, units)
        for node in _all(system, "ssd:Elements/*"):
            name = self.attribute(node, "name", "an element")
            kind = node.tag.rpartition("}")[2]
            own = (*place, name)
            if own in self.places:
                raise self.error(f"two elements are named '{'.'.join(own)}'.")
            if kind == "System":
                self.elements(node, own, units)
                self.parameters(node, own)
            elif kind == "Component":
                self.component(node, own)
                self.connectors(node, own, units)
                self.parameters(node, own)
            else:
                raise self.refuse(f"element '{name}' is a {kind}, which is")
        for node in _all(system, "ssd:Connections/ssd:Connection"):
            self.connection(node, place)

    def component(self, node: ET.Element, place: ElementPath) -> None:
        where = f"component '{'.'.join(place)}'"
        source = self.attribute(node, "source", where)
        if not source.lower().endswith(".fmu"):
            raise self.refuse(f"{where} is {source}, no FMU, which is")
        self.places.append(place)
        # Names may collide on other file systems.
        file = f"{re.sub(r'[^0-9A-Za-z_]', '_', place[-1])[:_LONGEST]}.fmu"
        fmu = self.folder / str(len(self.fmus)) / file
        fmu.parent.mkdir(exist_ok=True)
        fmu.write_bytes(self.member(source, f"{where}: "))
        try:
            about = model_description(fmu)
        except SimulationError as error:
            raise SimulationError(f"{self.path}: {where}: {error}") from error
        if about.coSimulation is None or about.fmiVersion not in ("2.0", "3.0"):
            raise self.refuse(
                f"{where} is of FMI {about.fmiVersion} or for model exchange only, which is"
            )
        self.fmus[place] = fmu
        self.graph.variables[place] = Variables(fmu, about)
        hint = node.find(".//{*}StepSizeHint")
        if hint is not None:
            self.steps[place] = hint.get("value", "")

    def connectors(self, node: ET.Element, place: ElementPath, units: Mapping[str, Any]) -> None:
        for connector in _all(node, "ssd:Connectors/ssd:Connector"):
            name = self.attribute(connector, "name", f"a connector of '{node.get('name')}'")
            kind = next((c for c in connector if c.tag.startswith(f"{{{_PREFIXES['ssc']}}}")), None)
            if any(connector.find(f"{p}:Dimension", _PREFIXES) is not None for p in ("ssc", "ssd")):
                raise self.refuse(f"connector '{shown((place, name))}' is an array, which is")
            unit = None if kind is None else kind.get("unit")
            self.graph.kinds[place, name] = connector.get("kind", "")
            self.graph.units[place, name] = (unit, units.get(unit)) if unit else None

    def connection(self, node: ET.Element, place: ElementPath) -> None:
        ends: list[ConnectorName] = []
        for end in ("start", "end"):
            element = node.get(f"{end}Element")
            own = place if element is None else (*place, element)
            name = self.attribute(node, f"{end}Connector", "a connection")
            if own not in self.places:
                raise self.error(
                    f"connection of '{shown((own, name))}': '{element}' is not a component of the "
                    "system."
                )
            if own not in self.fmus and (own, name) not in self.graph.kinds:
                raise self.error(
                    f"connection of '{shown((own, name))}': the system has no such connector."
                )
            if node.get(f"{end}Indices"):
                raise self.refuse(f"connection of '{shown((own, name))}': an index is")
            ends.append((own, name))
        gives = [
            self.graph.kinds.get(end) in (_SYSTEM_GIVES if end[0] == place else _GIVES)
            for end in ends
        ]
        # The order of start and end does not state a direction.
        source, target = ends[::-1] if gives[1] and not gives[0] else ends
        where = f"connection '{shown(target)}' = '{shown(source)}'"
        hop = Hop(
            target=target,
            suppressed=node.get("suppressUnitConversion") in TRUE,
            transformation=transformation_of(node, where),
        )
        self.graph.add(source, hop)

    def sources(self) -> Iterator[tuple[ConnectorName, ConnectorName, tuple[Conversion, ...]]]:
        """Yield input, output and conversions of connected components."""
        for source in list(self.graph.hops):
            for way in self.graph.ends(source) if source[0] in self.fmus else ():
                if self.graph.kinds.get(source) in ("calculatedParameter", "constant"):
                    raise self.refuse(f"connection of the parameter '{shown(source)}' is")
                steps = self.graph.conversions(source, way, self.graph.unit(source))
                yield way[-1].target, source, steps

    def outputs(self) -> list[ConnectorName]:
        """Return all outputs with a connector, or all outputs."""
        shown_ones = [
            node
            for node, kind in self.graph.kinds.items()
            if node[0] in self.fmus and kind in ("output", "calculatedParameter", "local")
        ]
        return shown_ones or [
            (place, name)
            for place, variables in self.graph.variables.items()
            for name in variables.feedthrough
        ]

    def parameters(self, node: ET.Element, place: ElementPath) -> None:
        """Apply the parameter bindings of an element, which replace those of inner ones."""
        kind = "component" if place in self.fmus else "system"
        where = f"{kind} '{'.'.join(place) or node.get('name')}'"
        for binding in _all(node, "ssd:ParameterBindings/ssd:ParameterBinding"):
            if binding.get("sourceBase") == "component":
                raise self.refuse(f"{where}: a parameter source inside an FMU is")
            source = binding.get("source")
            prefix = binding.get("prefix", "")
            sets = (
                _all(binding, "ssd:ParameterValues/ssv:ParameterSet")
                if source is None
                else [self.parsed(source, f"{where}: ")]
            )
            mapping = self.mapping(binding, where)
            for values in sets:
                units = read_units(_all(values, "ssv:Units/ssc:Unit"), f"{self.path}: {where}")
                for parameter in _all(values, "ssv:Parameters/ssv:Parameter"):
                    name = self.attribute(parameter, "name", f"{where}: a parameter")
                    value = self.value(parameter, units, f"{where}: parameter '{name}'")
                    if mapping is None:
                        self.assign(place, prefix + name, value)
                        continue
                    for target, more in mapping.get(prefix + name, ()):
                        self.assign(place, target, replace(value, **more))

    def mapping(
        self, binding: ET.Element, where: str
    ) -> dict[str, list[tuple[str, dict[str, Any]]]] | None:
        node = _one(binding, "ssd:ParameterMapping")
        if node is None:
            return None
        source = node.get("source")
        found: dict[str, list[tuple[str, dict[str, Any]]]] = {}
        root = node if source is None else self.parsed(source, f"{where}: ")
        for entry in root.iter(f"{{{_PREFIXES['ssm']}}}MappingEntry"):
            name, target = (
                self.attribute(entry, key, f"{where}: a mapping") for key in ("source", "target")
            )
            more = {
                "after": transformation_of(entry, f"{where}: mapping of '{name}'"),
                "suppressed": entry.get("suppressUnitConversion") in TRUE,
            }
            found.setdefault(name, []).append((target, more))
        return found

    def value(self, parameter: ET.Element, units: Mapping[str, Any], where: str) -> ParameterValue:
        for node in parameter:
            kind = node.tag.rpartition("}")[2]
            if kind in ("Dimension", "Binary") or (text := node.get("value")) is None:
                raise self.refuse(f"{where} is an array or of type {kind}, which is")
            if kind in ("String", "Enumeration"):
                return ParameterValue(value=text)
            if kind == "Boolean":
                return ParameterValue(value=text in TRUE)
            try:
                number = int(text) if "Int" in kind else float(text)
            except ValueError as error:
                raise self.error(f"{where} is '{text}', which is not of type {kind}.") from error
            own = node.get("unit")
            return ParameterValue(value=number, unit=(own, units.get(own)) if own else None)
        raise self.error(f"{where} has no value.")

    def assign(self, place: ElementPath, name: str, parameter: ParameterValue) -> bool:
        """Set a parameter below an element by its hierarchical name; return whether it exists."""
        found = False
        for inner in self.places:
            prefix = "".join(f"{part}." for part in inner[len(place) :])
            if inner[: len(place)] != place or not name.startswith(prefix):
                continue
            own = name.removeprefix(prefix)
            if inner in self.fmus:
                found |= self.set(inner, own, parameter)
            elif (inner, own) in self.graph.kinds:
                found = True
                for way in self.graph.ends((inner, own)):
                    self.set(*way[-1].target, parameter, (inner, own), way)
        return found

    def set(
        self,
        place: ElementPath,
        name: str,
        parameter: ParameterValue,
        connector: ConnectorName | None = None,
        way: tuple[Hop, ...] = (),
    ) -> bool:
        variables = self.graph.variables[place]
        try:
            elements = variables.elements(name)
        except SimulationError:
            return False
        where = f"{self.path}: component '{'.'.join(place)}': parameter '{name}'"
        for element in elements:
            value = parameter.value
            unit = None if parameter.suppressed else parameter.unit
            into = connector and self.graph.unit(connector)
            if unit and not connector:
                value = convert_to_unit(variables, element, value, unit, where)
            elif unit and into:
                value = between(unit, into, where)(value)
            if parameter.after:
                value = parameter.after.applied(value, where)
            if isinstance(value, str | bool):
                for change in (hop.transformation for hop in way if hop.transformation):
                    value = change.applied(value, where)
            elif connector:
                for step in self.graph.conversions(connector, way, into or unit):
                    value = step(value)
            self.start.setdefault(place, {})[element] = value
        return True

    def signal(self, component: str, connector: str) -> str:
        if not connector or re.search(r"\s", connector):
            raise self.refuse(f"connector '{connector}' of '{component}': names with spaces are")
        return f"{component}.{connector}"


def _one(node: ET.Element, path: str) -> ET.Element | None:
    return node.find(path, _PREFIXES)


def _all(node: ET.Element, path: str) -> list[ET.Element]:
    return node.findall(path, _PREFIXES)
