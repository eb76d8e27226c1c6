"""Files of an MJCF: read and parsed once, within bounds, and copied before they are compiled."""

import hashlib
import math
import os
import re
import stat
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from hesr_model.errors import ConfigError
from hesr_model.support.text import on_one_line, quote

_MAX_PARTS = 15_000  # per MJCF; compile time grows with the square, to 7 s here
_MAX_DEPTH = 500  # of elements; MuJoCo's parser reads a few less
_MAX_CELLS = 1 << 26  # of height fields and textures, in total
_MAX_FILE_BYTES = 1 << 30  # of all files, half of the memory to compile them
_MAX_SIZE = 1 << 60  # larger numbers in a file are this
_COPY_BYTES = 1 << 20  # copied at once
_DEFAULT_MODEL_NAME = "MuJoCo Model"
_MARKUP = re.compile(rb"<!--|<!\[CDATA\[|<\?|<")
_ENDS = {b"<!--": b"-->", b"<![CDATA[": b"]]>", b"<?": b"?>"}
_TAG_END = re.compile(rb"""(?:"[^"]*"|'[^']*'|[^"'<>])*>""")
_DIRECTORIES = ("assetdir", "meshdir", "texturedir")
FILE_ATTRIBUTES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
"""Attributes of an MJCF that name a file."""


@dataclass(kw_only=True, eq=False)
class _Mjcf:
    """A parsed file with its includes.

    Files are relative to one of the `folders`, which are those of the file and its includes.
    """

    path: Path
    root: Element
    folders: list[Path]
    has_includes: bool = False
    has_absolute_include: bool = False

    def find_files(self) -> Iterator[tuple[Element, str, Path]]:
        """Yield elements, attributes and files that exist, in every folder that can be meant."""
        directories = {""}
        for compiler in self.root.iter("compiler"):
            directories |= {compiler.get(kind, "") for kind in _DIRECTORIES}
        places = [folder / name for folder in self.folders for name in sorted(directories)]
        for element in self.root.iter():
            for attribute in FILE_ATTRIBUTES:
                name = element.get(attribute)
                if not name:
                    continue
                for place in places:
                    # MuJoCo may strip folders from names (`strippath`).
                    for file in dict.fromkeys((place / name, place / Path(name).name)):
                        if file.exists():
                            yield element, attribute, file

    def redirect(self, folder: Path) -> bytes | None:
        """Return the file with absolute names in a folder of copies; None if it has none."""
        root = deepcopy(self.root)
        is_changed = self.has_absolute_include
        for element in root.iter():
            for attribute in (*FILE_ATTRIBUTES, *_DIRECTORIES):
                name = element.get(attribute, "")
                if Path(name).is_absolute():
                    element.set(attribute, str(_find_copy(Path(name), folder)))
                    is_changed = True
        return ElementTree.tostring(root) if is_changed else None


class _Model(NamedTuple):
    """A model, and the number of its copies in the whole."""

    mjcf: _Mjcf
    copies: int


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfSource:
    """An MJCF as its files were at one time, within bounds.

    Attributes
    ----------
    path : file, absolute.
    data : its content with that of the files that it includes.
    files : other files that it and the models in it name.
    """

    path: Path
    data: bytes
    files: tuple[Path, ...]
    _texts: dict[Path, bytes] = field(repr=False)
    _models: tuple[_Mjcf, ...] = field(repr=False)

    @classmethod
    def read(cls, path: Path) -> "MjcfSource":
        """Read a file and all that it names; raises ConfigError for huge models and pipes."""
        reader = _Reader()
        main = reader.read(path.absolute())
        files: dict[Path, None] = {}
        models: dict[Path, _Mjcf] = {}
        parts = 0
        cells = 0
        # Each model has a part. Models that are named twice double from level to level.
        for model in islice(reader.list_models(main, {main.path.resolve()}), _MAX_PARTS + 1):
            mjcf = model.mjcf
            parts += model.copies * _count_parts(mjcf.root)
            cells += model.copies * sum(map(_count_cells, mjcf.root.iter()))
            if mjcf.path in models:
                continue
            models[mjcf.path] = mjcf
            for element, attribute, file in mjcf.find_files():
                if not file.is_file():
                    name = quote(element.get(attribute, ""))
                    raise ConfigError(
                        f"{path}: names the file {name}, which is not a regular file."
                    )
                files[file] = None
        for count, limit, noun in ((parts, _MAX_PARTS, "elements"), (cells, _MAX_CELLS, "cells")):
            if count > limit:
                raise ConfigError(f"{path}: has {count} {noun}; at most {limit} can be compiled.")
        data = reader.texts[main.path]
        if main.has_includes:
            data = ElementTree.tostring(main.root)
        return cls(
            path=main.path,
            data=data,
            files=tuple(file for file in files if file not in reader.texts),
            _texts=reader.texts,
            _models=tuple(models.values()),
        )

    @property
    def readable(self) -> list[Path]:
        """The folder of the file, and all that the file names in it or elsewhere."""
        return [self.path.parent, *self._texts, *self.files]

    def find_files(self) -> Iterator[tuple[Element, str, Path]]:
        """Yield elements of `parse` that name files, attributes and files, without other models."""
        yield from self._main.find_files()

    @property
    def root(self) -> Element:
        """The model with its includes."""
        return self._main.root

    @property
    def _main(self) -> _Mjcf:
        """The model of the file itself, which is read first."""
        return self._models[0]

    def copy_to(self, folder: Path) -> "MjcfCopy":
        """Copy all files into a folder, at their places below it; raises ConfigError."""
        hashes: dict[Path, str] = {}
        for path, data in self._texts.items():
            _write_copy(_find_copy(path, folder), data)
            hashes[path] = hashlib.sha256(data).hexdigest()
        for model in self._models:
            redirected = model.redirect(folder)
            if redirected is not None:
                _write_copy(_find_copy(model.path, folder), redirected)
        bytes_left = _MAX_FILE_BYTES
        copies: dict[Path, Path] = {}
        for file in self.files:
            copy = _find_copy(file, folder)
            source = copies.setdefault(copy.parent.resolve() / copy.name, file)
            if source != file:
                # Only links of folders can give one place to two files.
                if not source.samefile(file):
                    raise ConfigError(f"{self.path}: names two files of one place, {file}.")
                continue
            size, hashes[file] = self._copy_file(file, copy, bytes_left)
            bytes_left -= size
        # Bytes at places are all that a compiler sees.
        content = [f"{path} {digest}" for path, digest in hashes.items()]
        return MjcfCopy(path=_find_copy(self.path, folder), folder=folder, content=content)

    def _copy_file(self, file: Path, copy: Path, limit: int) -> tuple[int, str]:
        """Copy a regular file of at most `limit` bytes; return its size and hash."""
        copy.parent.mkdir(parents=True, exist_ok=True)
        try:
            # A pipe that has taken the file's place since would block.
            descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        except OSError as error:
            raise ConfigError(f"{self.path}: {file} cannot be read ({error.strerror}).") from error
        with os.fdopen(descriptor, "rb") as source:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ConfigError(f"{self.path}: {file} is not a regular file.")
            with copy.open("wb") as target:
                size, digest = _copy_bytes(source, target, limit)
        if size > limit:
            raise ConfigError(
                f"{self.path}: names files of more than {_MAX_FILE_BYTES >> 20} MiB; "
                "larger models cannot be compiled."
            )
        return size, digest


@dataclass(frozen=True, kw_only=True)
class MjcfCopy:
    """Copies of all files of a model: their folder, and the `content` as names and hashes."""

    path: Path
    folder: Path
    content: list[str]


class _Reader:
    """Reads and parses each file once."""

    def __init__(self) -> None:
        self.texts: dict[Path, bytes] = {}
        self._models: dict[Path, _Mjcf] = {}

    def read(self, path: Path) -> _Mjcf:
        """Return a file with its includes."""
        if path not in self._models:
            mjcf = _Mjcf(path=path, root=self._parse(path), folders=[path.parent])
            self._models[path] = mjcf
            self._insert_includes(mjcf, mjcf.root, path.parent, {path})
        return self._models[path]

    def list_models(self, mjcf: _Mjcf, known: set[Path], copies: int = 1) -> Iterator[_Model]:
        """Yield a model and those that it attaches, each once with the number of its copies."""
        yield _Model(mjcf, copies)
        for element in mjcf.root.iter("model"):
            for file in (folder / element.get("file", "") for folder in mjcf.folders):
                if not file.is_file() or file.resolve() in known:
                    continue
                inner = self.read(file)
                # MuJoCo's default name is that of the model in the file.
                name = element.get("name", inner.root.get("model", _DEFAULT_MODEL_NAME))
                attachments = min(_count_attachments(mjcf.root, name), _MAX_PARTS + 1)
                inner_copies = copies * max(1, attachments)  # it is read also without any
                yield from self.list_models(inner, known | {file.resolve()}, inner_copies)

    def _parse(self, path: Path) -> Element:
        if path not in self.texts:
            self.texts[path] = path.read_bytes()
        # MuJoCo permits dashes in comments.
        text = _remove_comments(self.texts[path])
        if b"<!DOCTYPE" in text:
            # MuJoCo ends it elsewhere than XML does, and would see other elements.
            raise ConfigError(f"{path}: has a document type (<!DOCTYPE>), which is not read.")
        try:
            return ElementTree.fromstring(text)
        except (ElementTree.ParseError, LookupError, ValueError) as error:  # or an encoding
            raise ConfigError(
                f"{path}: cannot be parsed as an MJCF ({on_one_line(error)})."
            ) from error

    def _insert_includes(
        self, mjcf: _Mjcf, element: Element, folder: Path, included: set[Path], depth: int = 1
    ) -> None:
        """Replace includes by their content, in an element of a file in a folder."""
        if depth > _MAX_DEPTH:
            raise ConfigError(
                f"{mjcf.path}: has more than {_MAX_DEPTH} elements within each other, which MuJoCo "
                "does not read."
            )
        for k, child in reversed(list(enumerate(element))):
            inner = child
            inner_folder = folder
            name = child.get("file", "")
            # MuJoCo looks next to the model first, then next to the file that includes.
            places = [place / name for place in (mjcf.path.parent, folder)]
            file = next((place for place in places if place.is_file()), None)
            if child.tag == "include" and file is not None and file not in included:
                included.add(file)  # MuJoCo refuses a second time
                mjcf.has_includes = True
                mjcf.has_absolute_include |= Path(name).is_absolute()
                if file.parent not in mjcf.folders:
                    mjcf.folders.append(file.parent)
                inner = self._parse(file)
                inner_folder = file.parent
            self._insert_includes(mjcf, inner, inner_folder, included, depth + 1)
            if inner is not child:
                element[k : k + 1] = list(inner)


def _remove_comments(data: bytes) -> bytes:
    """Return a file without comments; all from unfinished markup on is kept, for a parser."""
    parts = []
    start = 0
    while (markup := _MARKUP.search(data, start)) is not None:
        end = _find_end(data, markup)
        if end < 0:
            break
        parts.append(data[start : markup.start()])
        if markup[0] != b"<!--":
            parts.append(data[markup.start() : end])
        start = end
    return b"".join([*parts, data[start:]])


def _find_end(data: bytes, markup: re.Match[bytes]) -> int:
    """Return where a comment, tag or other markup ends, -1 if it does not."""
    if markup[0] == b"<":
        tag_end = _TAG_END.match(data, markup.end())
        return tag_end.end() if tag_end else -1
    mark = _ENDS[markup[0]]
    end = data.find(mark, markup.end())
    return end + len(mark) if end >= 0 else -1


def _find_copy(file: Path, folder: Path) -> Path:
    """Return the place of a file's copy in a folder; ConfigError for one above the root."""
    parts = file.parts[1:]
    depth = 0
    for part in parts:
        depth += -1 if part == ".." else 1
        if depth < 0:
            raise ConfigError(f"{file}: the name leaves the root folder.")
    return folder.joinpath(*parts)


def _write_copy(copy: Path, data: bytes) -> None:
    copy.parent.mkdir(parents=True, exist_ok=True)
    copy.write_bytes(data)


def _copy_bytes(source: BinaryIO, target: BinaryIO, limit: int) -> tuple[int, str]:
    """Copy until the end, or until more than `limit` bytes; return their number and hash."""
    digest = hashlib.sha256()
    size = 0
    while size <= limit:
        data = source.read(_COPY_BYTES)
        if not data:
            break
        target.write(data)
        digest.update(data)
        size += len(data)
    return size, digest.hexdigest()


def _count_attachments(element: Element, name: str) -> int:
    """Return how often a model is attached below an element."""
    count = sum(_count_attachments(child, name) for child in element if len(child))
    count += sum(1 for child in element if child.tag == "attach" and child.get("model") == name)
    return count * (_read_size(element, "count") if element.tag == "replicate" else 1)


def _count_parts(element: Element) -> int:
    """Return the number of elements, copies included, and of the vertices of flexible ones."""
    size = _read_size(element, "count")
    if element.tag in ("flexcomp", "composite"):
        return 1 + size + sum(map(_count_parts, element))
    copies = size if element.tag == "replicate" else 1
    return 1 + copies * sum(map(_count_parts, element))


def _count_cells(element: Element) -> int:
    """Return the number of heights of a field, or of pixels of a texture."""
    if element.tag == "hfield":
        return _read_size(element, "nrow") * _read_size(element, "ncol")
    if element.tag == "texture":
        width = _read_size(element, "width")
        is_flat = element.get("type") == "2d"  # others have six sides
        return width * (_read_size(element, "height") if is_flat else 6 * width)
    return 0


def _read_size(element: Element, attribute: str) -> int:
    """Return the product of the numbers in an attribute; what is no number counts as 1."""
    size = 1
    for word in element.get(attribute, "").split():
        try:
            number = float(word)
        except ValueError:
            continue
        size *= max(1, int(min(number, _MAX_SIZE))) if not math.isnan(number) else 1
    return min(size, _MAX_SIZE)
