"""Tables of numbers in files that pandas and Arrow write."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hesr_model.errors import LogError
from hesr_model.logs.csv_text import read_text
from hesr_model.logs.log_table import LogTable, most_bytes, require_columns, table_of
from hesr_model.support.arrays import Array

_PARQUET, _FEATHER = {".parquet", ".pq"}, {".feather", ".arrow", ".ipc"}


def read_table(path: Path, names: Sequence[str] = ()) -> LogTable:
    """Open a CSV, maybe packed, a Parquet or a Feather file; raises LogError.

    A CSV has commas, or semicolons, tabs or single blanks, which allow decimal commas. Preamble,
    ``#`` of a header, comments, blank lines and a row of units are skipped. Without a header,
    `names` names its columns.
    """
    require_content(path)
    if (suffix := path.suffix.lower()) in _PARQUET:
        return LogTable.of(path, _read_parquet(path))
    return LogTable.of(path, _read_feather(path)) if suffix in _FEATHER else read_text(path, names)


def require_content(path: Path) -> None:
    """Raise LogError unless a file has content."""
    if not path.is_file():
        raise LogError(f"{path}: no such log file.")
    if path.stat().st_size == 0:
        raise LogError(f"{path}: is empty; a log needs a header and rows of data.")


def write_table(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns (N,) as CSV or Parquet, with all digits."""
    table = table_of(path, columns)._arrow
    if path.suffix.lower() in _PARQUET:
        import pyarrow.parquet

        pyarrow.parquet.write_table(table, path)
    else:
        import pyarrow.csv

        pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="none"))


def _read_parquet(path: Path) -> Any:
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            _require_size(path, file.metadata.num_rows, file.metadata.num_columns)
            return file.read()
    except LogError:
        raise
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as Parquet.") from error


def _read_feather(path: Path) -> Any:
    import pyarrow

    try:
        with pyarrow.ipc.open_file(path) as file:
            batches, rows = [], 0
            for k in range(file.num_record_batches):
                batches.append(file.get_batch(k))
                rows += batches[-1].num_rows
                _require_size(path, rows, len(file.schema))
            return pyarrow.Table.from_batches(batches, file.schema)
    except LogError:
        raise
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as Feather.") from error


def _require_size(path: Path, rows: int, columns: int) -> None:
    require_columns(path, columns)
    if 8 * rows * columns > most_bytes(path):
        raise LogError(
            f"{path}: has {rows} rows of {columns} columns, more than fits into the file."
        )
