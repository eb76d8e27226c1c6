"""Arrays in files, as columns along time; NumPy archives."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import LogTable, most_bytes, table_of
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.tables import require_content
from hesr_model.support.arrays import Array


def table_of_arrays(path: Path, arrays: Mapping[str, Array], time: str) -> LogTable:
    """Make a table as long as the vector `time`, or else as most arrays; raises LogError.

    The columns of an array ``q`` are ``q`` or ``q1``, ``q2``, ..; time is its first axis of that
    length.
    """
    arrays = {name: np.squeeze(array) for name, array in arrays.items()}
    counted = Counter(max(array.shape) for array in arrays.values() if array.size > 1)
    if not counted:
        raise LogError(
            f"{path}: has no arrays of numbers; save tables and timeseries as arrays or structs."
        )
    rows = max(counted, key=lambda length: (counted[length], length))
    if time in arrays and arrays[time].ndim == 1 and arrays[time].size:
        rows = len(arrays[time])
    columns: dict[str, Array] = {}
    others = []
    for name, array in arrays.items():
        if rows not in array.shape:
            others.append(f"{name} ({' x '.join(map(str, array.shape)) or '1'})")
            continue
        flat = np.moveaxis(array, array.shape.index(rows), 0).reshape(rows, -1)
        one = array.ndim == 1
        columns |= {name if one else f"{name}{k}": x for k, x in enumerate(flat.T, start=1)}
    return table_of(path, columns, others)


def numeric(value: Any, name: str) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of numbers in nested structures, named as in MATLAB."""
    if isinstance(value, Mapping):
        for field, inner in value.items():
            yield from numeric(inner, f"{name}.{field}" if name else str(field))
    elif isinstance(value, list):
        for k, inner in enumerate(value, start=1):
            yield from numeric(inner, f"{name}({k})")
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        yield from numeric(list(value.ravel()), name)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        yield from numeric({field: value[field] for field in value.dtype.names}, name)
    elif np.asarray(value).dtype.kind in "fiu":
        yield name, np.asarray(value, dtype=float)


def load_arrays(path: Path) -> dict[str, Any]:
    """Return the arrays of a NumPy file by name, an only one as `data`; raises LogError."""
    require_content(path)
    try:
        with path.open("rb") as file:
            found = np.load(file, allow_pickle=False)
            if isinstance(found, np.ndarray):
                return {"": found} if found.dtype.names else {"data": found}
            if sum(one.file_size for one in found.zip.infolist()) > most_bytes(path):
                raise LogError(f"{path}: claims more data than fits into the file.")
            return {name: found[name] for name in found.files}
    except LogError:
        raise
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as NumPy arrays without objects.") from error


def load_table(path: Path, time: str = "t") -> LogTable:
    """Open a NumPy file as the table of its numbers; see `table_of_arrays`."""
    content = load_arrays(path)
    arrays = {k: a for name, value in content.items() for k, a in numeric(value, name)}
    return table_of_arrays(path, arrays, time)


FORMAT = table_format(
    "NumPy file", {".npz", ".npy"}, lambda path, log: load_table(path, log.columns.t)
)
