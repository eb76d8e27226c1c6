"""Log files that libraries in C parse: a child reads them and answers numbers and text."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, NonNegativeInt, ValidationError

from hesr_model.errors import LogError
from hesr_model.logs.log_table import TextCell, compute_max_bytes
from hesr_model.support.arrays import Array
from hesr_model.support.child import INVALID_ANSWER, Child
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import DiedError
from hesr_model.support.text import escape

_PARSE = "hesr_model.logs.parsers.items:parse"
_SECONDS = 60.0  # for an item, and more for large files
_SECONDS_PER_BYTE = 1e-7  # of the allowed memory
_TOTAL_SECONDS = 24 * 3600.0  # for all items of a file
_MEMORY = 2 << 30  # [B], and more for large files
_TIME_UNITS = ("D", "h", "m", "s", "ms", "us", "ns")
_NAMES_OF_TYPES = (
    *("u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f8"),
    *(f"m8[{unit}]" for unit in _TIME_UNITS),
    *(f"M8[{unit}]" for unit in _TIME_UNITS),
)
_TYPES = {np.dtype(name).str: np.dtype(name) for name in _NAMES_OF_TYPES}
"""Types of arrays that a child can answer: numbers, times and durations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ParsedItem:
    """Named columns of a file, or of a piece of it.

    `row_count` is that of a table; `names` are lists of joint names in a bag.
    """

    columns: list[tuple[str, Array | TextCell]]
    row_count: int
    names: list[list[str]]

    @property
    def arrays(self) -> dict[str, Array]:
        """Columns of numbers by name."""
        return {name: cells for name, cells in self.columns if not isinstance(cells, TextCell)}

    @property
    def other_names(self) -> list[str]:
        """Names of columns without numbers."""
        return [name for name, cells in self.columns if isinstance(cells, TextCell)]

    def get_cells(self, k: int) -> Array | TextCell:
        """Return a column by its index."""
        return self.columns[k][1]


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class _Head(_Strict):
    """Name, type and shape of an array, or a cell of text."""

    name: str
    type: str = ""
    shape: list[NonNegativeInt] = []
    row: NonNegativeInt = 0
    text: str = ""


class _Refusal(_Strict):
    sentence: str
    code: str
    key: str


class _Answer(_Strict):
    """Data of `parsers.items.build_item`, or the refusal of a file."""

    columns: list[_Head] = []
    row_count: NonNegativeInt = 0
    names: list[list[str]] = []
    refusal: _Refusal | None = None


def has_module(name: str) -> bool:
    """Return whether an optional library is installed."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def parse_file(
    path: Path,
    kind: str,
    parser: str,
    libraries: Sequence[str],
    options: Mapping[str, Any] | None = None,
) -> Iterator[ParsedItem]:
    """Yield what a child reads from a file or the folder of a bag; raises LogError.

    `parser` is a "module:function" of `hesr_model.logs.parsers`, called with the path and JSON
    `options`; it uses `libraries`. Messages name the `kind` of the file.
    """
    file = path.absolute()
    max_bytes = compute_max_bytes(path)
    with scratch_folder() as scratch, TemporaryDirectory(dir=scratch) as folder:
        try:
            child = Child(
                Path(folder),
                _SECONDS + _SECONDS_PER_BYTE * max_bytes,
                [file],
                f"hesr_model.logs.parsers.{parser.partition(':')[0]}",
                *libraries,
                total=_TOTAL_SECONDS,
                memory=_MEMORY + 2 * max_bytes,
            )
            try:
                for data, buffers in child.iterate(
                    _PARSE, parser, str(file), dict(options or {}), limit=max_bytes
                ):
                    yield _check_item(path, child, data, buffers)
            finally:
                child.kill()
        except DiedError as error:
            raise LogError(
                f"{path}: cannot be read as {kind} (its reader {error}).",
                code="file.unreadable",
                where=path,
            ) from error


def _check_item(path: Path, child: Child, data: Any, buffers: list[bytearray]) -> ParsedItem:
    """Return the columns of an answer; raises LogError of a refusal, or DiedError."""
    try:
        answer = _Answer.model_validate(data)
        if answer.refusal is None:
            unread = iter(buffers)
            columns = [(head.name, _build_cells(head, unread)) for head in answer.columns]
            if next(unread, None) is not None:
                raise ValueError("more buffers than arrays")
            return ParsedItem(columns=columns, row_count=answer.row_count, names=answer.names)
    except (ValidationError, ValueError, OverflowError, StopIteration) as error:
        raise child.end_process(INVALID_ANSWER) from error
    refusal = answer.refusal
    sentence = refusal.sentence.replace(escape(str(path.absolute())), str(path))
    raise LogError(sentence, code=refusal.code, where=path, key=refusal.key)


def _build_cells(head: _Head, buffers: Iterator[bytearray]) -> Array | TextCell:
    """Return a column; raises ValueError, OverflowError or StopIteration."""
    if not head.type:
        return TextCell(index=head.row, text=head.text)
    if head.type not in _TYPES:
        raise ValueError("an array has another type")
    array_type = _TYPES[head.type]
    buffer = next(buffers)
    if math.prod(head.shape) * array_type.itemsize != len(buffer):
        raise ValueError("an array has another size")
    return np.frombuffer(buffer, array_type).reshape(head.shape)
