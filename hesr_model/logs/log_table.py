"""A table of numbers, with messages that name the wrong cell."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from hesr_model.errors import LogError
from hesr_model.support.arrays import Array

_MOST_COLUMNS = 10_000
_MOST_LISTED = 30  # names in a sentence
_LONGEST_NAME = 60  # characters of a name
_SINCE_1970 = 1e8  # [s]; larger stamps count from an epoch


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTable:
    """An open table file; messages on missing columns mention `others`."""

    path: Path
    names: tuple[str, ...]
    others: tuple[str, ...] = ()
    _arrow: Any
    _row: Callable[[int], int] = lambda index: index + 1
    _decimal: str = "."

    @classmethod
    def of(
        cls,
        path: Path,
        arrow: Any,
        row: Callable[[int], int] = lambda index: index + 1,
        decimal: str = ".",
    ) -> Self:
        """Return the table of a file read by Arrow; raises LogError."""
        names = tuple(arrow.column_names)
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise LogError(f"{path}: column '{twice[0]}' occurs twice; names must differ.")
        if arrow.num_rows == 0:
            raise LogError(f"{path}: has no rows of data below its header.")
        return cls(path=path, names=names, _arrow=arrow, _row=row, _decimal=decimal)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self._arrow.num_rows)

    def named(self, names: Sequence[str]) -> "LogTable":
        """Return the table with other names of its columns, if any; raises LogError."""
        if not names or tuple(names) == self.names:
            return self
        if len(names) != len(self.names):
            raise LogError(
                f"{self.path}: has {len(self.names)} columns, {self.listing}, but 'log.columns' of "
                f"the robot file names {len(names)}; name them all."
            )
        return replace(self, names=tuple(names), _arrow=self._arrow.rename_columns(list(names)))

    @property
    def listing(self) -> str:
        """Columns of the file, for messages."""
        return listed((*self.names, *self.others))

    def row(self, index: int) -> int:
        """Return the row of sample `index`; a CSV's header is row 1."""
        return self._row(index)

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
        k = next((k for k, cell in enumerate(cells) if not _is_number(cell, self._decimal)), 0)
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


def table_of(path: Path, columns: Mapping[str, Array], others: Sequence[str] = ()) -> LogTable:
    """Make a table of columns (N,) of another format."""
    import pyarrow

    arrow = pyarrow.table({name: np.ascontiguousarray(values) for name, values in columns.items()})
    return LogTable(path=path, names=tuple(columns), others=tuple(others), _arrow=arrow)


def require_columns(path: Path, count: int) -> None:
    """Raise LogError above the largest number of columns."""
    if count > _MOST_COLUMNS:
        raise LogError(f"{path}: has {count} columns; at most {_MOST_COLUMNS} are allowed.")


def _is_number(cell: object, point: str) -> bool:
    import pyarrow

    try:
        # Python's float accepts "1_000".
        pyarrow.scalar(str(cell).strip().replace(point, ".")).cast(pyarrow.float64())
    except pyarrow.ArrowInvalid:
        return False
    return True
