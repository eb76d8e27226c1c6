"""Arrays in files, as columns along time; NumPy archives."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable, build_table, compute_max_bytes, readable
from hesr_model.logs.number_arrays import find_number_arrays
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.tables import require_content
from hesr_model.support.arrays import Array

_KIND = "NumPy arrays without objects"


def build_array_table(
    path: Path, arrays: Mapping[str, Array], time: str, other_names: Sequence[str] = ()
) -> LogTable:
    """Make a table as long as the vector `time`, or else as most arrays; raises LogError.

    The columns of an array ``q`` are ``q`` or ``q1``, ``q2``, ..; time is its first axis of that
    length. `other_names` are those of what is no array of numbers.
    """
    arrays = {name: np.squeeze(array) for name, array in arrays.items()}
    length_counts = Counter(max(array.shape) for array in arrays.values() if array.size > 1)
    if not length_counts:
        raise LogError(
            f"{path}: has no arrays of numbers; save tables and timeseries as arrays or structs.",
            code="log.no_arrays",
            where=path,
        )
    row_count = max(length_counts, key=lambda length: (length_counts[length], length))
    if time in arrays and arrays[time].ndim == 1 and arrays[time].size:
        row_count = len(arrays[time])
    columns: dict[str, Array] = {}
    other_arrays = []
    for name, array in arrays.items():
        if row_count not in array.shape:
            other_arrays.append(f"{name} ({' x '.join(map(str, array.shape)) or '1'})")
            continue
        columns |= _split_columns(name, np.moveaxis(array, array.shape.index(row_count), 0))
    return build_table(path, columns, [*other_arrays, *other_names])


def _split_columns(name: str, array: Array) -> dict[str, Array]:
    if array.ndim == 1:
        return {name: array}
    flat = array.reshape(len(array), -1)
    return {f"{name}{k}": column for k, column in enumerate(flat.T, start=1)}


def load_arrays(path: Path) -> dict[str, Any]:
    """Return the arrays of a NumPy file by name, an only one as `data`; raises LogError."""
    require_content(path)
    with readable(path, _KIND), path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"": loaded} if loaded.dtype.names else {"data": loaded}
        if sum(member.file_size for member in loaded.zip.infolist()) > compute_max_bytes(path):
            raise LogError(
                f"{path}: claims more data than fits into the file.",
                code="log.too_large",
                where=path,
            )
        return {name: loaded[name] for name in loaded.files}


def load_table(path: Path, time: str = "t") -> LogTable:
    """Open a NumPy file as the table of its numbers; see `build_array_table`."""
    arrays: dict[str, Array] = {}
    other_names = []
    for name, value in load_arrays(path).items():
        number_arrays = dict(find_number_arrays(value, name))
        arrays |= number_arrays
        if not number_arrays:
            other_names.append(name)
    return build_array_table(path, arrays, time, other_names)


def _read_pieces(path: Path, _log_format: LogFormat, max_rows: int) -> Iterator[LogTable]:
    """Yield tables of successive rows; none of arrays that are not stored row by row."""
    require_content(path)
    with readable(path, _KIND), ExitStack() as files:
        if path.suffix.lower() == ".npy":
            open_files: dict[str, Any] = {"": files.enter_context(path.open("rb"))}
        else:
            archive = files.enter_context(ZipFile(path))
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            open_files = {k: files.enter_context(archive.open(f"{k}.npy")) for k in names}
        headers = {name: _read_head(file) for name, file in open_files.items()}
        longest_length = max((shape[0] for shape, *_ in headers.values() if shape), default=0)
        longest_headers = {
            name: head for name, head in headers.items() if head[0][:1] == (longest_length,)
        }
        if any(fortran for _, fortran, _ in longest_headers.values()):
            return
        for first in range(0, longest_length, max_rows):
            columns: dict[str, Array] = {}
            for name, (shape, _, dtype) in longest_headers.items():
                row_count = min(max_rows, longest_length - first)
                content = open_files[name].read(row_count * dtype.itemsize * math.prod(shape[1:]))
                piece_shape = [row_count, *(length for length in shape[1:] if length > 1)]
                array = np.frombuffer(content, dtype).reshape(piece_shape)
                # As `load_arrays` names an only array.
                if not name and not dtype.names:
                    name = "data"
                for column, values in find_number_arrays(array, name):
                    columns |= _split_columns(column, values)
            yield build_table(
                path, columns, [name for name in headers if name not in longest_headers]
            )


def _read_head(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    npy_format = np.lib.format
    if npy_format.read_magic(file) == (1, 0):
        return npy_format.read_array_header_1_0(file)
    return npy_format.read_array_header_2_0(file)


FORMAT = table_format(
    "NumPy file",
    {".npz", ".npy"},
    lambda path, log_format: load_table(path, log_format.columns.time_name),
    _read_pieces,
)
