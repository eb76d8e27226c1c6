"""A table of numbers, with messages that name the wrong cell."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.column_names import find_fraction_unit, read_name
from hesr_model.support.arrays import Array
from hesr_model.support.ledger import find_close_names, format_suggestion

_MAX_COLUMNS = 10_000
_MAX_NAMES = 30  # names in a sentence
_MIN_NAME_SIMILARITY = 0.75  # of a name that may have been meant
_MAX_NAME_LENGTH = 60  # characters of a name
_UNITS = {"D": 86400.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # of times [s]
_MAX_SECONDS = 9e9  # whose nanoseconds 64 bits hold
_SINCE_1970 = 1e8  # [s]; larger stamps count from an epoch


@dataclass(frozen=True, kw_only=True)
class TextCell:
    """First cell of a column that is not a number."""

    index: int
    text: str
    expected: str = "a number"


NO_NUMBERS = TextCell(index=0, text="no numbers")
"""Stands for what is no array of numbers in a file of arrays."""


@dataclass(frozen=True, eq=False)
class LogTable:
    """An open table file; messages on missing columns mention `other_names`.

    Columns (N,) of `arrays` hold integers, floats (NaN for empty cells), times or durations; a
    `TextCell` replaces any other column. The rows of a CSV have `line_numbers`, its header is
    line 1. A piece of a file has `rows_before` it and the `first_piece`, whose first date is the
    origin. `units` are those in the cells, by name; `left_out` are numbers of rows by cause.
    """

    path: Path
    names: tuple[str, ...]
    rows: int
    arrays: Callable[[int], Array | TextCell]
    other_names: tuple[str, ...] = ()
    line_numbers: Sequence[int] = ()
    rows_before: int = 0
    first_piece: "LogTable | None" = None
    units: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)  # names that were looked up

    def __post_init__(self) -> None:
        repeated_names = [name for name, count in Counter(self.names).items() if count > 1]
        if repeated_names:
            raise LogError(
                f"{self.path}: column '{repeated_names[0]}' occurs twice; names must differ.",
                code="log.columns_twice",
                where=self.path,
                key=repeated_names[0],
            )
        if self.rows == 0:
            raise LogError(
                f"{self.path}: has no rows of data below its header.",
                code="log.empty",
                where=self.path,
            )

    def rename_columns(self, names: Sequence[str]) -> "LogTable":
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
        units = {
            name: self.units[old_name]
            for old_name, name in zip(self.names, names, strict=True)
            if old_name in self.units
        }
        return replace(self, names=tuple(names), units=units)

    def hide_empty_columns(self) -> "LogTable":
        """Return the table without columns that have no number; messages mention them."""
        is_empty = [_is_empty(self.arrays(k)) for k in range(len(self.names))]
        if not any(is_empty):
            return self
        kept = [k for k, empty in enumerate(is_empty) if not empty]
        empty_names = [f"{self.names[k]} (no numbers)" for k in np.flatnonzero(is_empty)]
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            arrays=lambda k: self.arrays(kept[k]),
            other_names=(*empty_names, *self.other_names),
        )

    def row(self, index: int) -> int:
        """Return the row of a sample in the file, from 1."""
        return self.line_numbers[index] if self.line_numbers else self.rows_before + index + 1

    @property
    def listing(self) -> str:
        """Columns of the file, for messages."""
        return join_names((*self.names, *self.other_names))

    def suggest_names(self, missing: Sequence[str]) -> str:
        """Return the names that resemble missing ones, for the end of a message."""
        close_names: dict[str, None] = {}
        for name in missing:
            close_names |= dict.fromkeys(find_same_kind(name, self.names))
        suggestion = format_suggestion(list(close_names))
        return f"; {suggestion.removesuffix('?')}" if suggestion else ""

    def numbers(self, names: Sequence[str], *, missing: bool = False) -> Array:
        """Return columns (N, len(names)), `missing` cells as NaN; raises LogError."""
        columns = [(name, self._find_column(name)) for name in names]
        return np.column_stack([self._to_floats(*column, missing=missing) for column in columns])

    def times(self, name: str | tuple[str, str], unit: float, *, missing: bool = False) -> Array:
        """Return time stamps (N,) [s], given in `unit` [s]; dates from the first one.

        Of two columns, the first one has whole seconds. The second one has nanoseconds since, or
        another unit that its name ends with.
        """
        stamps, unit = self._read_stamps(name, unit, missing)
        first_stamps = stamps
        if self.first_piece is not None:
            first_stamps, _ = self.first_piece._read_stamps(name, unit, missing)
        finite_stamps = first_stamps[np.isfinite(first_stamps)]
        origin = 0
        if len(finite_stamps) and abs(float(finite_stamps[0])) * unit > _SINCE_1970:
            origin = finite_stamps[0]
        return np.asarray((stamps - origin) * unit, dtype=float)

    def _read_stamps(
        self, name: str | tuple[str, str], unit: float, missing: bool
    ) -> tuple[Any, float]:
        if not isinstance(name, str):
            return self._join_stamps(*name, missing=missing), 1e-9
        cells: Any = self._find_column(name)
        if _find_kind(cells) in "mM":
            unit = _UNITS[np.datetime_data(cells.dtype)[0]]
            is_empty = np.isnat(cells)
            cells = cells.astype(np.int64)
            if is_empty.any():
                cells = np.where(is_empty, np.nan, cells)
        # Nanoseconds since 1970 exceed the digits of a float: subtract before.
        if _find_kind(cells) in "iu":
            return cells, unit
        return self._to_floats(name, cells, missing=missing), unit

    def _join_stamps(self, seconds: str, fraction: str, *, missing: bool) -> Any:
        """Return stamps (N,) [ns] of two columns; whole numbers stay exact."""
        unit = find_fraction_unit(fraction)
        values = self.numbers((seconds, fraction), missing=missing)
        if not is_seconds_and_fraction(values, unit):
            raise LogError(
                f"{self.path}: columns '{seconds}' and '{fraction}' are not whole seconds and the "
                f"{unit} since; name one of them as 'log.columns.t' of the robot file.",
                code="log.seconds",
                where=self.path,
                key="log.columns.t",
            )
        nanoseconds = round(1e9 * _UNITS[unit])
        is_whole = np.array_equal(values, np.rint(values))
        # Nanoseconds since 1970 exceed the digits of a float.
        if is_whole and np.max(np.abs(values)) < _MAX_SECONDS:
            whole_seconds, remainder = values.astype(np.int64).T
            return whole_seconds * 1_000_000_000 + remainder * nanoseconds
        return values[:, 0] * 1e9 + values[:, 1] * nanoseconds

    def _find_column(self, name: str) -> Array | TextCell:
        if name not in self.names:
            raise LogError(
                f"{self.path}: column '{name}' is missing; it has {self.listing}"
                f"{self.suggest_names([name])}.",
                code="log.column_missing",
                where=self.path,
                key=name,
            )
        self.used.add(name)
        return self.arrays(self.names.index(name))

    def _to_floats(self, name: str, cells: Array | TextCell, *, missing: bool) -> Array:
        if not isinstance(cells, TextCell) and _find_kind(cells) in "mM":
            k = int(np.argmin(np.isnat(cells)))
            cells = TextCell(index=k, text=str(cells[k]))
        if isinstance(cells, TextCell):
            raise LogError(
                f"{self.path}: column '{name}', row {self.row(cells.index)}: {cells.text!r} where "
                f"{cells.expected} is needed.",
                code="log.text",
                where=self.path,
                key=name,
            )
        values = np.asarray(cells, dtype=float)
        is_usable = ~np.isinf(values) if missing else np.isfinite(values)
        if not np.all(is_usable):
            k = int(np.argmin(is_usable))
            content = "infinity"
            if np.isnan(values[k]):
                content = "an empty cell or NaN"
            raise LogError(
                f"{self.path}: column '{name}', row {self.row(k)}: {content} where a finite number "
                "is needed.",
                code="log.finite",
                where=self.path,
                key=name,
            )
        return values


def find_same_kind(name: str, candidates: Sequence[str]) -> list[str]:
    """Return the candidate that resembles a name most, if it may be of the same quantity."""
    same_kind = [candidate for candidate in candidates if _may_be_same(name, candidate)]
    return find_close_names(name, same_kind, 1, _MIN_NAME_SIMILARITY)


def _may_be_same(name: str, other: str) -> bool:
    """Return whether two names are not those of different quantities, as q1 and dq1."""
    quantities = _list_quantities(name)
    other_quantities = _list_quantities(other)
    is_open = not quantities or not other_quantities
    return is_open or not quantities.isdisjoint(other_quantities)


def _list_quantities(name: str) -> set[str]:
    return {reading.quantity for reading in read_name(name)}


def join_names(names: Sequence[str]) -> str:
    """Return names for a sentence, shortened if many."""
    words = []
    for name in names[:_MAX_NAMES]:
        is_long = len(name) > _MAX_NAME_LENGTH
        words.append(f"{name[:_MAX_NAME_LENGTH]}..." if is_long else name)
    if len(names) > _MAX_NAMES:
        words.append(f"and {len(names) - _MAX_NAMES} more")
    return ", ".join(words)


def is_seconds_and_fraction(values: Array, unit: str) -> bool:
    """Return whether columns (N, 2) are whole seconds, and less than 1 s since in a `unit`."""
    seconds, fraction = values[np.all(np.isfinite(values), axis=1)].T
    is_whole = np.array_equal(seconds, np.rint(seconds))
    return is_whole and bool(np.all((fraction >= 0.0) & (fraction * _UNITS[unit] < 1.0)))


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Raise LogError for errors of libraries, of many kinds, in the block."""
    try:
        yield
    except LogError:
        raise
    except Exception as error:
        raise LogError(
            f"{path}: cannot be read as {kind}.", code="file.unreadable", where=path
        ) from error


def compute_max_bytes(path: Path) -> int:
    """Return the allowed memory [B] of a packed file, or of the files in a folder."""
    files = path.rglob("*") if path.is_dir() else [path]
    return 10 * sum(file.stat().st_size for file in files) + 300 * 2**20


def build_table(
    path: Path, columns: Mapping[str, Array], other_names: Sequence[str] = ()
) -> LogTable:
    """Make a table of columns (N,) of another format."""
    arrays = list(columns.values())
    return LogTable(path, tuple(columns), len(arrays[0]), arrays.__getitem__, tuple(other_names))


def require_columns(path: Path, count: int) -> None:
    """Raise LogError above the largest number of columns."""
    if count > _MAX_COLUMNS:
        raise LogError(
            f"{path}: has {count} columns; at most {_MAX_COLUMNS} are allowed.",
            code="log.most_columns",
            where=path,
        )


def _is_empty(cells: Array | TextCell) -> bool:
    """Return whether a column of numbers or times has none."""
    if isinstance(cells, TextCell) or cells.dtype.kind not in "fmM":
        return False
    is_missing = np.isnan if cells.dtype.kind == "f" else np.isnat
    return bool(np.all(is_missing(cells)))


def _find_kind(cells: Array | TextCell) -> str:
    return "text" if isinstance(cells, TextCell) else cells.dtype.kind
