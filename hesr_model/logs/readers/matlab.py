"""MATLAB files; version 7.3 is HDF5 with transposed matrices and needs h5py."""

from pathlib import Path

from hesr_model.errors import LogError
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable, most_bytes
from hesr_model.logs.readers.arrays import numeric, table_of_arrays
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.readers.hdf5 import arrays_of_hdf5
from hesr_model.logs.readers.matlab_elements import require_sound
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
    if is_hdf5:
        return table_of_arrays(path, arrays_of_hdf5(path, "MATLAB file", transposed=True), time)
    return table_of_arrays(path, _classic(path), time)


def _classic(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat

    try:
        require_sound(path, most_bytes(path))
        content = loadmat(path, simplify_cells=True)
    except OverflowError as error:
        raise LogError(f"{path}: claims more data than fits into the file.") from error
    except Exception as error:  # many kinds
        raise LogError(f"{path}: cannot be read as a MATLAB file.") from error
    return dict(numeric({k: v for k, v in content.items() if not k.startswith("__")}, ""))


def _read(path: Path, log: LogFormat) -> LogTable:
    return read_matlab(path, time=log.columns.t)


FORMAT = table_format("MATLAB file", {".mat"}, _read)
