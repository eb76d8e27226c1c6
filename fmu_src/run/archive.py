"""FMU and SSP archives that are checked before they are unpacked."""

import hashlib
import re
import stat
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from io import BufferedReader
from pathlib import Path
from typing import IO, Self

from hesr_model.errors import ArtifactError
from hesr_model.findings import caution, log_findings
from hesr_model.support.text import quote, sanitise

MAX_ENTRIES = 20_000
MAX_ENTRY_BYTES = 512 << 20  # of an entry, unpacked
MAX_TOTAL_BYTES = 1 << 30
MAX_DIRECTORY_BYTES = 16 << 20  # of the table of contents, which is held in memory
MAX_COMPRESSION_RATIO = 200  # compression of a large entry; text has 5 to 20, a zip bomb 1000
MAX_TEXT_BYTES = 32 << 20  # of XML and JSON; a parser needs twenty times as much memory
_MIN_SUSPECT_BYTES = 10 << 20
_CHUNK = 1 << 20
_DRIVE = re.compile(r"[A-Za-z]:")
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}

DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""Errors of the standard library for damaged archives."""


class _Bounded:
    def __init__(self, file: BufferedReader, size: int) -> None:
        self._file = file
        self._size = size
        self.seek = file.seek
        self.tell = file.tell
        self.seekable = file.seekable

    def read(self, size: int = -1) -> bytes:
        byte_count = size
        if size < 0:
            byte_count = self._size - self._file.tell()
        if byte_count > MAX_DIRECTORY_BYTES:
            raise zipfile.BadZipFile(f"its table of contents has {byte_count} bytes")
        return self._file.read(byte_count)


def open_file(path: Path) -> BufferedReader:
    """Open a file for reading; raise ArtifactError if it is missing or cannot be opened."""
    try:
        # Checked first, because opening a pipe blocks.
        if path.exists() and not path.is_file():
            raise ArtifactError(f"{path}: is not a file.")
        return path.open("rb")
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file.") from error
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be opened ({error.strerror}).") from error


def open_archive(file: BufferedReader) -> zipfile.ZipFile:
    """Open the archive in a file; raise one of `DAMAGED` if it is damaged."""
    return zipfile.ZipFile(_Bounded(file, file.seek(0, 2)))


class Archive:
    """An FMU or SSP for reading; a context manager that raises ArtifactError for hazards."""

    def __init__(self, path: Path, kind: str = "FMU") -> None:
        self.path = path
        self._kind = kind
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as cleanup:
            self._file = cleanup.enter_context(open_file(self.path))
            try:
                self._archive = cleanup.enter_context(open_archive(self._file))
                zip_entries = self._archive.infolist()
            except DAMAGED as error:
                raise self._refusal(format_error(error)) from error
            self._require_safe(zip_entries)
            files = [entry for entry in zip_entries if not is_folder(entry)]
            self._require_unique(files)
            self._entries = {read_member_name(entry): entry for entry in files}
            if any("\\" in entry.filename for entry in zip_entries):
                finding = caution(
                    check="archive-backslash",
                    where=str(self.path),
                    found="backslashes separate its folders",
                    remedy="tools on other systems than Windows may not read it",
                )
                log_findings([finding])
            self._cleanup = cleanup.pop_all()
        return self

    def _require_safe(self, zip_entries: Sequence[zipfile.ZipInfo]) -> None:
        """Raise ArtifactError for too many entries, one with a hazard, or too many bytes."""
        if len(zip_entries) > MAX_ENTRIES:
            raise self._refusal(
                f"it has {len(zip_entries)} entries; at most {MAX_ENTRIES} are read"
            )
        for entry in zip_entries:
            hazard = next(hazards(entry), None)
            if hazard is not None:
                raise self._refusal(hazard)
        size = sum(entry.file_size for entry in zip_entries)
        if size > MAX_TOTAL_BYTES:
            raise self._refusal(
                f"it claims {size} bytes unpacked; at most {MAX_TOTAL_BYTES} are read"
            )

    def _require_unique(self, files: Iterable[zipfile.ZipInfo]) -> None:
        """Raise ArtifactError for files with one name on some system, or the name of a folder."""
        name_counts = Counter(read_member_name(entry).casefold() for entry in files)
        for name, count in name_counts.items():
            if count > 1:
                raise self._refusal(f"it has {count} entries named {quote(name)}")
        for name in name_counts:
            for folder in name_counts.keys() & set(_list_folders(name)):
                raise self._refusal(f"its entry {quote(folder)} is a file and a folder")

    def __exit__(self, *_: object) -> None:
        self._cleanup.close()

    @property
    def names(self) -> list[str]:
        """Paths of its files."""
        return list(self._entries)

    def digest(self) -> str:
        """Return the SHA-256 of the open file, even if its path has been replaced."""
        self._file.seek(0)
        return hashlib.file_digest(self._file, "sha256").hexdigest()

    def read(self, name: str, max_bytes: int = MAX_ENTRY_BYTES) -> bytes:
        """Return the content of a file with at most `max_bytes` bytes."""
        entry = self._entries.get(name)
        if entry is None:
            raise self._refusal(f"its {sanitise(name)} is missing")
        if entry.file_size > max_bytes:
            raise self._refusal(
                f"its {sanitise(name)} has {entry.file_size} bytes; at most {max_bytes} are read"
            )
        try:
            return b"".join(_pieces(self._archive, entry))
        except DAMAGED as error:
            raise self._describe_damage(entry, error) from error

    def unpack(self, folder: Path, is_wanted: Callable[[str], bool] = lambda _: True) -> None:
        """Write the wanted files into a folder."""
        for name, entry in self._entries.items():
            if not is_wanted(name):
                continue
            try:
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                copy_entry(self._archive, entry, target)
            except DAMAGED as error:
                raise self._describe_damage(entry, error) from error

    def _describe_damage(self, entry: zipfile.ZipInfo, error: BaseException) -> ArtifactError:
        return self._refusal(
            f"its {sanitise(entry.filename)} cannot be read: {format_error(error)}"
        )

    def _refusal(self, reason: str) -> ArtifactError:
        return ArtifactError(f"{self.path}: not a readable {self._kind} ({reason.rstrip('.')}).")


def copy_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    """Unpack one entry; raise one of `DAMAGED` if it is damaged."""
    with target.open("wb") as copy:
        for piece in _pieces(archive, entry):
            copy.write(piece)


def _pieces(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    byte_count = 0
    source: IO[bytes]
    with archive.open(entry) as source:
        while piece := source.read(_CHUNK):
            byte_count += len(piece)
            yield piece
    if byte_count != entry.file_size:
        raise EOFError(f"it claims {entry.file_size} bytes and has {byte_count}")


def _list_folders(name: str) -> Iterator[str]:
    """Yield the folders that a file lies in."""
    folder = name
    while "/" in folder:
        folder = folder.rpartition("/")[0]
        yield folder


def is_folder(entry: zipfile.ZipInfo) -> bool:
    """Whether an entry is a folder."""
    return entry.filename.endswith(("/", "\\"))


def read_member_name(entry: zipfile.ZipInfo) -> str:
    """Return the name of an entry with '/' between folders, also where it has backslashes."""
    return entry.filename.replace("\\", "/")


def hazards(entry: zipfile.ZipInfo) -> Iterator[str]:
    """Yield a sentence for each reason why an entry is unsafe to unpack."""
    name = entry.filename
    label = quote(entry.filename)
    parts = read_member_name(entry).split("/")
    if not name:
        yield "an entry has no name."
    elif parts[0] == "" or _DRIVE.match(name) or ".." in parts:
        yield (
            f"the entry {label} leads out of the archive; expected a relative name without '..'."
        )
    if not name.isprintable() or entry.orig_filename.rstrip("\0") != name:
        yield f"the entry {quote(entry.orig_filename)} has control characters in its name."
    reason = explain_unreadable(entry)
    if reason:
        yield f"the entry {label} {reason}"


def explain_unreadable(entry: zipfile.ZipInfo) -> str | None:
    """Return why an entry is not read, or None."""
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        kind_text = "a special file"
        if kind == stat.S_IFLNK:
            kind_text = "a symbolic link"
        return f"is {kind_text}; an FMU holds ordinary files only."
    if entry.flag_bits & 0x1:
        return "is encrypted, so that no importer can read it."
    if entry.compress_type not in _METHODS:
        return f"is compressed by method {entry.compress_type}; FMI uses 8 (deflate) or 0 (none)."
    return explain_oversize(entry)


def explain_oversize(entry: zipfile.ZipInfo) -> str | None:
    """Return why an entry is too large to be read, or None."""
    if entry.file_size > MAX_ENTRY_BYTES:
        return f"claims {entry.file_size} bytes; more than {MAX_ENTRY_BYTES} are not read."
    if entry.file_size > max(_MIN_SUSPECT_BYTES, MAX_COMPRESSION_RATIO * entry.compress_size):
        return (
            f"claims to unpack {entry.compress_size} bytes to {entry.file_size}, as in a zip bomb;"
            " it is not read."
        )
    return None


def format_error(error: BaseException) -> str:
    """Return the text of an error without full stop, safe to print."""
    return sanitise(str(error).rstrip(".") or type(error).__name__)
