"""FMUs with one change, and the findings of a check."""

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from fmu_src.check.run import Report, check
from fmu_src.export.record import MEMBER

MODEL = "modelDescription.xml"
BINARY = "binaries/linux64/friction_parfam_h.so"


@dataclass
class Xml:
    """A modifiable model description."""

    root: Any

    def find(self, path: str) -> Any:
        element = self.root.find(path)
        assert element is not None, path
        return element

    def variables(self) -> list[Any]:
        return list(self.find("ModelVariables"))

    def variable(self, name: str) -> Any:
        return next(v for v in self.variables() if v.get("name") == name)

    def typed(self, name: str) -> Any:
        """The Real, Integer, ... element of a variable."""
        return self.variable(name)[0]

    def index(self, name: str) -> int:
        return 1 + [v.get("name") for v in self.variables()].index(name)

    def unknown(self, section: str, name: str) -> Any:
        return self.find(f"ModelStructure/{section}/Unknown[@index='{self.index(name)}']")

    def add_variable(self, kind: str, own: Mapping[str, str], **attributes: str) -> Any:
        """Add a variable at the end, so that no index changes."""
        free = str(len(self.variables()) + 1000)
        variable = etree.SubElement(
            self.find("ModelVariables"), "ScalarVariable", {"valueReference": free} | attributes
        )
        etree.SubElement(variable, kind, dict(own))
        return variable

    def add_type(self, name: str, kind: str, **attributes: str) -> Any:
        """Add a type definition and return its Real, Integer, ... element."""
        simple = etree.SubElement(self.find("TypeDefinitions"), "SimpleType", name=name)
        return etree.SubElement(simple, kind, attributes)

    def drop(self, element: Any) -> None:
        element.getparent().remove(element)

    def bytes(self) -> bytes:
        return bytes(etree.tostring(self.root, encoding="UTF-8", xml_declaration=True))


Change = Callable[[Xml], object]


def members(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def read_xml(fmu: Path) -> Xml:
    return Xml(etree.fromstring(members(fmu)[MODEL]))


def write(path: Path, content: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def changed(
    fmu: Path,
    path: Path,
    change: Change = lambda _: None,
    files: Mapping[str, bytes | None] | None = None,
) -> Path:
    """Write an FMU with a changed description and files replaced, added or (None) removed.

    Its record, which would show each change, is left out unless it is among the files.
    """
    content: dict[str, bytes | None] = {**members(fmu), MEMBER: None}
    xml = read_xml(fmu)
    change(xml)
    content[MODEL] = xml.bytes()
    content |= dict(files or {})
    return write(path, {name: data for name, data in content.items() if data is not None})


def without_binaries(fmu: Path, path: Path, **more: Any) -> Path:
    """Write an FMU as source code only, which is checked faster."""
    names = {name: None for name in members(fmu) if name.startswith("binaries/")}
    return changed(fmu, path, files=names | more.pop("files", {}), **more)


RULES = ("kind", "token", "date", "experiment", "unit", "type", "category", "variable", "alias")
RULES = (*RULES, "structure")
"""Beginnings of the names of rules on the model description."""


def texts(found: Report, of: str | tuple[str, ...] = "") -> list[str]:
    return [p.found for p in found.problems if p.check.startswith(of)]


def said(path: Path, of: str | tuple[str, ...] = "") -> list[str]:
    """Findings of rules whose names begin with `of`, for a file."""
    return texts(check(path), of)
