"""Parquet and Feather files."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.csv_text import Column
from hesr_model.logs.log_table import TextCell, compute_max_bytes, readable, require_columns
from hesr_model.logs.parsers.items import build_item
from hesr_model.support.arrays import Array
from hesr_model.support.child_main import Item

_BATCH_ROWS = 2**16  # rows read at once
_MAX_LIST_LENGTH = 1000  # entries of lists in cells; longer ones are images
_NOT_A_TIME = np.iinfo(np.int64).min  # NumPy's NaT


def parse(path: Path, *, kind: str) -> Iterator[Item]:
    """Yield a whole table; raises LogError."""
    import pyarrow as pa  # slow to import, and optional

    with readable(path, kind):
        yield _build_item(pa.concat_tables(_read_batches(path, kind, _BATCH_ROWS)))


def parse_pieces(path: Path, *, kind: str, max_rows: int) -> Iterator[Item]:
    """Yield the tables of at most `max_rows` successive rows; raises LogError."""
    for batch in _read_batches(path, kind, max_rows):
        if batch.num_rows:
            yield _build_item(batch)


def _build_item(table: Any) -> Item:
    columns: list[tuple[str, Array | TextCell]] = []
    for k, name in enumerate(table.column_names):
        columns += _expand_column(name, table.column(k))
    return build_item(columns, row_count=table.num_rows)


def _expand_column(name: str, cells: Any) -> Iterator[tuple[str, Array | TextCell]]:
    """Yield a column for each entry of lists of one length and each field of structs."""
    import pyarrow as pa
    import pyarrow.compute

    kind = cells.type
    if pa.types.is_struct(kind):
        for field in kind:
            yield from _expand_column(
                f"{name}.{field.name}", pa.compute.struct_field(cells, field.name)
            )
    elif (
        pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    ):
        lengths = pa.compute.min_max(pa.compute.list_value_length(cells)).as_py()
        shortest, longest = lengths["min"] or 0, lengths["max"] or 0
        if not 0 < shortest == longest <= _MAX_LIST_LENGTH:
            yield name, TextCell(index=0, text=f"lists of {shortest} to {longest} values")
            return
        for k in range(longest):
            entry_name = f"{name}_{k + 1}" if longest > 1 else name
            yield from _expand_column(entry_name, pa.compute.list_element(cells, k))
    else:
        yield name, _to_array(cells)


def _to_array(cells: Any) -> Array | TextCell:
    import pyarrow as pa

    kind = cells.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        letter = "M" if pa.types.is_timestamp(kind) else "m"
        counts = _copy_numbers(cells.cast(pa.int64()), "int64", _NOT_A_TIME)
        return counts.view(f"{letter}8[{kind.unit}]")
    if pa.types.is_integer(kind) and not cells.null_count:
        return _copy_numbers(cells, str(kind), 0)
    with suppress(pa.ArrowException):
        return _copy_numbers(cells.cast(pa.float64(), safe=False), "float64", np.nan)
    column = Column()
    try:
        column.add(["" if cell is None else str(cell) for cell in cells.to_pylist()])
    except Exception:  # Python cannot show every date
        return TextCell(index=0, text=str(kind))
    return column.concatenate()


def _copy_numbers(cells: Any, kind: str, missing: float) -> Array:
    """Return a column of numbers, from its memory: Arrow would import pandas."""
    import pyarrow as pa

    parts = [np.empty(0, kind)]
    for chunk in filter(len, cells.chunks):
        is_missing = chunk.is_null().cast(pa.uint8())
        part = _view_memory(chunk, kind).copy()
        part[_view_memory(is_missing, "bool")] = missing
        parts.append(part)
    return np.concatenate(parts)


def _view_memory(chunk: Any, kind: str) -> Array:
    array_type = np.dtype(kind)
    memory = chunk.buffers()[1]
    return np.frombuffer(memory, array_type, len(chunk), chunk.offset * array_type.itemsize)


def _read_batches(path: Path, kind: str, max_rows: int) -> Iterator[Any]:
    """Yield tables of up to `max_rows` rows, the first one maybe empty."""
    import pyarrow as pa  # slow to import, and optional
    import pyarrow.parquet

    row_count = 0
    with readable(path, kind):
        if kind == "Parquet":
            with pa.parquet.ParquetFile(path, pre_buffer=False) as file:
                _require_size(path, file.metadata.num_rows, file.metadata.num_columns)
                yield pa.Table.from_batches([], file.schema_arrow)
                for batch in file.iter_batches(max_rows):
                    yield pa.Table.from_batches([batch])
            return
        with pa.ipc.open_file(path) as file:
            yield pa.Table.from_batches([], file.schema)
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
