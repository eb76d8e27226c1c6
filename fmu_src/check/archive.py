"""Checks of the untrusted archive; names of entries are never used as paths."""

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fmu_src.check.rules import Problem
from fmu_src.run.archive import (
    DAMAGED,
    MOST_BYTES_IN_ALL,
    MOST_ENTRIES,
    copy_entry,
    entries,
    hazards,
    is_folder,
    opened,
    oversize,
    said,
    unreadable,
)
from hesr_model.support.text import listed, quoted


@dataclass(frozen=True, kw_only=True)
class Contents:
    """Readable files of an archive by name, all its names, and its problems."""

    names: tuple[str, ...] = ()
    files: dict[str, Path] = field(default_factory=dict)  # under numbered names
    problems: tuple[Problem, ...] = ()

    def read(self, name: str) -> bytes:
        """Return the content of a readable file."""
        return self.files[name].read_bytes()


def unpack(path: Path, folder: Path) -> Contents:
    """Read an archive into numbered files of an empty folder; raise ArtifactError."""
    with opened(path) as file:
        try:
            archive = entries(file)
        except DAMAGED as error:
            text = f"it is not a readable ZIP archive ({said(error)})."
            return Contents(problems=(("archive-damaged", text),))
        with archive:
            return _read_all(archive, folder)


def _read_all(archive: zipfile.ZipFile, folder: Path) -> Contents:
    found = archive.infolist()
    if len(found) > MOST_ENTRIES:
        text = f"it has {len(found)} entries; more than {MOST_ENTRIES} are not checked."
        return Contents(problems=(("archive-large", text),))
    problems = [problem for entry in found for problem in _oddities(entry)]
    problems += _duplicates([entry.filename for entry in found])
    files: dict[str, Path] = {}
    unpacked = 0
    unread: list[str] = []
    for number, entry in enumerate(found):
        if is_folder(entry) or unreadable(entry):
            continue
        unpacked += entry.file_size
        if unpacked > MOST_BYTES_IN_ALL:
            unread.append(entry.filename)
            continue
        target = folder / str(number)
        try:
            copy_entry(archive, entry, target)
        except DAMAGED as error:
            text = f"the entry {quoted(entry.filename)} cannot be read ({said(error)})."
            problems.append(("archive-damaged", text))
        else:
            files.setdefault(entry.filename, target)
    if unread:
        text = (
            f"its entries claim {unpacked} bytes unpacked; more than {MOST_BYTES_IN_ALL} are not "
            f"read; left out: {listed(dict.fromkeys(unread))}."
        )
        problems.append(("archive-large", text))
    names = tuple(dict.fromkeys(e.filename for e in found if not is_folder(e)))
    return Contents(names=names, files=files, problems=tuple(problems))


def _oddities(entry: zipfile.ZipInfo) -> Iterator[Problem]:
    large = oversize(entry)
    for text in hazards(entry):
        yield "archive-large" if large and text.endswith(large) else "archive-entry", text
    if "\\" in entry.filename:
        yield (
            "archive-backslash",
            f"the entry {quoted(entry.filename)} has a backslash in its name; FMI separates "
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
            yield "archive-duplicate", f"the entry {quoted(name)} is duplicated."
        else:
            yield (
                "archive-case",
                f"the entries {quoted(other)} and {quoted(name)} are the same file on Windows, "
                "which ignores case.",
            )
