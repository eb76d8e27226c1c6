"""Tables of numbers in CSV or Parquet, with messages that name the wrong cell."""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from hesr_model.errors import LogError
from hesr_model.support.arrays import Array

_MOST_COLUMNS = 10_000
_MOST_LISTED = 30  # names in a sentence
_LONGEST_NAME = 60  # characters of a name
_MOST_CSV = 2**31 - 2  # bytes of a single block
_LONGEST_LINE = 2**24  # characters
_DELIMITERS = ",;\t "
_MARKS = "#%"  # marks of comments, sometimes of a header
_SEARCHED = 500  # lines searched for data
_UNIT_CELL = re.compile(r"[(\[].*[)\]]|rad|deg|°|s|ms|us|ns|A|mA|N\.?m|rad/s|deg/s|-|")
_SINCE_1970 = 1e8  # [s]; larger stamps count from an epoch
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")  # decimal comma
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|\d{4}-\d\d-\d\d[T ][\d:.]+Z?")


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTable:
    """An open table file; messages on missing columns mention `others`."""

    path: Path
    names: tuple[str, ...]
    others: tuple[str, ...] = ()
    _arrow: Any
    _dialect: "_Dialect | None" = None

    @property
    def listing(self) -> str:
        """Columns of the file, for messages."""
        return listed((*self.names, *self.others))

    def row(self, index: int) -> int:
        """Return the row of sample `index`; a CSV's header is row 1."""
        if self._dialect is None:
            return index + 1
        try:
            rows = islice(_csv_rows(self.path, self._dialect), index + 1, None)
            return next(number for number, _ in rows)
        except (LogError, StopIteration):  # Arrow reads more than Python
            return index + 2

    def numbers(self, names: Sequence[str], *, missing: bool = False) -> Array:
        """Return columns (N, len(names)), `missing` cells as NaN; raises LogError."""
        for name in names:
            self._require(name)
        columns = [self._floats(name, self._arrow.column(name), missing=missing) for name in names]
        return np.column_stack(columns)

    def times(self, name: str, unit: float, *, missing: bool = False) -> Array:
        """Return time stamps (N,) [s], given in `unit` [s]; dates from the first one."""
        import pyarrow

        self._require(name)
        cells = self._arrow.column(name)
        kind = cells.type
        if pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind):
            unit = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
            cells = cells.cast(pyarrow.int64())
        whole = pyarrow.types.is_integer(cells.type) and not cells.null_count
        # Nanoseconds since 1970 exceed the digits of a float: subtract before.
        stamps = cells.to_numpy() if whole else self._floats(name, cells, missing=missing)
        known = stamps[np.isfinite(stamps)]
        since = known[0] if len(known) and abs(float(known[0])) * unit > _SINCE_1970 else 0
        return np.asarray((stamps - since) * unit, dtype=float)

    def _require(self, name: str) -> None:
        if name not in self.names:
            raise LogError(f"{self.path}: column '{name}' is missing; it has {self.listing}.")

    def _floats(self, name: str, column: Any, *, missing: bool) -> Array:
        import pyarrow

        try:
            cells = column.cast(pyarrow.float64(), safe=False)
        except pyarrow.ArrowException as error:
            raise self._first_text(name) from error
        values = np.asarray(cells.to_numpy(), dtype=float)
        good = ~np.isinf(values) if missing else np.isfinite(values)
        if not np.all(good):
            k = int(np.argmin(good))
            found = "an empty cell or NaN" if np.isnan(values[k]) else "infinity"
            raise LogError(
                f"{self.path}: column '{name}', row {self.row(k)}: {found} where a finite number "
                "is needed."
            )
        return values

    def _first_text(self, name: str) -> LogError:
        """Return the error at the first cell that is not a number."""
        column = self._arrow.column(name)
        try:
            cells = column.to_pylist()
        except Exception:  # Arrow cannot show every time stamp
            return LogError(
                f"{self.path}: column '{name}' holds {column.type} where numbers are needed."
            )
        point = self._dialect.decimal if self._dialect else "."
        k = next((k for k, cell in enumerate(cells) if not _is_number(cell, point)), 0)
        return LogError(
            f"{self.path}: column '{name}', row {self.row(k)}: {str(cells[k])!r} where a number "
            "is needed."
        )


def listed(names: Sequence[str]) -> str:
    """Return names for a sentence, shortened if many."""
    more = len(names) - _MOST_LISTED
    shown = [name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..." for name in names]
    return ", ".join((*shown[:_MOST_LISTED], *([f"and {more} more"] if more > 0 else [])))


def most_bytes(path: Path) -> int:
    """Return the allowed memory [B] of a packed file."""
    return 10 * path.stat().st_size + 300 * 2**20


def read_table(path: Path) -> LogTable:
    """Open a CSV (with a header) or a Parquet file; raises LogError.

    A CSV has commas, or semicolons, tabs or single blanks, which allow decimal commas. Preamble,
    ``#`` of a header, comments, blank lines and a row of units are skipped.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log file.")
    if path.stat().st_size == 0:
        raise LogError(f"{path}: is empty; a log needs a header and rows of data.")
    dialect = None if _is_parquet(path) else _dialect(path)
    arrow = _read_csv(path, dialect) if dialect else _read_parquet(path)
    names = tuple(arrow.column_names)
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise LogError(f"{path}: column '{twice[0]}' occurs twice; names must differ.")
    if arrow.num_rows == 0:
        raise LogError(f"{path}: has no rows of data below its header.")
    return LogTable(path=path, names=names, _arrow=arrow, _dialect=dialect)


def table_of(path: Path, columns: Mapping[str, Array], others: Sequence[str] = ()) -> LogTable:
    """Make a table of columns (N,) of another format."""
    import pyarrow

    arrow = pyarrow.table({name: np.ascontiguousarray(values) for name, values in columns.items()})
    return LogTable(path=path, names=tuple(columns), others=tuple(others), _arrow=arrow)


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns (N,) as CSV or Parquet, with all digits."""
    table = table_of(path, columns)._arrow
    if _is_parquet(path):
        import pyarrow.parquet

        pyarrow.parquet.write_table(table, path)
    else:
        import pyarrow.csv

        pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="none"))


@dataclass(frozen=True, kw_only=True)
class _Dialect:
    delimiter: str
    decimal: str
    header: int  # line, from 1
    data: int  # line of the first row


def _dialect(path: Path) -> _Dialect:
    if (length := path.stat().st_size) > _MOST_CSV:
        raise LogError(
            f"{path}: is {length / 1e9:.1f} GB long; a CSV of up to {_MOST_CSV / 1e9:.1f} GB can "
            "be read; use Parquet, or split it."
        )
    try:
        with path.open(encoding="utf-8-sig") as file:
            numbered = ((k, line.strip()) for k, line in enumerate(_lines(file), start=1))
            head = list(islice(((k, line) for k, line in numbered if line), _SEARCHED))
            header, data, delimiter = _table_in(head)
            # A log may begin with zeros without decimal sign.
            commas = delimiter != "," and any(
                _COMMA.fullmatch(cell.strip())
                for _, line in chain(((k, line) for k, line in head if k >= data), numbered)
                if "," in line
                for cell in line.split(delimiter)
            )
    except (UnicodeDecodeError, csv.Error) as error:
        raise _no_csv(path) from error
    return _Dialect(delimiter=delimiter, decimal="," if commas else ".", header=header, data=data)


def _table_in(lines: Sequence[tuple[int, str]]) -> tuple[int, int, str]:
    """Return the lines of the header (else the first) and of the first row, and the delimiter.

    The first row has numbers, and is below a line with as many names.
    """
    for at, (number, line) in enumerate(lines):
        for delimiter in sorted(_DELIMITERS, key=lambda d: -line.count(d)):
            if not _is_data(line, delimiter):
                continue
            cells = _count(line, delimiter)
            above = [(k, text.lstrip(_MARKS + " ")) for k, text in reversed(lines[:at])]
            fitting = [(k, text) for k, text in above if _count(text, delimiter) == cells]
            units = [k for k, text in fitting[:1] if _are_units(text, delimiter)]
            if named := fitting[1:] if units and len(fitting) > 1 else fitting:
                return named[0][0], number, delimiter
    number, header = lines[0] if lines else (1, "")
    first = lines[1][1] if len(lines) > 1 else ""
    header = header.lstrip(_MARKS + " ")
    there = [d for d in _DELIMITERS if d in header] or [","]
    # Names may contain other delimiters.
    alike = [d for d in there if _count(header, d) == _count(first, d)] or there[:1]
    return number, number + 1, max(alike, key=lambda d: _count(header, d))


def _is_data(line: str, delimiter: str) -> bool:
    """Return whether a line has numbers, some may be missing."""
    if line[0] in _MARKS or delimiter not in line:
        return False
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    numbers = sum(bool(_NUMBER.fullmatch(cell)) for cell in cells)
    return numbers > 0 and 2 * numbers >= len(cells)


def _are_units(line: str, delimiter: str) -> bool:
    return all(_UNIT_CELL.fullmatch(cell.strip()) for cell in line.split(delimiter))


def _count(line: str, delimiter: str) -> int:
    return len(next(csv.reader([line], delimiter=delimiter), []))


def _lines(file: TextIO) -> Iterator[str]:
    while line := file.readline(_LONGEST_LINE):
        if "\0" in line or (len(line) == _LONGEST_LINE and not line.endswith("\n")):
            raise csv.Error("not a line of text")
        yield line


def _csv_rows(path: Path, dialect: _Dialect) -> Iterator[tuple[int, list[str]]]:
    """Yield header and rows of a CSV with their lines from 1."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(_lines(file), delimiter=dialect.delimiter)
            for cells in reader:
                number = reader.line_num
                is_row = number >= dialect.data and not _is_comment(cells)
                if cells and (number == dialect.header or is_row):
                    yield number, cells
    except (UnicodeDecodeError, csv.Error) as error:
        raise _no_csv(path) from error


def _no_csv(path: Path) -> LogError:
    return LogError(f"{path}: cannot be read as CSV text.")


def _is_comment(cells: Sequence[str]) -> bool:
    return bool(cells) and cells[0].lstrip()[:1] in tuple(_MARKS)


def _is_number(cell: object, point: str) -> bool:
    import pyarrow

    try:
        # Python's float accepts "1_000".
        pyarrow.scalar(str(cell).strip().replace(point, ".")).cast(pyarrow.float64())
    except pyarrow.ArrowInvalid:
        return False
    return True


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in {".parquet", ".pq"}


def _read_parquet(path: Path) -> Any:
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            rows, columns = file.metadata.num_rows, file.metadata.num_columns
            _require_columns(path, columns)
            if 8 * rows * columns > most_bytes(path):
                raise LogError(
                    f"{path}: has {rows} rows of {columns} columns, more than fits into the file."
                )
            return file.read()
    except LogError:
        raise
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as Parquet.") from error


def _require_columns(path: Path, count: int) -> None:
    if count > _MOST_COLUMNS:
        raise LogError(f"{path}: has {count} columns; at most {_MOST_COLUMNS} are allowed.")


def _read_csv(path: Path, dialect: _Dialect) -> Any:
    import pyarrow
    import pyarrow.csv

    _, header = next(_csv_rows(path, dialect), (0, []))
    if not header:
        raise LogError(f"{path}: is empty; a log needs a header and rows of data.")
    names = _names(header)
    _require_columns(path, len(names))
    options = pyarrow.csv.ReadOptions(
        column_names=names,
        skip_rows=dialect.data - 1,
        # One block: types follow from all rows, not the first megabyte.
        block_size=path.stat().st_size + 1,
    )
    try:
        return pyarrow.csv.read_csv(
            path,
            options,
            pyarrow.csv.ParseOptions(
                delimiter=dialect.delimiter,
                invalid_row_handler=lambda row: (
                    "skip" if _is_comment([row.text or ""]) else "error"
                ),
            ),
            pyarrow.csv.ConvertOptions(decimal_point=dialect.decimal),
        )
    except pyarrow.ArrowInvalid as error:
        raise _ragged(path, dialect, len(names)) from error


def _names(header: Sequence[str]) -> list[str]:
    names = [name.strip() for name in header]
    if names[0] == "#":
        return names[1:]
    return [names[0].removeprefix("#").strip(), *names[1:]]


def _ragged(path: Path, dialect: _Dialect, width: int) -> LogError:
    """Return the error at the first row of another length."""
    for number, cells in islice(_csv_rows(path, dialect), 1, None):
        if len(cells) != width:
            return LogError(
                f"{path}: row {number} has {len(cells)} cells; the header has {width} columns."
            )
    return _no_csv(path)
