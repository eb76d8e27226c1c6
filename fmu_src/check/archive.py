"""Checks of the untrusted archive and its XML.

Names of entries are never used as paths. XML has no DTD and no entities, and is bounded in size.
"""

import hashlib
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from lxml import etree

from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.rules import Problem
from fmu_src.export import record
from fmu_src.run.archive import (
    DAMAGED,
    MAX_ENTRIES,
    MAX_TOTAL_BYTES,
    copy_entry,
    explain_oversize,
    explain_unreadable,
    format_error,
    hazards,
    is_folder,
    open_archive,
    open_file,
    read_member_name,
)
from hesr_model.support.process import DiedError
from hesr_model.support.text import join_few, quote, quote_names, sanitise

MAX_XML_BYTES = 64 << 20
MAX_XML_NODES = 2_000_000
"""Largest number of elements and attributes; each takes about 200 bytes of memory."""

UNCHANGED = "unchanged since its export."
_DESCRIPTIONS = ("modelDescription.xml", "SystemStructure.ssd")
SCHEMA_TIMEOUT = 60.0

_UTF8 = re.compile("utf-?8", re.IGNORECASE)
_LATIN_1 = re.compile(rb"""<\?xml [^>]*?encoding=["']ISO-8859-1["']""", re.IGNORECASE)


class _RefusedError(Exception):
    """XML that is refused."""


@dataclass
class _Guard:
    nodes: int = 0
    encoding: str | None = None

    def run(self, data: bytes, encoding: str) -> None:
        """Parse data in an encoding, regardless of the declaration."""
        parser = expat.ParserCreate(encoding)
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
        if self.nodes > MAX_XML_NODES:
            raise _RefusedError(
                f"it has more than {MAX_XML_NODES} elements and attributes; it is not read any "
                "further."
            )


def parse(name: str, file: Path) -> tuple[etree._Element | None, list[Problem]]:
    """Return the root of an XML file, or None, and its problems."""
    if file.stat().st_size > MAX_XML_BYTES:
        text = f"{name}: it has more than {MAX_XML_BYTES} bytes; it is not read."
        return None, [("xml-unreadable", text)]
    data = file.read_bytes()
    invalid_byte = _find_invalid_byte(data)
    is_latin_1 = _LATIN_1.match(data) is not None
    if invalid_byte is not None and not is_latin_1:
        text = f"it is not valid UTF-8, which FMI requires (byte {invalid_byte + 1})."
        return None, [("xml-encoding", f"{name}: {text}")]
    guard = _Guard()
    encoding = "UTF-8"
    if is_latin_1:
        encoding = "ISO-8859-1"
    try:
        guard.run(data, encoding)
        parser = etree.XMLParser(
            encoding=encoding, resolve_entities=False, load_dtd=False, no_network=True
        )
        root = etree.fromstring(data, parser)
    except _RefusedError as error:
        return None, [("xml-unreadable", f"{name}: {error}")]
    except etree.XMLSyntaxError as error:
        text = f"{name}: it cannot be read as XML ({sanitise(str(error))})."
        return None, [("xml-unreadable", text)]
    if guard.encoding is None and root.get("fmiVersion"):
        text = f"{name}: its first line declares no encoding; FMI asks for UTF-8."
        return root, [("xml-undeclared", text)]
    if guard.encoding is not None and not _UTF8.fullmatch(guard.encoding):
        text = f"{name}: its first line declares '{sanitise(guard.encoding)}'; FMI needs UTF-8."
        if root.get("fmiVersion", "").startswith("2."):
            # FMI 2.0 says so of strings only, and importers read what XML declares.
            return root, [("xml-other-encoding", text)]
        return root, [("xml-encoding", text)]
    return root, []


def _find_invalid_byte(data: bytes) -> int | None:
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        return error.start
    if b"\0" in data:  # of UTF-16, which parsers detect
        return data.index(b"\0")
    return None


def schema_problems(name: str, file: Path, reader: ReaderProcess) -> list[Problem]:
    """Return the schema violations of an XML file; time is limited, being quadratic in errors."""
    try:
        violations = reader.run("fmu_src.check.readers:compare", file, SCHEMA_TIMEOUT)
    except DiedError as error:
        text = f"{name}: it cannot be compared with the schema: the comparison {error}."
        return [("xsd", text)]
    return [
        (f"xsd:{kind}", f"{name}, line {line}: {sanitise(text, 400)}")
        for line, kind, text in violations
    ]


@dataclass(frozen=True, kw_only=True)
class Contents:
    """Readable files of an archive by name, all its names, and its problems."""

    names: tuple[str, ...] = ()
    files: dict[str, Path] = field(default_factory=dict)  # under numbered names
    problems: tuple[Problem, ...] = ()

    def read(self, name: str) -> bytes:
        """Return the content of a readable file."""
        return self.files[name].read_bytes()


def compare_with_record(contents: Contents) -> Iterator[Problem]:
    """Yield how an FMU or SSP of HESR differs from what was exported."""
    if record.MEMBER not in contents.files:
        return
    hashes = {}
    for name in contents.files:
        if name != record.MEMBER:
            hashes[name] = hashlib.sha256(contents.read(name)).hexdigest()
    try:
        changes = list(record.find_changes(contents.read(record.MEMBER), hashes))
    except ValueError as error:  # also of JSON and text
        yield "archive-changed", f"{record.MEMBER} cannot be read: {sanitise(str(error))}."
        return
    if changes:
        yield "archive-changed", f"it is not as it was exported: {join_few(changes)}."


def unpack(path: Path, folder: Path) -> Contents:
    """Read an archive into numbered files of an empty folder; raise ArtifactError."""
    with open_file(path) as file:
        try:
            archive = open_archive(file)
        except DAMAGED as error:
            text = f"it is not a readable ZIP archive ({format_error(error)})."
            return Contents(problems=(("archive-damaged", text),))
        with archive:
            return _read_all(archive, folder)


def _read_all(archive: zipfile.ZipFile, folder: Path) -> Contents:
    zip_entries = archive.infolist()
    if len(zip_entries) > MAX_ENTRIES:
        text = f"it has {len(zip_entries)} entries; more than {MAX_ENTRIES} are not read."
        return Contents(problems=(("archive-damaged", text),))
    problems: list[Problem] = []
    for entry in zip_entries:
        problems += _oddities(entry)
    problems += _duplicates([entry.filename for entry in zip_entries])
    files, reading_problems = _copy_entries(archive, folder)
    names = tuple(dict.fromkeys(read_member_name(e) for e in zip_entries if not is_folder(e)))
    return Contents(names=names, files=files, problems=(*problems, *reading_problems))


def _copy_entries(archive: zipfile.ZipFile, folder: Path) -> tuple[dict[str, Path], list[Problem]]:
    """Copy readable entries into numbered files; return these by name, and problems."""
    files: dict[str, Path] = {}
    problems = []
    unpacked = 0
    unread: list[str] = []
    for number, entry in enumerate(archive.infolist()):
        if is_folder(entry) or explain_unreadable(entry):
            continue
        unpacked += entry.file_size
        if unpacked > MAX_TOTAL_BYTES:
            unread.append(entry.filename)
            continue
        target = folder / str(number)
        try:
            copy_entry(archive, entry, target)
        except DAMAGED as error:
            text = f"the entry {quote(entry.filename)} cannot be read ({format_error(error)})."
            problems.append(("archive-damaged", text))
        else:
            files.setdefault(read_member_name(entry), target)
    if unread:
        text = (
            f"its entries claim {unpacked} bytes unpacked; more than {MAX_TOTAL_BYTES} are not "
            f"read; left out: {quote_names(dict.fromkeys(unread))}."
        )
        problems.append(("archive-large", text))
    return files, problems


def _oddities(entry: zipfile.ZipInfo) -> Iterator[Problem]:
    large = explain_oversize(entry)
    for text in hazards(entry):
        if not (large and text.endswith(large)):
            yield "archive-entry", text
        elif entry.filename in _DESCRIPTIONS:  # without it nothing is checked
            yield "archive-damaged", text
        else:
            yield "archive-large", text
    if "\\" in entry.filename:
        yield (
            "archive-backslash",
            f"the entry {quote(entry.filename)} has a backslash in its name; FMI separates "
            "folders by '/'.",
        )


def _duplicates(names: list[str]) -> Iterator[Problem]:
    first: dict[str, str] = {}
    for name in names:
        folded = name.casefold()
        if folded not in first:
            first[folded] = name
            continue
        other = first[folded]
        if other == name:
            yield "archive-duplicate", f"the entry {quote(name)} is duplicated."
        else:
            yield (
                "archive-case",
                f"the entries {quote(other)} and {quote(name)} are the same file on Windows, "
                "which ignores case.",
            )
