"""Systems of FMUs read from a TOML file, or from an SSP of any tool."""

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from pydantic import TypeAdapter, ValidationError

from cosim.systems.contents import UnitExponents, description_of
from cosim.systems.markup import NAMESPACES, SSD, ValueWithUnit, in_unit_of, read_units
from cosim.systems.system import Name, SystemSpec
from fmu_src.run.archive import MOST_BYTES, MOST_TEXT, Archive
from fmu_src.run.variables import Variables
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.support.files import scratch_folder

_PREFIXES = {key.removeprefix("xmlns:"): uri for key, uri in NAMESPACES.items()}
# Steps in annotations of the engines, in any namespace because tools differ.
_STEPS = ((".//{*}FixedStepAlgorithm", "baseStepSize"), (".//{*}FixedStepMaster", "stepSize"))

_TRUE = ("true", "1")
_LONGEST = 100  # characters of a file name
_NAME: TypeAdapter[str] = TypeAdapter(Name)


@contextmanager
def opened_system(path: Path) -> Iterator[SystemSpec]:
    """Yield the system of a file; the FMUs of an SSP are unpacked meanwhile.

    An SSP is one level of components; all outputs with a connector are observed.
    """
    if path.suffix.lower() != ".ssp":
        yield SystemSpec.read(path)
        return
    with Archive(path, "SSP") as archive, scratch_folder() as folder:
        yield SystemSpec.validated(path, _Reader(path, archive, Path(folder)).system())


@dataclass(frozen=True)
class _Reader:
    path: Path
    archive: Archive
    folder: Path

    def error(self, text: str) -> ConfigError:
        return ConfigError(f"{self.path}: {text}")

    def member(self, name: str, where: str = "", most: int = MOST_BYTES) -> bytes:
        # Sources are URIs, but some tools write plain names.
        names = self.archive.names
        candidates = (str(PurePosixPath(n)) for n in (unquote(name), name))
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

    def system(self) -> dict[str, Any]:
        root = self.parsed(SSD)
        system = _one(root, "ssd:System")
        if system is None:
            raise self.error(f"{SSD} contains no system.")
        experiment = _one(root, "ssd:DefaultExperiment")
        stop = None if experiment is None else experiment.get("stopTime")
        if stop is None:
            raise self.error("the default experiment has no stopTime.")
        nodes = _all(system, "ssd:Elements/*")
        names = safe_names(self.attribute(node, "name", "an element") for node in nodes)
        start = self.values(system, f"system '{system.get('name')}'")
        return {
            "name": root.get("name", self.path.stem),
            "step": self.step(root),
            "stop": stop,
            "components": [self.component(node, names, start) for node in nodes],
            "connections": self.connections(root, system, names),
            "observe": [
                self.signal(names[node.get("name", "")], connector, "name")
                for node in nodes
                for connector in _all(node, "ssd:Connectors/ssd:Connector[@kind='output']")
            ],
        }

    def step(self, root: ET.Element) -> str:
        for tag, key in _STEPS:
            node = root.find(tag)
            if node is not None and (text := node.get(key)):
                return text
        raise self.error("no step found; it must be in an annotation for libcosim or OMSimulator.")

    def component(
        self, node: ET.Element, names: Mapping[str, str], more: Mapping[str, Any]
    ) -> dict[str, Any]:
        name = node.get("name", "")
        where = f"component '{name}'"
        if node.tag != f"{{{_PREFIXES['ssd']}}}Component":
            raise self.error(f"element '{name}' is not an FMU; nested systems are not supported.")
        # Names may collide on other file systems.
        file = f"{re.sub(r'[^0-9A-Za-z_]', '_', names[name])[:_LONGEST]}.fmu"
        fmu = self.folder / str(list(names).index(name)) / file
        fmu.parent.mkdir(exist_ok=True)
        fmu.write_bytes(self.member(self.attribute(node, "source", where), f"{where}: "))
        outer = {
            key.removeprefix(f"{name}."): value
            for key, value in more.items()
            if key.startswith(f"{name}.")
        }
        start = self.converted(self.values(node, where) | outer, fmu, where)
        data = {"name": names[name], "fmu": fmu, "start": start}
        hint = node.find(".//{*}StepSizeHint")
        return data if hint is None else data | {"step": hint.get("value")}

    def converted(self, start: Mapping[str, Any], fmu: Path, where: str) -> Mapping[str, Any]:
        if not any(isinstance(value, ValueWithUnit) for value in start.values()):
            return start
        variables = Variables(fmu, description_of(fmu, f"{self.path}: {where}"))
        found: dict[str, Any] = {}
        for name, value in start.items():
            if not isinstance(value, ValueWithUnit):
                found[name] = value
                continue
            parameter = f"{self.path}: {where}: parameter '{name}'"
            try:
                elements = variables.elements(name)
            except SimulationError as error:
                raise ConfigError(f"{parameter}: {error}") from error
            found |= {e: in_unit_of(variables, e, value, parameter) for e in elements}
        return found

    def values(self, node: ET.Element, where: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for binding in _all(node, "ssd:ParameterBindings/ssd:ParameterBinding"):
            if _one(binding, "ssd:ParameterMapping") is not None:
                raise self.error(f"{where}: mappings of parameters are not supported.")
            source, prefix = binding.get("source"), binding.get("prefix", "")
            for values in (
                _all(binding, "ssd:ParameterValues/ssv:ParameterSet")
                if source is None
                else [self.parsed(source, f"{where}: ")]
            ):
                units = read_units(_all(values, "ssv:Units/ssc:Unit"), f"{self.path}: {where}")
                for parameter in _all(values, "ssv:Parameters/ssv:Parameter"):
                    name = self.attribute(parameter, "name", f"{where}: a parameter")
                    about = f"{where}: parameter '{name}'"
                    found[prefix + name] = self.value(parameter, units, about)
        return found

    def value(
        self, parameter: ET.Element, units: Mapping[str, UnitExponents], where: str
    ) -> float | int | bool | str | ValueWithUnit:
        for node in parameter:
            kind, text = node.tag.rpartition("}")[2], self.attribute(node, "value", where)
            if kind in ("String", "Enumeration"):
                return text
            if kind == "Boolean":
                return text in _TRUE
            try:
                number = int(text) if kind == "Integer" else float(text)
            except ValueError as error:
                raise self.error(f"{where} is '{text}', which is not of type {kind}.") from error
            unit = node.get("unit")
            return ValueWithUnit(value=number, unit=unit, base=units.get(unit)) if unit else number
        raise self.error(f"{where} has no value.")

    def signal(self, component: str, node: ET.Element, key: str) -> str:
        connector = self.attribute(node, key, f"a connector of '{component}'")
        if not connector or re.search(r"\s", connector):
            raise self.error(
                f"connector '{connector}' of '{component}': names with spaces are not supported."
            )
        return f"{component}.{connector}"

    def connections(
        self, root: ET.Element, system: ET.Element, names: Mapping[str, str]
    ) -> dict[str, str]:
        defined = read_units(_all(root, "ssd:Units/ssc:Unit"), f"{self.path}: {SSD}")
        units = {
            (node.get("name"), connector.get("name")): kind.get("unit", "")
            for node in _all(system, "ssd:Elements/*")
            for connector in _all(node, "ssd:Connectors/ssd:Connector")
            for kind in connector
        }
        found: dict[str, str] = {}
        for node in _all(system, "ssd:Connections/ssd:Connection"):
            into, out = self.connection(node, names)
            if into in found:
                raise self.error(f"'{into}' is connected to '{found[into]}' and to '{out}'.")
            found[into] = out
            taken, given = (
                units.get((node.get(f"{end}Element"), node.get(f"{end}Connector")), "")
                for end in ("end", "start")
            )
            known = taken in defined and given in defined
            differ = known and defined[taken] != defined[given]
            if differ and node.get("suppressUnitConversion") not in _TRUE:
                raise self.error(
                    f"connection '{into}' = '{out}': the input is in {taken}, the output in "
                    f"{given}."
                )
        return found

    def connection(self, node: ET.Element, names: Mapping[str, str]) -> tuple[str, str]:
        ends = [
            node.get(f"{end}{what}")
            for end in ("end", "start")
            for what in ("Element", "Connector")
        ]
        into, out = (".".join(filter(None, pair)) for pair in (ends[:2], ends[2:]))
        where = f"connection '{into}' = '{out}'"
        if None in ends:
            raise self.error(f"{where}: connectors of the system itself are not supported.")
        if any(child.tag.endswith("Transformation") for child in node):
            raise self.error(f"{where}: transformations are not supported.")
        for element in (ends[0], ends[2]):
            if element not in names:
                raise self.error(f"{where}: '{element}' is not a component of the system.")
        into, out = (
            self.signal(names[str(node.get(f"{end}Element"))], node, f"{end}Connector")
            for end in ("end", "start")
        )
        return into, out


def _one(node: ET.Element, path: str) -> ET.Element | None:
    return node.find(path, _PREFIXES)


def _all(node: ET.Element, path: str) -> list[ET.Element]:
    return node.findall(path, _PREFIXES)


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """Map names of components to unique names that a system allows.

    Other characters become `_`; colliding names get a number.
    """
    names = list(dict.fromkeys(names))
    found = {name: name for name in names if _allowed(name)}
    taken = set(found)
    for name in names:
        if name in found:
            continue
        plain = re.sub(r"[^0-9A-Za-z_]", "_", name)
        plain = plain if _allowed(plain) else f"_{plain}"
        numbered = (f"{plain}_{k}" for k in count(2))
        found[name] = next(n for n in chain([plain], numbered) if n not in taken)
        taken.add(found[name])
    return found


def _allowed(name: str) -> bool:
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True
