"""Untrusted XML: without DTD and entities, bounded in size, and valid by the schema of FMI."""

import re
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from lxml import etree

from fmu_src.check.rules import Problem
from fmu_src.run.instance import DiedError
from fmu_src.run.sandbox import run_in_sandbox
from hesr_model.support.text import plain

MOST_BYTES = 64 << 20
MOST_NODES = 2_000_000
"""Largest number of elements and attributes; each takes about 200 bytes of memory."""

SECONDS = 60.0

_UTF8 = re.compile("utf-?8", re.IGNORECASE)


class _RefusedError(Exception):
    """XML that is refused."""


@dataclass
class _Guard:
    nodes: int = 0
    encoding: str | None = None

    def run(self, data: bytes) -> None:
        parser = expat.ParserCreate("UTF-8")  # regardless of the declaration
        parser.XmlDeclHandler = self._declaration
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._element
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            raise _RefusedError(
                f"it is not well-formed XML ({expat.ErrorString(error.code)} in line "
                f"{error.lineno}, column {error.offset + 1})."
            ) from error

    def _declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        self.encoding = encoding

    def _doctype(self, *_: object) -> None:
        # Only a DOCTYPE can declare entities, which expansion attacks need.
        raise _RefusedError("it has a DOCTYPE, which FMI does not use; it is not read any further.")

    def _element(self, _name: str, attributes: dict[str, str]) -> None:
        self.nodes += 1 + len(attributes)
        if self.nodes > MOST_NODES:
            raise _RefusedError(
                f"it has more than {MOST_NODES} elements and attributes; it is not read any "
                "further."
            )


def parse(name: str, file: Path) -> tuple[etree._Element | None, list[Problem]]:
    """Return the root of an XML file, or None, and its problems."""
    if file.stat().st_size > MOST_BYTES:
        text = f"{name}: it has more than {MOST_BYTES} bytes; it is not read."
        return None, [("xml-unreadable", text)]
    data = file.read_bytes()
    if (place := _not_utf8(data)) is not None:
        text = f"it is not valid UTF-8, which FMI requires (byte {place + 1})."
        return None, [("xml-encoding", f"{name}: {text}")]
    guard = _Guard()
    try:
        guard.run(data)
        parser = etree.XMLParser(
            encoding="utf-8", resolve_entities=False, load_dtd=False, no_network=True
        )
        root = etree.fromstring(data, parser)
    except _RefusedError as error:
        return None, [("xml-unreadable", f"{name}: {error}")]
    except etree.XMLSyntaxError as error:
        text = f"{name}: it cannot be read as XML ({plain(str(error))})."
        return None, [("xml-unreadable", text)]
    if guard.encoding is None and root.get("fmiVersion"):
        text = f"{name}: its first line declares no encoding; FMI asks for UTF-8."
        return root, [("xml-undeclared", text)]
    if guard.encoding is not None and not _UTF8.fullmatch(guard.encoding):
        text = f"{name}: its first line declares '{plain(guard.encoding)}'; FMI needs UTF-8."
        return root, [("xml-encoding", text)]
    return root, []


def _not_utf8(data: bytes) -> int | None:
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        return error.start
    # Byte-order marks of UTF-16, which parsers detect.
    return data.index(b"\0") if b"\0" in data else None


def schema_problems(name: str, file: Path, folder: Path) -> list[Problem]:
    """Return the schema violations of an XML file; time is limited, being quadratic in errors."""
    try:
        reader = "fmu_src.check.readers:compare"
        found = run_in_sandbox(reader, str(file), folder=folder, seconds=SECONDS)
    except DiedError as error:
        text = f"{name}: it cannot be compared with the schema: the comparison {error}."
        return [("xsd", text)]
    return [
        (f"xsd:{kind}", f"{name}, line {line}: {plain(text, 400)}") for line, kind, text in found
    ]
