"""Tables of numbers in CSV or Parquet, with messages that name the cell at fault."""

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hesr_model.errors import LogError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """An open table file.

    Attributes
    ----------
    names
        All columns of the file.
    """

    path: Path
    names: tuple[str, ...]
    _arrow: Any

    def row(self, index: int) -> int:
        """Row of the sample `index` as an editor shows it: a CSV's header is row 1."""
        if _is_parquet(self.path):
            return index + 1
        return [number for number, _ in _csv_rows(self.path)][index + 1]

    def numbers(self, names: Sequence[str]) -> Array:
        """Columns as floats, (N, len(names)).

        Raises
        ------
        LogError
            Naming a column that is missing or not numeric, or the row and column of a cell that
            is empty, NaN or infinite.
        """
        for name in names:
            if name not in self.names:
                raise LogError(
                    f"{self.path}: column '{name}' is missing; it has {', '.join(self.names)}."
                )
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
        k = next((k for k, cell in enumerate(cells) if not _is_number(cell)), 0)
        return LogError(
            f"{self.path}: column '{name}', row {self.row(k)}: {str(cells[k])!r} where a number "
            "is needed."
        )


def read_table(path: Path) -> Table:
    """Open a CSV (with a header; blank lines are ignored) or a Parquet file.

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
    arrow = _read_parquet(path) if _is_parquet(path) else _read_csv(path)
    names = tuple(arrow.column_names)
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise LogError(f"{path}: column '{twice[0]}' stands twice; names must differ.")
    if arrow.num_rows == 0:
        raise LogError(f"{path}: has no rows of data below its header.")
    return Table(path=path, names=names, _arrow=arrow)


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns of equal length as CSV or Parquet, by the suffix; numbers keep all digits."""
    import pyarrow

    table = pyarrow.table({name: np.ascontiguousarray(column) for name, column in columns.items()})
    if _is_parquet(path):
        import pyarrow.parquet

        pyarrow.parquet.write_table(table, path)
    else:
        import pyarrow.csv

        pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="none"))


def _csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV that are not blank, each with its number from 1."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        for cells in reader:
            if cells:
                yield reader.line_num, cells


def _is_number(cell: object) -> bool:
    import pyarrow

    try:
        # Not Python's float, which also takes "1_000".
        pyarrow.scalar(str(cell).strip()).cast(pyarrow.float64())
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


def _read_csv(path: Path) -> Any:
    import pyarrow
    import pyarrow.csv

    try:
        number, header = next(_csv_rows(path), (0, []))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read as CSV text.") from error
    if not header:
        raise LogError(f"{path}: is empty; a log needs a header and rows of data.")
    options = pyarrow.csv.ReadOptions(
        column_names=[name.strip() for name in header],
        skip_rows=number,
        # One block: a column's type is inferred from all of it, not from its first megabyte.
        block_size=min(path.stat().st_size + 1, 2**31 - 1),
    )
    try:
        return pyarrow.csv.read_csv(path, options)
    except pyarrow.ArrowInvalid as error:
        raise _ragged(path, len(header)) from error


def _ragged(path: Path, width: int) -> LogError:
    """Error for a CSV that cannot be parsed, at its first row of another length."""
    try:
        for number, cells in _csv_rows(path):
            if len(cells) != width:
                return LogError(
                    f"{path}: row {number} has {len(cells)} cells; the header has {width} columns."
                )
    except (UnicodeDecodeError, csv.Error):
        pass
    return LogError(f"{path}: cannot be read as CSV text.")
