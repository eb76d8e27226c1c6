"""The archive: nothing of it is trusted, and no entry's name is ever used as a path."""

import re
import stat
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from fmu_src.check.report import listed, plain, quoted
from hesr_model.errors import ArtifactError

MOST_ENTRIES = 20_000
MOST_BYTES = 512 << 20
"""Unpacked size of one entry."""

MOST_BYTES_IN_ALL = 1 << 30
MOST_DIRECTORY = 16 << 20
"""Size of the archive's table of contents, which has to be held in memory."""

MOST_RATIO = 200
"""Of the unpacked to the packed size of a large entry; text has 5 to 20, a zip bomb 1000."""

_LARGE = 10 << 20
_CHUNK = 1 << 20
_DRIVE = re.compile(r"[A-Za-z]:")
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}

# What the standard library raises for archives that are damaged on purpose or by accident.
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)


@dataclass(frozen=True, kw_only=True)
class Contents:
    """What could be read of an archive.

    Attributes
    ----------
    names : of all files in it, readable or not.
    files : the file that holds the content of each readable one; its own name is a number.
    problems : one sentence each.
    """

    names: tuple[str, ...] = ()
    files: dict[str, Path] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    def read(self, name: str) -> bytes:
        """Return the content of a readable file."""
        return self.files[name].read_bytes()


class _Bounded:
    """A file that refuses to be read in one huge piece."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self._size = size
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        wanted = self._size - self._file.tell() if size < 0 else size
        if wanted > MOST_DIRECTORY:
            raise zipfile.BadZipFile(f"its table of contents has {wanted} bytes")
        return self._file.read(wanted)


def opened(path: Path) -> BinaryIO:
    """Open a file for reading.

    Raises
    ------
    ArtifactError
        If there is none or the operating system does not let it be opened.
    """
    try:
        # Before it is opened: opening a pipe waits for its other end.
        if path.exists() and not path.is_file():
            raise ArtifactError(f"{path}: is no file.")
        return path.open("rb")
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file.") from error
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be opened ({error.strerror}).") from error


def unpack(path: Path, folder: Path) -> Contents:
    """Read an archive into files that are numbered, in a folder that is empty.

    Raises
    ------
    ArtifactError
        If the archive cannot be opened.
    """
    with opened(path) as file:
        size = file.seek(0, 2)
        try:
            archive = zipfile.ZipFile(_Bounded(file, size))
        except _DAMAGED as error:
            return Contents(problems=(f"it is not a readable ZIP archive ({_said(error)}).",))
        with archive:
            return _read_all(archive, folder)


def _read_all(archive: zipfile.ZipFile, folder: Path) -> Contents:
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        text = f"it has {len(entries)} entries; more than {MOST_ENTRIES} are not looked at."
        return Contents(problems=(text,))
    problems = [text for entry in entries for text in _oddities(entry)]
    problems += _duplicates([entry.filename for entry in entries])
    files: dict[str, Path] = {}
    unpacked = 0
    unread: list[str] = []
    for number, entry in enumerate(entries):
        if _is_folder(entry) or _unreadable(entry):
            continue
        unpacked += entry.file_size
        if unpacked > MOST_BYTES_IN_ALL:
            unread.append(entry.filename)
            continue
        target = folder / str(number)
        try:
            _copy(archive, entry, target)
        except _DAMAGED as error:
            problems.append(f"the entry {quoted(entry.filename)} cannot be read ({_said(error)}).")
        else:
            files.setdefault(entry.filename, target)
    if unread:
        problems.append(
            f"its entries claim {unpacked} bytes unpacked; more than {MOST_BYTES_IN_ALL} are not "
            f"read; left out: {listed(dict.fromkeys(unread))}."
        )
    names = tuple(dict.fromkeys(e.filename for e in entries if not _is_folder(e)))
    return Contents(names=names, files=files, problems=tuple(problems))


def _copy(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    """Unpack one entry in pieces; the archive's checksum is verified at its end."""
    with archive.open(entry) as source, target.open("wb") as copy:
        while piece := source.read(_CHUNK):
            copy.write(piece)
    found = target.stat().st_size
    if found != entry.file_size:
        raise EOFError(f"it claims {entry.file_size} bytes and has {found}")


def _is_folder(entry: zipfile.ZipInfo) -> bool:
    return entry.filename.endswith("/")


def _oddities(entry: zipfile.ZipInfo) -> Iterator[str]:
    """Sentences on an entry's name and kind, and on why it is not read."""
    name, shown = entry.filename, quoted(entry.filename)
    parts = name.replace("\\", "/").split("/")
    if not name:
        yield "an entry has no name."
    elif parts[0] == "" or _DRIVE.match(name) or ".." in parts:
        yield (
            f"the entry {shown} leads out of the folder that the archive is unpacked to; needed "
            "are relative names without '..'."
        )
    if "\\" in name:
        yield f"the entry {shown} has a backslash in its name; FMI separates folders by '/'."
    if not name.isprintable() or entry.orig_filename.rstrip("\0") != name:
        yield f"the entry {quoted(entry.orig_filename)} has control characters in its name."
    if reason := _unreadable(entry):
        yield f"the entry {shown} {reason}"


def _unreadable(entry: zipfile.ZipInfo) -> str | None:
    """Why an entry is not read, if so."""
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        what = "a symbolic link" if kind == stat.S_IFLNK else "a special file"
        return f"is {what}; an FMU holds ordinary files only."
    if entry.flag_bits & 0x1:
        return "is encrypted, so that no importer can read it."
    if entry.compress_type not in _METHODS:
        return f"is compressed by method {entry.compress_type}; FMI uses 8 (deflate) or 0 (none)."
    if entry.file_size > MOST_BYTES:
        return f"claims {entry.file_size} bytes; more than {MOST_BYTES} are not read."
    if entry.file_size > max(_LARGE, MOST_RATIO * entry.compress_size):
        return (
            f"claims to unpack {entry.compress_size} bytes to {entry.file_size}, as in a zip bomb;"
            " it is not read."
        )
    return None


def _duplicates(names: list[str]) -> Iterator[str]:
    first: dict[str, str] = {}
    for name in names:
        folded = name.casefold()
        if folded not in first:
            first[folded] = name
            continue
        other = first[folded]
        if other == name:
            yield f"the entry {quoted(name)} is there more than once."
        else:
            yield (
                f"the entries {quoted(other)} and {quoted(name)} are one file where upper and "
                "lower case are the same, as on Windows."
            )


def _said(error: BaseException) -> str:
    return plain(str(error).rstrip(".") or type(error).__name__)
