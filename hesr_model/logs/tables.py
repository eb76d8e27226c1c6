"""Tables of numbers in files that pandas and Arrow write."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.csv_text import read_text, text_pieces
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.parsed_file import has_module, parse_file
from hesr_model.support.arrays import Array
from hesr_model.support.extras import install_command

_CHUNK_ROWS = 10_000  # rows written at once
_LIBRARIES = ("pyarrow.parquet", "pyarrow.compute")
_KINDS = dict.fromkeys((".parquet", ".pq"), "Parquet")
_KINDS |= dict.fromkeys((".feather", ".arrow", ".ipc"), "Feather")


def read_table(path: Path, names: Sequence[str] = ()) -> LogTable:
    """Open a CSV, maybe packed, a Parquet or a Feather file; raises LogError.

    A CSV has commas, or semicolons, tabs or single blanks, which allow decimal commas. Preamble,
    ``#`` of a header, comments and blank lines are skipped; a row of units is read. Without a
    header, `names` names its columns.
    """
    require_content(path)
    kind = _KINDS.get(path.suffix.lower())
    if kind:
        (table,) = _parse_tables(path, kind, "arrow:parse", {"kind": kind})
        return table
    return read_text(path, names)


def table_pieces(path: Path, names: Sequence[str], max_rows: int) -> Iterator[LogTable]:
    """Yield the tables of successive rows of such a file; raises LogError."""
    require_content(path)
    kind = _KINDS.get(path.suffix.lower())
    if kind:
        yield from _parse_tables(
            path, kind, "arrow:parse_pieces", {"kind": kind, "max_rows": max_rows}
        )
    else:
        yield from text_pieces(path, names, max_rows)


def _parse_tables(
    path: Path, kind: str, parser: str, options: Mapping[str, Any]
) -> Iterator[LogTable]:
    _require_arrow()
    for item in parse_file(path, kind, parser, _LIBRARIES, options):
        names = tuple(name for name, _ in item.columns)
        yield LogTable(path, names, item.row_count, item.get_cells)


def require_content(path: Path) -> None:
    """Raise LogError unless a file has content."""
    if not path.is_file():
        raise LogError(f"{path}: no such log file.", code="file.missing", where=path)
    if path.stat().st_size == 0:
        raise LogError(
            f"{path}: is empty; a log needs a header and rows of data.",
            code="log.empty",
            where=path,
        )


def number_columns(**signals: Array) -> dict[str, Array]:
    """Return columns (N,) of signals (N, n) by name, ``q1, q2..`` of `q`."""
    columns: dict[str, Array] = {}
    for name, values in signals.items():
        for number, column in enumerate(values.T, start=1):
            columns[f"{name}{number}"] = column
    return columns


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns (N,) as CSV, Parquet or ``.npz``, with all digits."""
    if path.suffix == ".npz":
        with path.open("wb") as archive:
            np.savez_compressed(archive, allow_pickle=False, **columns)
        return
    if _KINDS.get(path.suffix.lower()) == "Parquet":
        arrays = {name: np.ascontiguousarray(values) for name, values in columns.items()}
        import_arrow().parquet.write_table(import_arrow().table(arrays), path)
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL).writerow(columns)
        cells = [_format_truths(column) for column in columns.values()]
        for k in range(0, len(cells[0]), _CHUNK_ROWS):
            chunk = zip(*(x[k : k + _CHUNK_ROWS].tolist() for x in cells), strict=True)
            csv.writer(file, lineterminator="\n").writerows(chunk)


def _format_truths(column: Array) -> Array:
    """Return truth values as words, other columns unchanged."""
    return np.where(column, "true", "false") if column.dtype == bool else column


def import_arrow() -> Any:
    """Return pyarrow with `pyarrow.parquet`; raises LogError if it is not installed."""
    _require_arrow()
    import pyarrow.parquet

    return pyarrow


def _require_arrow() -> None:
    if not has_module("pyarrow"):
        raise LogError(f"Parquet and Feather need pyarrow: {install_command('formats')}.")
