"""A system of FMUs as a user hands it over: a TOML file, or an SSP of any tool."""

import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

from cosim.package.markup import NAMESPACES
from cosim.package.ssp import SSD
from cosim.system import SystemSpec
from hesr_model.config import validated
from hesr_model.errors import ConfigError

_PREFIXES = {key.removeprefix("xmlns:"): uri for key, uri in NAMESPACES.items()}
# Each engine's annotation that gives the step; any namespace, since tools differ in it.
_STEPS = ((".//{*}FixedStepAlgorithm", "baseStepSize"), (".//{*}FixedStepMaster", "stepSize"))


@contextmanager
def opened_system(path: Path) -> Iterator[SystemSpec]:
    """Yield the system that a file describes; the FMUs of an SSP are unpacked for as long.

    Of an SSP are read one level of components with their connections, start values and steps; all
    outputs that have a connector are observed.

    Raises
    ------
    ConfigError
        Naming the file and what is wrong or cannot be read in it.
    """
    if path.suffix.lower() != ".ssp":
        yield SystemSpec.read(path)
        return
    try:
        archive = zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file.") from error
    except (OSError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path}: no readable SSP ({error}).") from error
    with archive, TemporaryDirectory(prefix="hesr-") as folder:
        yield validated(path, SystemSpec, _Reader(path, archive, Path(folder)).system())


@dataclass(frozen=True)
class _Reader:
    """An SSP that is being read."""

    path: Path
    archive: zipfile.ZipFile
    folder: Path

    def error(self, text: str) -> ConfigError:
        return ConfigError(f"{self.path}: {text}")

    def member(self, name: str, where: str = "") -> bytes:
        try:
            return self.archive.read(str(PurePosixPath(name)))
        except KeyError as error:
            raise self.error(f"{where}there is no {name} in it.") from error
        except (OSError, zipfile.BadZipFile, RuntimeError) as error:
            raise self.error(f"{where}{name} cannot be read ({error}).") from error

    def parsed(self, name: str, where: str = "") -> ET.Element:
        try:
            return ET.fromstring(self.member(name, where))
        except ET.ParseError as error:
            raise self.error(f"{where}{name} is no valid XML ({error}).") from error

    def attribute(self, node: ET.Element, name: str, where: str) -> str:
        value = node.get(name)
        if value is None:
            raise self.error(f"{where}: attribute '{name}' is missing.")
        return value

    def system(self) -> dict[str, Any]:
        """Return the data of a `SystemSpec`."""
        root = self.parsed(SSD)
        system = _one(root, "ssd:System")
        if system is None:
            raise self.error(f"{SSD} describes no system.")
        experiment = _one(root, "ssd:DefaultExperiment")
        stop = None if experiment is None else experiment.get("stopTime")
        if stop is None:
            raise self.error("gives no stopTime of its default experiment.")
        nodes = _all(system, "ssd:Elements/*")
        start = self.values(system, f"system '{system.get('name')}'")
        components = [self.component(node, start) for node in nodes]
        return {
            "name": root.get("name", self.path.stem),
            "step": self.step(root),
            "stop": stop,
            "components": components,
            "connections": self.connections(system),
            "observe": [
                f"{node.get('name')}.{connector.get('name')}"
                for node in nodes
                for connector in _all(node, "ssd:Connectors/ssd:Connector[@kind='output']")
            ],
        }

    def step(self, root: ET.Element) -> str:
        for tag, key in _STEPS:
            node = root.find(tag)
            if node is not None and (text := node.get(key)):
                return text
        raise self.error("gives no step, as an annotation for libcosim or OMSimulator.")

    def component(self, node: ET.Element, more: dict[str, Any]) -> dict[str, Any]:
        name = node.get("name", "")
        where = f"component '{name}'"
        if node.tag != f"{{{_PREFIXES['ssd']}}}Component":
            raise self.error(f"element '{name}' is no FMU; only one level of FMUs is read.")
        fmu = self.folder / f"{re.sub(r'[^0-9A-Za-z_]', '_', name)}.fmu"
        fmu.write_bytes(self.member(self.attribute(node, "source", where), f"{where}: "))
        outer = {
            key.removeprefix(f"{name}."): value
            for key, value in more.items()
            if key.startswith(f"{name}.")
        }
        data = {"name": name, "fmu": fmu, "start": self.values(node, where) | outer}
        hint = node.find(".//{*}StepSizeHint")
        return data if hint is None else data | {"step": hint.get("value")}

    def values(self, node: ET.Element, where: str) -> dict[str, Any]:
        """Return what the parameter bindings of an element say."""
        found: dict[str, Any] = {}
        for binding in _all(node, "ssd:ParameterBindings/ssd:ParameterBinding"):
            if _one(binding, "ssd:ParameterMapping") is not None:
                raise self.error(f"{where}: mappings of parameters are not read.")
            source, prefix = binding.get("source"), binding.get("prefix", "")
            for parameter in (
                _all(binding, "ssd:ParameterValues/ssv:ParameterSet/ssv:Parameters/ssv:Parameter")
                if source is None
                else _all(self.parsed(source, f"{where}: "), "ssv:Parameters/ssv:Parameter")
            ):
                name = self.attribute(parameter, "name", f"{where}: a parameter")
                found[prefix + name] = self.value(parameter, f"{where}: parameter '{name}'")
        return found

    def value(self, parameter: ET.Element, where: str) -> float | int | bool | str:
        for node in parameter:
            kind, text = node.tag.rpartition("}")[2], self.attribute(node, "value", where)
            if kind in ("String", "Enumeration"):
                return text
            if kind == "Boolean":
                return text in ("true", "1")
            try:
                return int(text) if kind == "Integer" else float(text)
            except ValueError as error:
                raise self.error(f"{where} is '{text}', no {kind}.") from error
        raise self.error(f"{where} has no value.")

    def connections(self, system: ET.Element) -> dict[str, str]:
        found: dict[str, str] = {}
        for node in _all(system, "ssd:Connections/ssd:Connection"):
            into, out = self.connection(node)
            if into in found:
                raise self.error(f"'{into}' is connected to '{found[into]}' and to '{out}'.")
            found[into] = out
        return found

    def connection(self, node: ET.Element) -> tuple[str, str]:
        ends = [node.get(f"{end}{what}") for end in ("end", "start")
                for what in ("Element", "Connector")]  # fmt: skip
        into, out = (".".join(filter(None, pair)) for pair in (ends[:2], ends[2:]))
        if None in ends:
            raise self.error(
                f"connection '{into}' = '{out}': connectors of the system itself are not read."
            )
        if any(child.tag.endswith("Transformation") for child in node):
            raise self.error(f"connection '{into}' = '{out}': transformations are not read.")
        return into, out


def _one(node: ET.Element, path: str) -> ET.Element | None:
    return node.find(path, _PREFIXES)


def _all(node: ET.Element, path: str) -> list[ET.Element]:
    return node.findall(path, _PREFIXES)
