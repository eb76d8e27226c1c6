"""HDF5 files, also those of MATLAB 7.3; needs h5py."""

from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable, compute_max_bytes, readable
from hesr_model.logs.readers.arrays import build_array_table, find_number_arrays
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.tables import require_content
from hesr_model.support.arrays import Array


def read_hdf5_arrays(path: Path, kind: str, *, transposed: bool = False) -> dict[str, Array]:
    """Return the arrays of numbers by path with dots; raises LogError that names the `kind`."""
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise LogError(
            f"{path}: {kind}s need h5py: pip install 'hesr[formats]'.",
            code="log.package",
            where=path,
        ) from error

    arrays: dict[str, Array] = {}
    bytes_left = compute_max_bytes(path)

    def visit(name: str, dataset: Any) -> None:
        # Characters are numbers; '#refs#' holds targets of references in struct arrays.
        if not isinstance(dataset, h5py.Dataset) or name.startswith("#"):
            return
        is_number = dataset.attrs.get("MATLAB_class", b"") not in (b"char", b"cell")
        if is_number and dataset.dtype.kind in "fiuV" and "MATLAB_empty" not in dataset.attrs:
            nonlocal bytes_left
            bytes_left -= max(8, dataset.dtype.itemsize) * dataset.size
            if bytes_left < 0:
                raise LogError(
                    f"{path}: claims more data than fits into the file.",
                    code="log.too_large",
                    where=path,
                )
            array = np.asarray(dataset)
            arrays.update(
                find_number_arrays(array.T if transposed else array, name.replace("/", "."))
            )

    with readable(path, f"a {kind}"), h5py.File(path, "r") as file:
        file.visititems(visit)
    return arrays


def _read(path: Path, log_format: LogFormat) -> LogTable:
    require_content(path)
    return build_array_table(
        path, read_hdf5_arrays(path, "HDF5 file"), log_format.columns.time_name
    )


FORMAT = table_format("HDF5 file", {".h5", ".hdf5", ".hdf"}, _read)
