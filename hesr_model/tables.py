"""Tables of numbers in CSV or Parquet, with messages that name the cell at fault."""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hesr_model.errors import LogError

Array = NDArray[np.float64]

_DELIMITERS = ",;\t "
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
"""A number with a decimal comma."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """An open table file.

    Attributes
    ----------
    names
        All columns of the file.
    others
        What else is in the file and cannot be a column, told where a column is missed.
    """

    path: Path
    names: tuple[str, ...]
    others: tuple[str, ...] = ()
    _arrow: Any
    _dialect: "_Dialect | None" = None

    @property
    def listing(self) -> str:
        """What the file holds, for a message that misses something."""
        return ", ".join((*self.names, *self.others))

    def row(self, index: int) -> int:
        """Row of the sample `index` as an editor shows it: a CSV's header is row 1."""
        if self._dialect is None:
            return index + 1
        return [number for number, _ in _csv_rows(self.path, self._dialect)][index + 1]

    def numbers(self, names: Sequence[str]) -> Array:
        """Columns as floats, (N, len(names)), in the units of the file.

        Raises
        ------
        LogError
            Naming a column that is missing or not numeric, or the row and column of a cell that
            is empty, NaN or infinite.
        """
        for name in names:
            if name not in self.names:
                raise LogError(f"{self.path}: column '{name}' is missing; it has {self.listing}.")
        return np.column_stack([self._column(name) for name in names])

    def _column(self, name: str) -> Array:
        import pyarrow

        try:
            cells = self._arrow.column(name).cast(pyarrow.float64(), safe=False)
        except (pyarrow.ArrowInvalid, pyarrow.ArrowNotImplementedError) as error:
            raise self._first_text(name) from error
        values = np.asarray(cells.to_numpy(), dtype=float)
        if not np.all(np.isfinite(values)):
            k = int(np.argmin(np.isfinite(values)))
            found = "an empty cell or NaN" if np.isnan(values[k]) else "infinity"
            raise LogError(
                f"{self.path}: column '{name}', row {self.row(k)}: {found} where a finite number "
                "is needed."
            )
        return values

    def _first_text(self, name: str) -> LogError:
        """Error for a column that is not numeric, at its first cell that is none."""
        cells = self._arrow.column(name).to_pylist()
        point = self._dialect.decimal if self._dialect else "."
        k = next((k for k, cell in enumerate(cells) if not _is_number(cell, point)), 0)
        return LogError(
            f"{self.path}: column '{name}', row {self.row(k)}: {str(cells[k])!r} where a number "
            "is needed."
        )


def read_table(path: Path) -> Table:
    """Open a CSV (with a header; blank lines are ignored) or a Parquet file.

    A CSV's cells are separated as its header's are: by commas, semicolons, tabs or single blanks;
    the latter three may have decimal commas. A header may begin with ``#``.

    Raises
    ------
    LogError
        If the file is missing, empty or not a table, if rows are of unequal length, or if two
        columns bear the same name.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log file.")
    if path.stat().st_size == 0:
        raise LogError(f"{path}: is empty; a log needs a header and rows of data.")
    dialect = None if _is_parquet(path) else _dialect(path)
    arrow = _read_csv(path, dialect) if dialect else _read_parquet(path)
    names = tuple(arrow.column_names)
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise LogError(f"{path}: column '{twice[0]}' stands twice; names must differ.")
    if arrow.num_rows == 0:
        raise LogError(f"{path}: has no rows of data below its header.")
    return Table(path=path, names=names, _arrow=arrow, _dialect=dialect)


def table_of(path: Path, columns: Mapping[str, Array], others: Sequence[str] = ()) -> Table:
    """Make a table of columns (N,), in their units, that were read from a file of another kind."""
    import pyarrow

    arrow = pyarrow.table({name: np.ascontiguousarray(values) for name, values in columns.items()})
    return Table(path=path, names=tuple(columns), others=tuple(others), _arrow=arrow)


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns (N,), of any unit, as CSV or Parquet by the suffix; numbers keep all digits."""
    import pyarrow

    table = pyarrow.table({name: np.ascontiguousarray(column) for name, column in columns.items()})
    if _is_parquet(path):
        import pyarrow.parquet

        pyarrow.parquet.write_table(table, path)
    else:
        import pyarrow.csv

        pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="none"))


@dataclass(frozen=True, kw_only=True)
class _Dialect:
    """How the cells of a CSV are separated, and its decimal point."""

    delimiter: str
    decimal: str = "."


def _dialect(path: Path) -> _Dialect:
    try:
        with path.open(encoding="utf-8-sig") as file:
            lines = (line.strip() for line in file if line.strip())
            header, first = next(lines, "").lstrip("# "), next(lines, "")
            there = [d for d in _DELIMITERS if d in header] or [","]
            # Names may hold what separates cells in other files, but then rows are not as long.
            fitting = [d for d in there if _count(header, d) == _count(first, d)] or there[:1]
            delimiter = max(fitting, key=lambda d: _count(header, d))
            # A log may begin with zeros, which show no decimal sign.
            commas = delimiter != "," and any(
                _COMMA.fullmatch(cell.strip())
                for line in (first, *lines)
                if "," in line
                for cell in line.split(delimiter)
            )
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read as CSV text.") from error
    return _Dialect(delimiter=delimiter, decimal="," if commas else ".")


def _count(line: str, delimiter: str) -> int:
    """Return the number of cells of a line."""
    return len(next(csv.reader([line], delimiter=delimiter), []))


def _csv_rows(path: Path, dialect: _Dialect) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV that are not blank, each with its number from 1."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, delimiter=dialect.delimiter)
        for cells in reader:
            if cells:
                yield reader.line_num, cells


def _is_number(cell: object, point: str) -> bool:
    import pyarrow

    try:
        # Not Python's float, which also takes "1_000".
        pyarrow.scalar(str(cell).strip().replace(point, ".")).cast(pyarrow.float64())
    except pyarrow.ArrowInvalid:
        return False
    return True


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in {".parquet", ".pq"}


def _read_parquet(path: Path) -> Any:
    import pyarrow
    import pyarrow.parquet

    try:
        return pyarrow.parquet.read_table(path)
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise LogError(f"{path}: cannot be read as Parquet.") from error


def _read_csv(path: Path, dialect: _Dialect) -> Any:
    import pyarrow
    import pyarrow.csv

    try:
        number, header = next(_csv_rows(path, dialect), (0, []))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read as CSV text.") from error
    if not header:
        raise LogError(f"{path}: is empty; a log needs a header and rows of data.")
    names = _names(header)
    options = pyarrow.csv.ReadOptions(
        column_names=names,
        skip_rows=number,
        # One block: a column's type is inferred from all of it, not from its first megabyte.
        block_size=min(path.stat().st_size + 1, 2**31 - 1),
    )
    try:
        return pyarrow.csv.read_csv(
            path,
            options,
            pyarrow.csv.ParseOptions(delimiter=dialect.delimiter),
            pyarrow.csv.ConvertOptions(decimal_point=dialect.decimal),
        )
    except pyarrow.ArrowInvalid as error:
        raise _ragged(path, dialect, len(names)) from error


def _names(header: Sequence[str]) -> list[str]:
    """Names in a header, without the ``#`` that some programs put before them."""
    names = [name.strip() for name in header]
    if names[0] == "#":
        return names[1:]
    return [names[0].removeprefix("#").strip(), *names[1:]]


def _ragged(path: Path, dialect: _Dialect, width: int) -> LogError:
    """Error for a CSV that cannot be parsed, at its first row of another length."""
    try:
        rows = _csv_rows(path, dialect)
        next(rows)
        for number, cells in rows:
            if len(cells) != width:
                return LogError(
                    f"{path}: row {number} has {len(cells)} cells; the header has {width} columns."
                )
    except (UnicodeDecodeError, csv.Error):
        pass
    return LogError(f"{path}: cannot be read as CSV text.")
