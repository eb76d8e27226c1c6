"""Tables as text, also packed: delimiter, header, encoding."""

import bz2
import codecs
import csv
import gzip
import io
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from hesr_model.errors import LogError
from hesr_model.logs.log_table import LogTable, listed, most_bytes, require_columns

_MOST_CSV = 2**31 - 2  # bytes of a single block
_LONGEST_LINE = 2**24  # characters
_DELIMITERS = ",;\t "
_MARKS = "#%"  # marks of comments, sometimes of a header
_SEARCHED = 500  # lines searched for data
_HEADERLESS = 20  # rows of data that prove the absence of a header
_UNIT_CELL = re.compile(r"[(\[].*[)\]]|rad|deg|°|s|ms|us|ns|A|mA|N\.?m|rad/s|deg/s|-|")
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")  # decimal comma
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|\d{4}-\d\d-\d\d[T ][\d:.]+Z?")
_UNPACKERS: Mapping[bytes, Callable[[Path], io.BufferedIOBase]] = {
    b"\x1f\x8b": gzip.GzipFile,
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ": lzma.LZMAFile,
}


def read_text(path: Path, names: Sequence[str] = (), content: bytes | None = None) -> LogTable:
    """Open text as a table, with the `names` of its columns if it has no header; raises LogError.

    The `content` replaces that of the file.
    """
    _require_length(path, path.stat().st_size)
    content = _content(path) if content is None else content
    length = path.stat().st_size if content is None else len(content)
    _require_length(path, length)
    text = _dialect(path, content, names)
    return LogTable.of(path, _arrow(text, length), partial(_row, text), text.decimal)


def _require_length(path: Path, length: int) -> None:
    if length > _MOST_CSV:
        raise LogError(
            f"{path}: is {length / 1e9:.1f} GB long; a CSV of up to {_MOST_CSV / 1e9:.1f} GB can "
            "be read; use Parquet, or split it."
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Text:
    path: Path
    content: bytes | None  # instead of the file's
    names: tuple[str, ...]  # instead of a header
    delimiter: str
    decimal: str
    header: int  # line, from 1; 0 without
    data: int  # line of the first row


def _opened(path: Path, content: bytes | None) -> BinaryIO:
    return path.open("rb") if content is None else io.BytesIO(content)


def _as_text(path: Path, content: bytes | None, newline: str | None = None) -> TextIO:
    return io.TextIOWrapper(_opened(path, content), encoding="utf-8-sig", newline=newline)


def _content(path: Path) -> bytes | None:
    """Return packed or UTF-16 text as UTF-8; None for any other file."""
    with path.open("rb") as file:
        start, content = file.read(8), None
    if unpack := next((f for magic, f in _UNPACKERS.items() if start.startswith(magic)), None):
        try:
            with unpack(path) as packed:
                content = packed.read(most_bytes(path) + 1)
        except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
            raise LogError(
                f"{path}: cannot be unpacked; it is truncated or damaged, so copy or record it "
                "again."
            ) from error
        if len(content) > most_bytes(path):
            raise LogError(f"{path}: unpacks to more than {most_bytes(path) / 1e6:.0f} MB.")
        start = content[:8]
    marked = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    without_mark = {b"\1\0\1\0": "utf-16-le", b"\0\1\0\1": "utf-16-be"}
    encoding = "utf-16" if marked else without_mark.get(bytes(map(bool, start[:4])))
    if not encoding:
        return content
    try:
        return (path.read_bytes() if content is None else content).decode(encoding).encode()
    except UnicodeDecodeError as error:
        raise _no_csv(path) from error


def _dialect(path: Path, content: bytes | None, names: Sequence[str]) -> _Text:
    try:
        with _as_text(path, content) as file:
            numbered = ((k, line.strip()) for k, line in enumerate(_lines(file), start=1))
            head = list(islice(((k, line) for k, line in numbered if line), _SEARCHED))
            header, data, delimiter = _table_in(path, head, names)
            # A log may begin with zeros without decimal sign.
            commas = delimiter != "," and any(
                _COMMA.fullmatch(cell.strip())
                for _, line in chain(((k, line) for k, line in head if k >= data), numbered)
                if "," in line
                for cell in line.split(delimiter)
            )
    except (UnicodeDecodeError, csv.Error) as error:
        raise _no_csv(path) from error
    return _Text(
        path=path,
        content=content,
        names=tuple(names),
        delimiter=delimiter,
        decimal="," if commas else ".",
        header=header,
        data=data,
    )


def _table_in(
    path: Path, lines: Sequence[tuple[int, str]], names: Sequence[str]
) -> tuple[int, int, str]:
    """Return the lines of the header (else the first) and of the first row, and the delimiter.

    The first row has numbers, and is below a line with as many names; or has as many as `names`.
    """
    bare: list[tuple[int, list[str]]] = []  # rows without a header, and number of cells above
    for at, (number, line) in enumerate(lines):
        for delimiter in sorted(_DELIMITERS, key=lambda d: -line.count(d)):
            if not _is_data(line, delimiter):
                continue
            cells = _cells(line, delimiter)
            if len(cells) == len(names) and not _is_count(cells):
                return 0, number, delimiter
            above = [(k, text.lstrip(_MARKS + " ")) for k, text in reversed(lines[:at])]
            fitting = [(k, text) for k, text in above if _count(text, delimiter) == len(cells)]
            units = [k for k, text in fitting[:1] if _are_units(text, delimiter)]
            named = fitting[1:] if units and len(fitting) > 1 else fitting
            if named and not names and not _is_row(named[0][1], delimiter):
                return named[0][0], number, delimiter
            titled = at > 0 and lines[at - 1][1][0] not in _MARKS
            bare.append((_count(lines[at - 1][1], delimiter) if titled else 1, cells))
        if len(bare) >= _HEADERLESS:
            break
    if bare and (names or bare[0][0] == 1):
        raise _headerless(path, bare[0][1], names)
    number, header = lines[0] if lines else (1, "")
    first = lines[1][1] if len(lines) > 1 else ""
    header = header.lstrip(_MARKS + " ")
    there = [d for d in _DELIMITERS if d in header] or [","]
    # Names may contain other delimiters.
    alike = [d for d in there if _count(header, d) == _count(first, d)] or there[:1]
    return number, number + 1, max(alike, key=lambda d: _count(header, d))


def _headerless(path: Path, row: Sequence[str], names: Sequence[str]) -> LogError:
    if names:
        return LogError(
            f"{path}: its rows have {len(row)} cells, such as {listed(row)}, but 'log.columns' of "
            f"the robot file names {len(names)} columns; name them all."
        )
    return LogError(
        f"{path}: has no header, its first row is {listed(row)}; name its {len(row)} columns under "
        "'log.columns' of the robot file, such as columns = ['t', 'q1', 'dq1', 'tau1']."
    )


def _is_data(line: str, delimiter: str) -> bool:
    """Return whether a line has numbers, some may be missing."""
    if line[0] in _MARKS or delimiter not in line:
        return False
    cells = _cells(line, delimiter)
    numbers = sum(bool(_NUMBER.fullmatch(cell)) for cell in cells)
    return numbers > 0 and 2 * numbers >= len(cells)


def _is_row(line: str, delimiter: str) -> bool:
    """Return whether a line has nothing but numbers; a header may count its columns."""
    cells = _cells(line, delimiter)
    plain = all(_NUMBER.fullmatch(cell) or cell.lower() in ("", "nan") for cell in cells)
    return plain and not _is_count(cells)


def _is_count(cells: Sequence[str]) -> bool:
    return len(cells) > 2 and any(
        list(cells) == [str(k + first) for k in range(len(cells))] for first in (0, 1)
    )


def _are_units(line: str, delimiter: str) -> bool:
    return all(_UNIT_CELL.fullmatch(cell.strip()) for cell in line.split(delimiter))


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _count(line: str, delimiter: str) -> int:
    return len(_cells(line, delimiter))


def _lines(file: TextIO) -> Iterator[str]:
    while line := file.readline(_LONGEST_LINE):
        if "\0" in line or (len(line) == _LONGEST_LINE and not line.endswith("\n")):
            raise csv.Error("not a line of text")
        yield line


def _rows(text: _Text) -> Iterator[tuple[int, list[str]]]:
    """Yield header and rows with their lines from 1."""
    try:
        with _as_text(text.path, text.content, newline="") as file:
            reader = csv.reader(_lines(file), delimiter=text.delimiter)
            for cells in reader:
                number = reader.line_num
                is_row = number >= text.data and not _is_comment(cells)
                if cells and (number == text.header or is_row):
                    yield number, cells
    except (UnicodeDecodeError, csv.Error) as error:
        raise _no_csv(text.path) from error


def _row(text: _Text, index: int) -> int:
    try:
        return next(number for number, _ in islice(_rows(text), index + bool(text.header), None))
    except (LogError, StopIteration):  # Arrow reads more than Python
        return index + 1 + bool(text.header)


def _no_csv(path: Path) -> LogError:
    return LogError(f"{path}: cannot be read as CSV text.")


def _is_comment(cells: Sequence[str]) -> bool:
    return bool(cells) and cells[0].lstrip()[:1] in tuple(_MARKS)


def _arrow(text: _Text, length: int) -> Any:
    import pyarrow
    import pyarrow.csv

    names = list(text.names) or _names(next(_rows(text), (0, []))[1])
    if not names:
        raise LogError(f"{text.path}: is empty; a log needs a header and rows of data.")
    require_columns(text.path, len(names))
    options = pyarrow.csv.ReadOptions(
        column_names=names,
        skip_rows=text.data - 1,
        # One block: types follow from all rows, not the first megabyte.
        block_size=length + 1,
    )
    try:
        with _opened(text.path, text.content) as file:
            return pyarrow.csv.read_csv(
                file,
                options,
                pyarrow.csv.ParseOptions(
                    delimiter=text.delimiter,
                    invalid_row_handler=lambda row: (
                        "skip" if _is_comment([row.text or ""]) else "error"
                    ),
                ),
                pyarrow.csv.ConvertOptions(decimal_point=text.decimal),
            )
    except pyarrow.ArrowInvalid as error:
        raise _ragged(text, len(names)) from error


def _names(header: Sequence[str]) -> list[str]:
    names = [name.strip() for name in header]
    if names[:1] == ["#"]:
        return names[1:]
    return [names[0].removeprefix("#").strip(), *names[1:]] if names else []


def _ragged(text: _Text, width: int) -> LogError:
    """Return the error at the first row of another length."""
    for number, cells in islice(_rows(text), bool(text.header), None):
        if len(cells) != width:
            return LogError(
                f"{text.path}: row {number} has {len(cells)} cells; the header has {width} columns."
            )
    return _no_csv(text.path)
