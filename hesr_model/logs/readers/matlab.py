"""MATLAB files; version 7.3 is HDF5 with transposed matrices and needs h5py."""

from pathlib import Path

from hesr_model.errors import LogError
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.parsed_file import parse_file
from hesr_model.logs.readers.arrays import build_array_table
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.readers.hdf5 import read_hdf5

_HDF5 = b"\x89HDF\r\n\x1a\n"  # after a header of 512 bytes


def read_matlab(path: Path, *, time: str) -> LogTable:
    """Open a MATLAB file as a table as long as the vector `time`; raises LogError.

    A matrix ``q`` of N rows or columns (also 1 x n x N, from Simulink) gives ``q1``, ``q2``, ..;
    fields are named as in MATLAB, ``log.t``, ``out.signals(2).values1``.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log file.", code="file.missing", where=path)
    with path.open("rb") as file:
        is_hdf5 = file.read(520)[512:] == _HDF5
    if is_hdf5:
        item = read_hdf5(path, "MATLAB file", transposed=True)
    else:
        (item,) = parse_file(path, "a MATLAB file", "matlab:parse", ["scipy.io"])
    return build_array_table(path, item.arrays, time, item.other_names)


FORMAT = table_format(
    "MATLAB file",
    {".mat"},
    lambda path, log_format: read_matlab(path, time=log_format.columns.time_name),
)
