"""Tables as text, also packed: delimiter, header, encoding."""

import bz2
import codecs
import csv
import gzip
import io
import logging
import lzma
import re
import warnings
import zlib
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, product
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.column_names import is_unit
from hesr_model.logs.json_records import convert_records, is_json
from hesr_model.logs.log_table import (
    LogTable,
    TextCell,
    compute_max_bytes,
    join_names,
    require_columns,
)
from hesr_model.support.arrays import Array
from hesr_model.support.text import format_settings

_log = logging.getLogger(__name__)

_MAX_CSV = 2**31 - 2  # bytes
_MAX_LINE_LENGTH = 2**24  # characters
_DELIMITERS = ",;\t "
_COMMENT_MARKS = "#%"  # marks of comments, sometimes of a header
_COMMENTS = "are numbers in comments"  # cause of rows that are left out
_MAX_SEARCHED_LINES = 500  # lines searched for data
_MIN_HEADERLESS_ROWS = 20  # rows of data that prove the absence of a header
_MIN_LABELLED_ROWS = 3  # rows that must all begin with a text to be labelled data
_BRACKETED = re.compile(r"[(\[<{](.*)[)\]>}]")
_NO_UNIT = ("", "-", "1")  # of a column in a row of units
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?(\s*[^\d\s.,]\S*)?")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|\d{4}-\d\d-\d\d[T ][\d:.]+Z?")
_TIME = re.compile(
    r"(1[7-9]|2[01])\d\d-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?(Z|[+-]\d\d(:?\d\d)?)?)?"
)
_MISSING = re.compile(
    r"-*|\?|none|n/?a|<na>|#n/?a|\(?null\)?|<?missing>?|undefined|#(value|num)!|#div/0!"
    r"|[-+]?1\.#(ind|qnan|snan)0*|[-+]?nan(\(s?(nan|ind)\))?",
    re.IGNORECASE,
)  # what programs write where there is no number, some of them of Windows
_INFINITY = re.compile(r"([-+]?)1\.#INF0*")  # as Windows writes it
_DURATION = re.compile(
    r"([-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)\s*(s|sec|secs|seconds?|ms|msec|us|µs|ns|min)"
)
_QUANTITY = re.compile(r"([-+]?[\d.,]+(?:[eE][-+]?\d+)?)(?:\s+(\S.*)|([^\d\s.,]\S*))")
_CLOCK = re.compile(r"([-+]?)(\d{1,4}):([0-5]\d):([0-5]\d(?:\.\d+)?)")  # as MATLAB's durations
_NANOSECONDS = {"m": 1e6, "u": 1e3, "µ": 1e3, "n": 1.0, "s": 1e9}  # by first letter; not of min
_LIST = re.compile(r"(?:array\()?(?:'\w', ?)?[\[({]([^\[\](){}]*)[\])}]\)?")
_CUT_NUMBER = re.compile(r".*([eE]|[-+.])")  # a number that goes on
_MIN_UNCUT_ROWS = 20  # rows whose last cells show that a shorter one is cut
_TRUTHS = {"true": 1.0, "1": 1.0, "false": 0.0, "0": 0.0, "nan": float("nan")}
_START_BYTES = 2**16
_CONTROL_BYTES = re.compile(rb"[\0-\x08\x0e-\x1f]")  # bytes that show the encoding
_SWAP_COMMA = str.maketrans(",.", ".,")  # a decimal comma excludes points
_CHUNK_CELLS = 2**18  # cells converted at once
_MAX_EXACT_INTEGER = 2.0**53  # larger integers exceed the digits of a float
_UNPACKERS: Mapping[bytes, Callable[[Path], io.BufferedIOBase]] = {
    b"\x1f\x8b": gzip.GzipFile,
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ": lzma.LZMAFile,
}


class HeaderError(LogError):
    """A table without names; `suggestion` has a name for each of its columns."""

    suggestion: tuple[str, ...] = ()


def read_text(path: Path, names: Sequence[str] = (), content: bytes | None = None) -> LogTable:
    """Open a text file, or `content` instead, with `names` if it has no header; raises LogError."""
    _require_length(path, path.stat().st_size)
    content = _read_content(path) if content is None else content
    _require_length(path, len(content or b""))
    dialect = _find_dialect(path, content, names)
    return _join_chunks(dialect, _read_chunks(dialect))


def text_pieces(path: Path, names: Sequence[str], max_rows: int) -> Iterator[LogTable]:
    """Yield the tables of successive lines, up to `max_rows` each; raises LogError."""
    dialect = _find_dialect(path, _read_content(path), names)
    yield from (
        _join_chunks(dialect, [chunk]) for chunk in _read_chunks(dialect, max_rows) if chunk.numbers
    )


def _require_length(path: Path, length: int) -> None:
    if length > _MAX_CSV:
        raise LogError(
            f"{path}: is {length / 1e9:.1f} GB long; a CSV of up to {_MAX_CSV / 1e9:.1f} GB can "
            "be read; use Parquet, or split it.",
            code="log.too_large",
            where=path,
        )


@dataclass(frozen=True, eq=False)
class _Dialect:
    """How the text of a table is written."""

    path: Path
    content: bytes | None  # instead of the file's
    names: tuple[str, ...]  # instead of a header
    delimiter: str
    decimal: str
    header_line: int  # from 1; 0 without
    first_line: int  # of the rows
    unit_row: tuple[str, ...] = ()  # units by column, "" without one; empty without such a row
    comment_marks: str = _COMMENT_MARKS
    other_names: tuple[str, ...] = ()  # names in the file other than columns


def _open_text(path: Path, content: bytes | None, newline: str | None = None) -> TextIO:
    file: BinaryIO = io.BytesIO(content or b"")
    if content is None:
        file = path.open("rb")
    return io.TextIOWrapper(file, encoding="utf-8-sig", newline=newline)


def _read_content(path: Path) -> bytes | None:
    """Return packed text, or text that is not UTF-8, as UTF-8; None for any other file."""
    with path.open("rb") as file:
        start = file.read(_START_BYTES)
    content = None
    for magic, open_packed in _UNPACKERS.items():
        if start.startswith(magic):
            content = _unpack(path, open_packed)
            start = content[:_START_BYTES]
            break
    encoding = _find_encoding(start)
    if not encoding:
        return content
    _require_length(path, path.stat().st_size)
    if content is None:
        content = path.read_bytes()
    try:
        return content.decode(encoding).encode()
    except UnicodeDecodeError as error:
        raise _build_csv_error(path) from error


def _unpack(path: Path, open_packed: Callable[[Path], io.BufferedIOBase]) -> bytes:
    """Return the content of a packed file; raises LogError."""
    _require_length(path, path.stat().st_size)
    try:
        with open_packed(path) as packed:
            content = packed.read(compute_max_bytes(path) + 1)
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        raise LogError(
            f"{path}: cannot be unpacked; it is truncated or damaged, so copy or record it again.",
            code="file.unreadable",
            where=path,
        ) from error
    if len(content) > compute_max_bytes(path):
        raise LogError(
            f"{path}: unpacks to more than {compute_max_bytes(path) / 1e6:.0f} MB.",
            code="log.too_large",
            where=path,
        )
    return content


def _find_encoding(start: bytes) -> str | None:
    """Return the encoding of a text that begins with `start`, None for UTF-8 or no text."""
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    encoding_by_start = {b"\1\0\1\0": "utf-16-le", b"\0\1\0\1": "utf-16-be"}
    encoding = encoding_by_start.get(bytes(map(bool, start[:4])))
    if encoding:
        return encoding
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        if not _CONTROL_BYTES.search(start):
            return "cp1252"  # a degree sign of Windows
    return None


def _find_dialect(path: Path, content: bytes | None, names: Sequence[str]) -> _Dialect:
    try:
        with _open_text(path, content) as file:
            if is_json(file.buffer.read(_START_BYTES)):
                file.seek(0)
                json_names, table, other_names = convert_records(path, file.read())
                return _Dialect(path, table, json_names, ",", ".", 0, 1, (), "", other_names)
        with _open_text(path, content) as file:
            lines = enumerate(map(_strip_line, _read_lines(file)), start=1)
            filled_lines = (
                numbered_line for numbered_line in lines if numbered_line[1].strip(_DELIMITERS)
            )
            head = list(islice(filled_lines, _MAX_SEARCHED_LINES))
            header, data, delimiter = _find_table(path, head, names)
            unit_row = _find_unit_row(head, header, data, delimiter)
            rows = chain(
                (line for k, line in head if k >= data), (line for _, line in filled_lines)
            )
            decimal = "."
            # A log may begin with zeros without decimal sign.
            if delimiter != "," and any(_has_decimal_comma(row, delimiter) for row in rows):
                decimal = ","
    except (UnicodeDecodeError, csv.Error) as error:
        raise _build_csv_error(path) from error
    return _Dialect(path, content, tuple(names), delimiter, decimal, header, data, unit_row)


def _strip_line(line: str) -> str:
    return line.strip(" \r\n")


def _has_decimal_comma(row: str, delimiter: str) -> bool:
    if "," not in row:
        return False
    return any(_DECIMAL_COMMA.fullmatch(cell.strip()) for cell in row.split(delimiter))


def _find_table(
    path: Path, lines: Sequence[tuple[int, str]], names: Sequence[str]
) -> tuple[int, int, str]:
    """Return the lines of the header (else the first) and of the first row, and the delimiter."""
    # Rows without a header, with the number of cells of the line above.
    headerless_rows: list[tuple[int, list[str]]] = []
    for index, (number, line) in enumerate(lines):
        # Blanks stand beside other separators as well.
        for delimiter in sorted(_DELIMITERS, key=lambda d: (d == " ", -line.count(d))):
            if not _begins_data(lines[index:], delimiter):
                continue
            cells = _split_cells(line, delimiter)
            if names and _has_length(cells, len(names)) and not _is_count(cells):
                return 0, number, delimiter
            if not names:
                header_number = _find_header(lines[:index], cells, delimiter)
                if header_number is not None:
                    return header_number, number, delimiter
            headerless_rows.append((_measure_title(lines[:index], delimiter), cells))
        if len(headerless_rows) >= _MIN_HEADERLESS_ROWS:
            break
    if headerless_rows and (names or headerless_rows[0][0] == 1):
        raise _build_headerless_error(path, headerless_rows[0][1], names)
    return _choose_first_line(lines)


def _find_header(
    lines_above: Sequence[tuple[int, str]], cells: Sequence[str], delimiter: str
) -> int | None:
    """Return the number of the line that names the cells of a row; None without one."""
    fitting_lines = []
    for number, text in reversed(lines_above):
        plain_text = text.lstrip(_COMMENT_MARKS + " ")
        if _has_length(cells, _count_cells(plain_text, delimiter)):
            fitting_lines.append((number, plain_text))
    if len(fitting_lines) > 1 and _is_unit_row(fitting_lines[0][1], delimiter):
        fitting_lines.pop(0)
    if not fitting_lines or _has_values(fitting_lines[0][1], delimiter):
        return None
    return fitting_lines[0][0]


def _find_unit_row(
    lines: Sequence[tuple[int, str]], header: int, data: int, delimiter: str
) -> tuple[str, ...]:
    """Return the units by column of a row next to the header, maybe above; empty without one."""
    plain_lines = {
        number: text.lstrip(_COMMENT_MARKS + " ") for number, text in lines if number <= data
    }
    names_line = plain_lines.get(header or data, "")
    for number, text in plain_lines.items():
        is_as_long = _count_cells(text, delimiter) == _count_cells(names_line, delimiter)
        if number not in (header, data) and is_as_long and _is_unit_row(text, delimiter):
            cells = map(_read_unit_cell, text.split(delimiter))
            units = tuple("" if unit in _NO_UNIT else unit for unit in cells)
            if any(units):
                return units
    return ()


def _measure_title(lines_above: Sequence[tuple[int, str]], delimiter: str) -> int:
    """Return the number of cells of the line above a row; 1 for a comment, or without one."""
    if not lines_above:
        return 1
    title = lines_above[-1][1]
    if title[0] in _COMMENT_MARKS:
        return 1
    return _count_cells(title, delimiter)


def _choose_first_line(lines: Sequence[tuple[int, str]]) -> tuple[int, int, str]:
    """Take the first line for the header, as there is no row of numbers."""
    (number, header), (_, first_row) = [*lines[:2], (1, ""), (2, "")][:2]
    header = header.lstrip(_COMMENT_MARKS + " ")
    used_delimiters = [d for d in _DELIMITERS if d in header] or [","]
    # Names may contain other delimiters.
    matching_delimiters = [
        d for d in used_delimiters if _count_cells(header, d) == _count_cells(first_row, d)
    ]
    if not matching_delimiters:
        matching_delimiters = used_delimiters[:1]
    return number, number + 1, max(matching_delimiters, key=lambda d: _count_cells(header, d))


def _build_headerless_error(path: Path, row: Sequence[str], names: Sequence[str]) -> LogError:
    if names:
        return LogError(
            f"{path}: its rows have {len(row)} cells, such as {join_names(row)}, but "
            f"'log.columns' of the robot file names {len(names)} columns; name them all.",
            code="log.names_count",
            where=path,
            key="log.columns.names",
        )
    suggestion = _suggest_names(len(row))
    error = HeaderError(
        f"{path}: has no header, its first row is {join_names(row)}; name its {len(row)} "
        f"columns in the robot file, such as {format_settings({'log.columns': suggestion})}.",
        code="log.no_header",
        where=path,
        key="log.columns.names",
    )
    error.suggestion = suggestion
    return error


def _suggest_names(count: int) -> tuple[str, ...]:
    """Return names for columns of time, positions, velocities and torques, if that may be so."""
    for quantities in (("q", "dq", "tau"), ("q", "tau")):
        joint_count, remainder = divmod(count - 1, len(quantities))
        if joint_count > 0 and remainder == 0:
            numbered = product(quantities, range(1, joint_count + 1))
            return ("t", *(f"{name}{k}" for name, k in numbered))
    return ("t", *(f"c{k}" for k in range(1, count)))


def _is_data(line: str, delimiter: str) -> bool:
    """Return whether a line has numbers, some may be missing."""
    if line[0] in _COMMENT_MARKS or delimiter not in line:
        return False
    cells = [cell for cell in _split_cells(line, delimiter) if not _MISSING.fullmatch(cell)]
    numbers = sum(map(_is_number, cells))
    return numbers > 0 and 2 * numbers >= len(cells)


def _begins_data(lines: Sequence[tuple[int, str]], delimiter: str) -> bool:
    """Return whether lines begin with a row of numbers, not with one of a preamble."""
    first_row = lines[0][1]
    if not _is_data(first_row, delimiter):
        return False
    if not _begins_with_text(first_row, delimiter):
        return True
    # Texts before numbers are labels only if the next rows have them as well.
    return all(
        _is_data(line, delimiter) and _begins_with_text(line, delimiter)
        for _, line in lines[1:_MIN_LABELLED_ROWS]
    )


def _begins_with_text(line: str, delimiter: str) -> bool:
    cell = _split_cells(line, delimiter)[0]
    return not (_is_number(cell) or _MISSING.fullmatch(cell))


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number, maybe with a unit."""
    is_plain = any(kind.fullmatch(cell) for kind in (_NUMBER, _DURATION, _CLOCK))
    return is_plain or _split_quantity(cell) is not None


def _split_quantity(cell: str) -> tuple[str, str] | None:
    """Return number and unit of a cell such as "1.5 rad"; None without a known unit."""
    match = _QUANTITY.fullmatch(cell)
    if match is None:
        return None
    unit = match[2] or match[3]
    return (match[1], unit) if is_unit(unit) else None


def _has_length(cells: Sequence[str], length: int) -> bool:
    """Return whether a row has a number of cells, apart from empty ones at its end."""
    return len(cells) >= length and not any(cells[length:])


def _is_row(line: str, delimiter: str) -> bool:
    """Return whether a line has nothing but numbers; a header may count its columns."""
    cells = _split_cells(line, delimiter)
    is_numeric = all(_NUMBER.fullmatch(cell) or _MISSING.fullmatch(cell) for cell in cells)
    return is_numeric and not _is_count(cells)


def _has_values(line: str, delimiter: str) -> bool:
    """Return whether a line has numbers where a header has names; that may count its columns."""
    cells = _split_cells(line, delimiter)
    has_decimals = any("." in cell and _NUMBER.fullmatch(cell) for cell in cells)
    return _is_row(line, delimiter) or (has_decimals and _is_data(line, delimiter))


def _is_count(cells: Sequence[str]) -> bool:
    numbers = [str(k) for k in range(len(cells) + 1)]
    return len(cells) > 2 and list(cells) in (numbers[:-1], numbers[1:])


def _is_unit_row(line: str, delimiter: str) -> bool:
    units = [_read_unit_cell(cell) for cell in line.split(delimiter)]
    return all(unit in _NO_UNIT or is_unit(unit) for unit in units)


def _read_unit_cell(cell: str) -> str:
    """Return the unit in a cell of a row of units, without brackets."""
    text = cell.strip(" \"'")
    match = _BRACKETED.fullmatch(text)
    return match[1].strip() if match else text


def _split_cells(line: str, delimiter: str) -> list[str]:
    text = _squeeze(line, delimiter)
    return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter), [])]


def _squeeze(line: str, delimiter: str) -> str:
    """Return a line whose cells are separated by one blank each, if blanks separate them."""
    return re.sub(" +", " ", line.strip(" \r\n")) if delimiter == " " else line


def _count_cells(line: str, delimiter: str) -> int:
    return len(_split_cells(line, delimiter))


def _read_lines(file: TextIO) -> Iterator[str]:
    """Yield the lines of a text, up to a tail of NUL bytes."""
    has_lines = False
    while line := file.readline(_MAX_LINE_LENGTH):
        # Loggers allocate files ahead; what they did not write is NUL.
        text = line.rstrip("\0") if has_lines else line
        is_too_long = len(text) == _MAX_LINE_LENGTH and not text.endswith("\n")
        if "\0" in text or is_too_long:
            raise csv.Error("not a line of text")
        if text:
            has_lines = True
            yield text
        if text != line:
            _require_nul(file)
            return


def _require_nul(file: TextIO) -> None:
    # Preallocated files can have gigabytes: equality is the fastest comparison.
    nul_text = "\0" * _MAX_LINE_LENGTH
    while tail := file.read(_MAX_LINE_LENGTH):
        if tail != nul_text[: len(tail)]:
            raise csv.Error("not a line of text")


def _build_csv_error(path: Path) -> LogError:
    return LogError(f"{path}: cannot be read as CSV text.", code="file.unreadable", where=path)


@dataclass(frozen=True, eq=False)
class _Chunk:
    names: list[str]
    numbers: list[int]  # of the lines
    cells: list[Any]  # by column
    decimal: str
    commented_count: int = 0  # rows of numbers in comments


def _read_chunks(dialect: _Dialect, chunk_rows: int = 0) -> Iterator[_Chunk]:
    try:
        with _open_text(dialect.path, dialect.content, newline="") as file:
            lines = _read_lines(file)
            lines_above = list(islice(lines, dialect.first_line - 1))[dialect.header_line - 1 :]
            if dialect.header_line == 0:
                lines_above = []
            # A logger that begins again in the same file repeats its header.
            header_text = "".join(lines_above[:1]).strip()
            header_lines = [_squeeze(line, dialect.delimiter) for line in lines_above]
            header = csv.reader(header_lines, delimiter=dialect.delimiter)
            names = list(dialect.names) or _parse_names(next(header, []))
            if not names:
                raise LogError(
                    f"{dialect.path}: is empty; a log needs a header and rows of data.",
                    code="log.empty",
                    where=dialect.path,
                )
            require_columns(dialect.path, len(names))
            yield _Chunk(names, [], [], dialect.decimal)
            lists = _ListCells()
            lines_below = enumerate(lines, start=dialect.first_line)
            chunk_rows = chunk_rows or max(1, _CHUNK_CELLS // len(names))
            empty_rows: dict[int, str] = {}
            commented_count = 0
            while chunk := list(islice(lines_below, chunk_rows)):
                rows: dict[int, str] = {}
                for k, line in chunk:
                    text = line.strip(f" \r\n{dialect.delimiter}")
                    if text and text[0] in dialect.comment_marks:
                        plain_text = text.lstrip(_COMMENT_MARKS + " ")
                        commented_count += _is_row_of(plain_text, dialect.delimiter, len(names))
                    elif text and line.strip() != header_text:
                        # Rows without a cell lack numbers, but for those at the end of a file.
                        rows |= empty_rows
                        empty_rows.clear()
                        rows[k] = line
                    elif not text and line.strip(" \r\n"):
                        empty_rows[k] = line
                _remove_torn_row(rows, dialect, len(names))
                if rows:
                    columns = list(_parse_columns(rows, dialect, len(names)))
                    columns_by_name = lists.expand(dialect.path, names, columns)
                    yield _Chunk(
                        [name for name, _ in columns_by_name],
                        list(rows),
                        [cells for _, cells in columns_by_name],
                        dialect.decimal,
                        commented_count,
                    )
                    commented_count = 0
    except (UnicodeDecodeError, csv.Error) as error:
        raise _build_csv_error(dialect.path) from error


def _is_row_of(text: str, delimiter: str, column_count: int) -> bool:
    """Return whether a text has a number or a missing one for each column."""
    is_whole = _count_cells(text, delimiter) == column_count
    return is_whole and bool(text) and _is_row(text, delimiter)


def _remove_torn_row(rows: dict[int, str], dialect: _Dialect, column_count: int) -> None:
    """Remove the last line of a file if its writer was killed within it."""
    number = max(rows, default=0)
    if number == 0 or rows[number].endswith(("\n", "\r")):
        return
    cells = _split_cells(rows[number], dialect.delimiter)
    if not cells or number <= dialect.first_line:
        return
    # What is left of a number may be another number.
    last_cells = [line.rstrip().rpartition(dialect.delimiter)[2] for line in rows.values()]
    lengths = [len(cell) for cell in last_cells]
    is_short = len(lengths) > _MIN_UNCUT_ROWS and lengths[-1] < min(lengths[:-1])
    if len(cells) < column_count or is_short or _CUT_NUMBER.fullmatch(cells[-1]):
        # A proposal is tried in a folder of its own; the name is that of the user's file.
        name = dialect.path.name
        _log.warning("%s: its last row, %d, is cut off and was left out.", name, number)
        del rows[number]


class _ListCells:
    """Lists of numbers in cells, such as ``[0.1, 0.2]``, that become a column for each number."""

    def __init__(self) -> None:
        self._lengths: dict[int, int] | None = None  # by column, from the first rows

    def expand(
        self, path: Path, names: Sequence[str], columns: Sequence[Any]
    ) -> list[tuple[str, Any]]:
        """Return names and cells of all columns; raises LogError for lists that differ."""
        if self._lengths is None:
            self._lengths = {
                k: len(_parse_list(cells[0]))
                for k, cells in enumerate(columns)
                if not isinstance(cells, np.ndarray) and _parse_list(cells[0])
            }
            require_columns(path, len(columns) + sum(self._lengths.values()))
        expanded: list[tuple[str, Any]] = []
        for k, (name, cells) in enumerate(zip(names, columns, strict=True)):
            if k not in self._lengths:
                expanded.append((name, cells))
                continue
            lists = [_parse_list(cell) for cell in cells]
            lengths = {len(numbers) for numbers in lists}
            if lengths != {self._lengths[k]}:
                raise LogError(
                    f"{path}: lists in column '{name}' have {min(lengths)} to {max(lengths)} "
                    f"numbers; the first has {self._lengths[k]}.",
                    code="log.lists",
                    where=path,
                    key=name,
                )
            for number, numbers in enumerate(np.array(lists, dtype=float).T, start=1):
                expanded.append((f"{name}_{number}", numbers))
        return expanded


def _parse_list(cell: str) -> list[float]:
    """Return the numbers of a cell with a list, none of any other cell."""
    match = _LIST.fullmatch(cell.strip())
    if match is None:
        return []
    with suppress(ValueError):
        return [float(number) for number in re.split(r"\s*[,;]\s*|\s+", match[1].strip())]
    return []


def _join_chunks(dialect: _Dialect, chunks: Iterable[_Chunk]) -> LogTable:
    """Join the chunks of a file, without columns that have neither a name nor a number."""
    line_numbers = array("q")
    commented_count = 0
    names: Sequence[str] = ()
    columns: dict[int, Column] = defaultdict(partial(Column, reads_units=True))
    for chunk in chunks:
        names = chunk.names
        for k, cells in enumerate(chunk.cells):
            columns[k].add(cells, len(line_numbers), chunk.decimal)
        line_numbers.extend(chunk.numbers)
        commented_count += chunk.commented_count
    arrays = [columns[k].concatenate() for k in range(len(names))]
    # Spreadsheets write cells of columns that were deleted.
    kept_columns = [k for k, name in enumerate(names) if name or not _is_empty(arrays[k])]
    names = [name or f"Unnamed: {k}" for k, name in enumerate(names)]  # as pandas calls them
    unit_row = dialect.unit_row
    if len(unit_row) != len(names):
        unit_row = ("",) * len(names)
    units = {names[k]: columns[k].unit or unit_row[k] for k in kept_columns}
    left_out = {}
    if commented_count:
        left_out[_COMMENTS] = commented_count
    return LogTable(
        dialect.path,
        tuple(names[k] for k in kept_columns),
        len(line_numbers),
        [arrays[k] for k in kept_columns].__getitem__,
        dialect.other_names,
        line_numbers=line_numbers,
        units={name: unit for name, unit in units.items() if unit},
        left_out=left_out,
    )


def _is_empty(column: Array | TextCell) -> bool:
    return isinstance(column, np.ndarray) and bool(np.isnan(column).all())


def _parse_columns(rows: Mapping[int, str], dialect: _Dialect, column_count: int) -> Iterable[Any]:
    """Return the columns of some lines, as arrays if all cells are numbers."""
    lines = [_squeeze(line, dialect.delimiter) for line in rows.values()]
    point_lines = lines
    if dialect.decimal == ",":
        point_lines = [line.translate(_SWAP_COMMA) for line in lines]
    read_numbers = partial(
        np.loadtxt, point_lines, delimiter=dialect.delimiter, comments=None, ndmin=2
    )
    with suppress(ValueError):
        values = read_numbers()
        if values.shape == (len(lines), column_count):
            columns = list(values.T)
            for k in np.flatnonzero(np.any(np.abs(values) >= _MAX_EXACT_INTEGER, axis=0)):
                columns[k] = _parse_numbers(read_numbers(usecols=k, dtype=str)[:, 0].tolist(), ".")
            return columns
    cells = list(csv.reader(lines, delimiter=dialect.delimiter))
    for number, row in zip(rows, cells, strict=False):
        while len(row) > column_count and not row[-1].strip():
            row.pop()
        if len(row) != column_count:
            raise LogError(
                f"{dialect.path}: row {number} has {len(row)} cells; the header has {column_count} "
                "columns.",
                code="log.cells",
                where=dialect.path,
                key=f"row {number}",
            )
    if len(cells) < len(lines):  # an open quotation mark
        raise _build_csv_error(dialect.path)
    return zip(*cells, strict=True)


class Column:
    """A growing column, whose type follows from all cells.

    If it `reads_units`, cells such as "1.5 rad" are numbers, all in its `unit`.
    """

    def __init__(self, *, reads_units: bool = False) -> None:
        self._reads_units = reads_units
        self._parts: list[Any] = []  # the last is None for text
        self._text_cell: TextCell | None = None  # first cell that is not a number
        self._unit: str | None = None  # of the first cell; "" without one
        self._other_unit_cell: TextCell | None = None  # first cell in another unit

    @property
    def unit(self) -> str:
        """Unit of the cells as it is written; "" without one."""
        return self._unit or ""

    def add(self, cells: Array | Sequence[str], first: int = 0, decimal: str = ".") -> None:
        """Append numbers, or the text from row `first`."""
        if self._parts and self._parts[-1] is None:
            return
        if not isinstance(cells, np.ndarray):
            part = _parse_numbers(cells, decimal)
            if part is None:
                self._add_text([_normalise_cell(cell) for cell in cells], first, decimal)
                return
        else:
            part = cells
        self._add_numbers(part, first)

    def _add_numbers(self, part: Array, first: int) -> None:
        """Append numbers without a unit."""
        if not np.isnan(part).all():
            k = int(np.argmin(np.isnan(part)))
            self._require_unit("", first + k, f"{part[k]:g}")
        self._parts.append(part)

    def _add_text(self, cells: Sequence[str], first: int, decimal: str) -> None:
        """Append cells that are not all plain numbers."""
        part = _parse_numbers(cells, decimal)
        if part is not None:
            self._add_numbers(part, first)
            return
        part = _parse_times_or_truths([cell.strip() for cell in cells])
        if part is None and self._reads_units:
            part = self._parse_quantities(cells, first, decimal)
            if part is not None:
                self._parts.append(part)
                return
        if self._text_cell is None:
            k = next(k for k, cell in enumerate(cells) if _parse_numbers([cell], decimal) is None)
            self._text_cell = _build_text_cell(first + k, cells[k])
        self._parts.append(part)

    def _parse_quantities(self, cells: Sequence[str], first: int, decimal: str) -> Array | None:
        """Return the numbers of cells that may have units; None for other text."""
        pairs = [_split_quantity(cell.strip()) or (cell, "") for cell in cells]
        part = _parse_numbers([number for number, _ in pairs], decimal)
        if part is None:
            return None
        for k, (number, unit) in enumerate(pairs):
            if number != "nan":
                self._require_unit(unit, first + k, cells[k].strip())
        return part

    def _require_unit(self, unit: str, index: int, text: str) -> None:
        """Note the first cell in another unit than those before."""
        if self._unit is None:
            self._unit = unit
        if unit == self._unit or self._other_unit_cell is not None:
            return
        expected = f"a number in '{self._unit}'" if self._unit else "a number without a unit"
        self._other_unit_cell = TextCell(index=index, text=text, expected=expected)

    def concatenate(self) -> Array | TextCell:
        """Return all cells, or the first cell of text, also among times or truth values."""
        if self._other_unit_cell is not None:
            return self._other_unit_cell
        try:
            column = np.concatenate(self._parts)
        except (TypeError, ValueError):  # times and numbers; text; nothing
            return self._text_cell or np.empty(0)
        is_time_or_truth = column.dtype.kind in "mM" or np.isin(np.nan_to_num(column), (0, 1)).all()
        return self._text_cell if self._text_cell and not is_time_or_truth else column


def _build_text_cell(index: int, text: str) -> TextCell:
    if _DECIMAL_COMMA.fullmatch(text.strip()):
        return TextCell(index=index, text=text, expected="a number with a decimal point")
    return TextCell(index=index, text=text)


def _normalise_cell(cell: str) -> str:
    """Return "nan" or "inf" for a cell that says so in another way."""
    text = cell.strip()
    return "nan" if _MISSING.fullmatch(text) else _INFINITY.sub(r"\1inf", text)


def _parse_numbers(cells: Sequence[str], decimal: str) -> Array | None:
    """Return floats, or integers if a float has too few digits; None for text."""
    joined_cells = "\0".join(cells)
    if "_" in joined_cells or not joined_cells.isascii():  # allowed by Python
        return None
    if decimal == ",":
        cells = joined_cells.translate(_SWAP_COMMA).split("\0")
    try:
        values: Array = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None
    if np.any(np.abs(values) >= _MAX_EXACT_INTEGER):
        with suppress(ValueError, OverflowError):
            return np.fromiter(map(int, cells), np.int64, len(cells))
    return values


def _parse_times_or_truths(cells: Sequence[str]) -> Array | None:
    with suppress(KeyError):
        return np.array([_TRUTHS[cell.lower()] for cell in cells])
    if all(cell == "nan" or _TIME.fullmatch(cell) for cell in cells):
        with suppress(ValueError), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of zones, which NumPy converts to UTC
            return np.array(["NaT" if cell == "nan" else cell for cell in cells], "M8")
    with suppress(ValueError, OverflowError):
        return np.array([_parse_duration(cell) for cell in cells], "m8[ns]")
    return None


def _parse_duration(cell: str) -> np.timedelta64:
    """Return the duration of a cell such as "0.005 sec" or "0:12:30.5"; else ValueError."""
    if cell == "nan":
        return np.timedelta64("NaT", "ns")
    clock = _CLOCK.fullmatch(cell)
    if clock is not None:
        seconds = 3600 * int(clock[2]) + 60 * int(clock[3]) + float(clock[4])
        return np.timedelta64(round(float(f"{clock[1]}1") * seconds * 1e9), "ns")
    match = _DURATION.fullmatch(cell)
    if match is None:
        raise ValueError("not a duration")
    nanoseconds = 60e9 if match[2] == "min" else _NANOSECONDS[match[2][0]]
    return np.timedelta64(round(float(match[1]) * nanoseconds), "ns")


def _parse_names(header: Sequence[str]) -> list[str]:
    names = [name.strip() for name in header]
    if names[:1] == ["#"]:
        return names[1:]
    return [name.removeprefix("#").strip() for name in names[:1]] + names[1:]
