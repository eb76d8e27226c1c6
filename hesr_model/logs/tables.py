"""Tables of numbers in files that pandas and Arrow write."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.csv_text import Column, read_text, text_pieces
from hesr_model.logs.log_table import (
    LogTable,
    TextCell,
    compute_max_bytes,
    readable,
    require_columns,
)
from hesr_model.support.arrays import Array
from hesr_model.support.extras import install_command

_CHUNK_ROWS = 10_000  # rows written at once
_BATCH_ROWS = 2**16  # rows read at once
_KINDS = dict.fromkeys((".parquet", ".pq"), "Parquet")
_KINDS |= dict.fromkeys((".feather", ".arrow", ".ipc"), "Feather")


def read_table(path: Path, names: Sequence[str] = ()) -> LogTable:
    """Open a CSV, maybe packed, a Parquet or a Feather file; raises LogError.

    A CSV has commas, or semicolons, tabs or single blanks, which allow decimal commas. Preamble,
    ``#`` of a header, comments, blank lines and a row of units are skipped. Without a header,
    `names` names its columns.
    """
    require_content(path)
    kind = _KINDS.get(path.suffix.lower())
    if kind:
        return _build_table(path, import_arrow().concat_tables(_read_batches(path, kind)))
    return read_text(path, names)


def table_pieces(path: Path, names: Sequence[str], max_rows: int) -> Iterator[LogTable]:
    """Yield the tables of successive rows of such a file; raises LogError."""
    require_content(path)
    kind = _KINDS.get(path.suffix.lower())
    if kind:
        yield from (
            _build_table(path, batch)
            for batch in _read_batches(path, kind, max_rows)
            if batch.num_rows
        )
    else:
        yield from text_pieces(path, names, max_rows)


def _build_table(path: Path, arrow_table: Any) -> LogTable:
    return LogTable(
        path,
        tuple(arrow_table.column_names),
        arrow_table.num_rows,
        lambda k: _to_array(arrow_table.column(k)),
    )


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
    return {
        f"{name}{number}": column
        for name, values in signals.items()
        for number, column in enumerate(values.T, start=1)
    }


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
        cells = [np.where(x, "true", "false") if x.dtype == bool else x for x in columns.values()]
        for k in range(0, len(cells[0]), _CHUNK_ROWS):
            chunk = zip(*(x[k : k + _CHUNK_ROWS].tolist() for x in cells), strict=True)
            csv.writer(file, lineterminator="\n").writerows(chunk)


def import_arrow() -> Any:
    """Return pyarrow with `pyarrow.parquet`; raises LogError if it is not installed."""
    try:
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise LogError(
            f"Parquet and Feather need pyarrow: {install_command('formats')}."
        ) from error
    return pyarrow


def _to_array(cells: Any) -> Array | TextCell:
    pa = import_arrow()
    kind = cells.type
    is_time = pa.types.is_timestamp(kind) or pa.types.is_duration(kind)
    if is_time or (pa.types.is_integer(kind) and not cells.null_count):
        return np.asarray(cells.to_numpy())
    with suppress(pa.ArrowException):
        return np.asarray(cells.cast(pa.float64(), safe=False).to_numpy(), dtype=float)
    column = Column()
    try:
        column.add(["" if cell is None else str(cell) for cell in cells.to_pylist()])
    except Exception:  # Python cannot show every date
        return TextCell(index=0, text=str(kind))
    return column.concatenate()


def _read_batches(path: Path, kind: str, max_rows: int = _BATCH_ROWS) -> Iterator[Any]:
    """Yield tables of up to `max_rows` rows, the first one maybe empty."""
    pa = import_arrow()
    row_count = 0
    with readable(path, kind):
        if kind == "Parquet":
            with pa.parquet.ParquetFile(path, pre_buffer=False) as file:
                _require_size(path, file.metadata.num_rows, file.metadata.num_columns)
                yield file.schema_arrow.empty_table()
                for batch in file.iter_batches(max_rows):
                    yield pa.Table.from_batches([batch])
            return
        with pa.ipc.open_file(path) as file:
            yield file.schema.empty_table()
            for k in range(file.num_record_batches):
                batch = file.get_batch(k)
                row_count += batch.num_rows
                _require_size(path, row_count, len(file.schema))
                for first in range(0, batch.num_rows, max_rows):
                    yield pa.Table.from_batches([batch.slice(first, max_rows)])


def _require_size(path: Path, row_count: int, column_count: int) -> None:
    require_columns(path, column_count)
    if 8 * row_count * column_count > compute_max_bytes(path):
        raise LogError(
            f"{path}: has {row_count} rows of {column_count} columns, more than fits into the file."
        )
