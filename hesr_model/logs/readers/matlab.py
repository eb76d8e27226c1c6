"""MATLAB files; version 7.3 is HDF5 with transposed matrices and needs h5py."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.readers.matlab_elements import require_sound
from hesr_model.logs.tables import LogTable, listed, most_bytes, table_of
from hesr_model.support.arrays import Array

_HDF5 = b"\x89HDF\r\n\x1a\n"  # after a header of 512 bytes


def read_matlab(path: Path, *, time: str) -> LogTable:
    """Open a MATLAB file as a table as long as the vector `time`; raises LogError.

    A matrix ``q`` of N rows or columns (also 1 x n x N, from Simulink) gives ``q1``, ``q2``, ..;
    fields are named as in MATLAB, ``log.t``, ``out.signals(2).values1``.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log file.")
    with path.open("rb") as file:
        is_hdf5 = file.read(520)[512:] == _HDF5
    arrays = dict(_hdf5(path) if is_hdf5 else _classic(path))
    t = arrays.get(time)
    if t is None or t.ndim != 1:
        found = listed([_described(name, array) for name, array in arrays.items()])
        raise LogError(
            f"{path}: column '{time}' is missing; it has {found or 'no numeric arrays'}. Save "
            "tables and timeseries as arrays or structs."
        )
    columns: dict[str, Array] = {}
    others = []
    for name, array in arrays.items():
        if array.ndim == 1 and len(array) == len(t):
            columns[name] = array
        elif array.ndim == 2 and len(t) in array.shape:
            rows = array if array.shape[0] == len(t) else array.T
            columns |= {f"{name}{k}": column for k, column in enumerate(rows.T, start=1)}
        else:
            others.append(_described(name, array))
    return table_of(path, columns, others)


def _described(name: str, array: Array) -> str:
    return f"{name} ({' x '.join(map(str, array.shape)) or '1'})"


def _classic(path: Path) -> Iterator[tuple[str, Array]]:
    from scipy.io import loadmat

    try:
        require_sound(path, most_bytes(path))
        content = loadmat(path, simplify_cells=True)
    except OverflowError as error:
        raise _too_large(path) from error
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as a MATLAB file.") from error
    return _numeric({k: v for k, v in content.items() if not k.startswith("__")}, "")


def _too_large(path: Path) -> LogError:
    return LogError(f"{path}: claims more data than fits into the file.")


def _numeric(value: Any, name: str) -> Iterator[tuple[str, Array]]:
    if isinstance(value, Mapping):
        for field, inner in value.items():
            yield from _numeric(inner, f"{name}.{field}" if name else str(field))
    elif isinstance(value, list):
        for k, inner in enumerate(value, start=1):
            yield from _numeric(inner, f"{name}({k})")
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        yield from _numeric(list(value.ravel()), name)
    elif np.asarray(value).dtype.kind in "fiu":
        yield name, np.asarray(value, dtype=float)


def _hdf5(path: Path) -> Iterator[tuple[str, Array]]:
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise LogError(
            f"{path}: MATLAB 7.3 files need h5py: pip install 'hesr[matlab]', or save with '-v7'."
        ) from error

    found: list[tuple[str, Array]] = []
    left = most_bytes(path)

    def visit(name: str, item: Any) -> None:
        # Characters are numbers; '#refs#' holds targets of references in struct arrays.
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            is_number = item.attrs.get("MATLAB_class", b"") not in (b"char", b"cell")
            if is_number and item.dtype.kind in "fiu" and "MATLAB_empty" not in item.attrs:
                nonlocal left
                left -= 8 * item.size
                if left < 0:
                    raise _too_large(path)
                array = np.squeeze(np.transpose(np.asarray(item, dtype=float)))
                found.append((name.replace("/", "."), array))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except LogError:
        raise
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as a MATLAB file.") from error
    return iter(found)
