"""A table of numbers, with messages that name the wrong cell."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.support.arrays import Array

_MOST_COLUMNS = 10_000
_MOST_LISTED = 30  # names in a sentence
_LONGEST_NAME = 60  # characters of a name
_UNITS = {"D": 86400.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # of times [s]
_SINCE_1970 = 1e8  # [s]; larger stamps count from an epoch


@dataclass(frozen=True, kw_only=True)
class TextCell:
    """First cell of a column that is not a number."""

    index: int
    text: str


@dataclass(frozen=True, eq=False)
class LogTable:
    """An open table file; messages on missing columns mention `others`.

    Columns (N,) of `arrays` hold integers, floats (NaN for empty cells), times or durations; a
    `TextCell` replaces any other column. The lines of a CSV have a `number`, its header's is 1. A
    piece of a file has rows `before` it and the `first` piece, whose first date is the origin.
    """

    path: Path
    names: tuple[str, ...]
    rows: int
    arrays: Callable[[int], Array | TextCell]
    others: tuple[str, ...] = ()
    number: Sequence[int] = ()
    before: int = 0
    first: "LogTable | None" = None

    def __post_init__(self) -> None:
        twice = [name for name, count in Counter(self.names).items() if count > 1]
        if twice:
            raise LogError(
                f"{self.path}: column '{twice[0]}' occurs twice; names must differ.",
                code="log.columns_twice",
                where=self.path,
                key=twice[0],
            )
        if self.rows == 0:
            raise LogError(
                f"{self.path}: has no rows of data below its header.",
                code="log.empty",
                where=self.path,
            )

    def named(self, names: Sequence[str]) -> "LogTable":
        """Return the table with other names of its columns, if any; raises LogError."""
        if not names or tuple(names) == self.names:
            return self
        if len(names) != len(self.names):
            raise LogError(
                f"{self.path}: has {len(self.names)} columns, {self.listing}, but 'log.columns' of "
                f"the robot file names {len(names)}; name them all.",
                code="log.names_count",
                where=self.path,
                key="log.columns.names",
            )
        return replace(self, names=tuple(names))

    def row(self, index: int) -> int:
        """Return the row of a sample in the file, from 1."""
        return self.number[index] if self.number else self.before + index + 1

    @property
    def listing(self) -> str:
        """Columns of the file, for messages."""
        return listed((*self.names, *self.others))

    def numbers(self, names: Sequence[str], *, missing: bool = False) -> Array:
        """Return columns (N, len(names)), `missing` cells as NaN; raises LogError."""
        columns = [(name, self._column(name)) for name in names]
        return np.column_stack([self._floats(*column, missing=missing) for column in columns])

    def times(self, name: str, unit: float, *, missing: bool = False) -> Array:
        """Return time stamps (N,) [s], given in `unit` [s]; dates from the first one."""
        stamps, unit = self._stamps(name, unit, missing)
        first = stamps if self.first is None else self.first._stamps(name, unit, missing)[0]
        known = first[np.isfinite(first)]
        since = known[0] if len(known) and abs(float(known[0])) * unit > _SINCE_1970 else 0
        return np.asarray((stamps - since) * unit, dtype=float)

    def _stamps(self, name: str, unit: float, missing: bool) -> tuple[Any, float]:
        cells: Any = self._column(name)
        if _kind(cells) in "mM":
            unit = _UNITS[np.datetime_data(cells.dtype)[0]]
            empty, cells = np.isnat(cells), cells.astype(np.int64)
            cells = np.where(empty, np.nan, cells) if empty.any() else cells
        # Nanoseconds since 1970 exceed the digits of a float: subtract before.
        whole = _kind(cells) in "iu"
        return (cells if whole else self._floats(name, cells, missing=missing)), unit

    def _column(self, name: str) -> Array | TextCell:
        if name not in self.names:
            raise LogError(
                f"{self.path}: column '{name}' is missing; it has {self.listing}.",
                code="log.column_missing",
                where=self.path,
                key=name,
            )
        return self.arrays(self.names.index(name))

    def _floats(self, name: str, cells: Array | TextCell, *, missing: bool) -> Array:
        if not isinstance(cells, TextCell) and _kind(cells) in "mM":
            k = int(np.argmin(np.isnat(cells)))
            cells = TextCell(index=k, text=str(cells[k]))
        if isinstance(cells, TextCell):
            raise LogError(
                f"{self.path}: column '{name}', row {self.row(cells.index)}: {cells.text!r} where "
                "a number is needed.",
                code="log.text",
                where=self.path,
                key=name,
            )
        values = np.asarray(cells, dtype=float)
        good = ~np.isinf(values) if missing else np.isfinite(values)
        if not np.all(good):
            k = int(np.argmin(good))
            found = "an empty cell or NaN" if np.isnan(values[k]) else "infinity"
            raise LogError(
                f"{self.path}: column '{name}', row {self.row(k)}: {found} where a finite number "
                "is needed.",
                code="log.finite",
                where=self.path,
                key=name,
            )
        return values


def listed(names: Sequence[str]) -> str:
    """Return names for a sentence, shortened if many."""
    more = len(names) - _MOST_LISTED
    shown = [name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..." for name in names]
    return ", ".join((*shown[:_MOST_LISTED], *([f"and {more} more"] if more > 0 else [])))


@contextmanager
def readable(path: Path, what: str) -> Iterator[None]:
    """Raise LogError for errors of libraries, of many kinds, in the block."""
    try:
        yield
    except LogError:
        raise
    except Exception as error:
        raise LogError(
            f"{path}: cannot be read as {what}.", code="file.unreadable", where=path
        ) from error


def most_bytes(path: Path) -> int:
    """Return the allowed memory [B] of a packed file."""
    return 10 * path.stat().st_size + 300 * 2**20


def table_of(path: Path, columns: Mapping[str, Array], others: Sequence[str] = ()) -> LogTable:
    """Make a table of columns (N,) of another format."""
    arrays = list(columns.values())
    return LogTable(path, tuple(columns), len(arrays[0]), arrays.__getitem__, tuple(others))


def require_columns(path: Path, count: int) -> None:
    """Raise LogError above the largest number of columns."""
    if count > _MOST_COLUMNS:
        raise LogError(
            f"{path}: has {count} columns; at most {_MOST_COLUMNS} are allowed.",
            code="log.most_columns",
            where=path,
        )


def _kind(cells: Array | TextCell) -> str:
    return "text" if isinstance(cells, TextCell) else cells.dtype.kind
