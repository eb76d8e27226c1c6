"""HDF5 files, also those of MATLAB 7.3; needs h5py."""

from dataclasses import replace
from pathlib import Path

from hesr_model.errors import LogError
from hesr_model.logs.column_names import is_unit
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.parsed_file import ParsedItem, has_module, parse_file
from hesr_model.logs.readers.arrays import build_array_table
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.tables import require_content
from hesr_model.support.extras import install_command


def read_hdf5(path: Path, kind: str, *, transposed: bool = False) -> ParsedItem:
    """Return the arrays of numbers by path with dots; raises LogError that names the `kind`."""
    if not has_module("h5py"):
        raise LogError(
            f"{path}: {kind}s need h5py: {install_command('formats')}.",
            code="log.package",
            where=path,
        )
    (item,) = parse_file(
        path, f"a {kind}", "hdf5:parse", ["h5py"], {"kind": kind, "transposed": transposed}
    )
    return item


def _read(path: Path, log_format: LogFormat) -> LogTable:
    require_content(path)
    item = read_hdf5(path, "HDF5 file")
    table = build_array_table(path, item.arrays, log_format.columns.time_name, item.other_names)
    units: dict[str, str] = {}
    for name, unit in item.names:
        columns = [column for column in table.names if _is_column_of(column, name)]
        if is_unit(unit):
            units |= dict.fromkeys(columns, unit)
    return replace(table, units=units)


def _is_column_of(column: str, name: str) -> bool:
    """Return whether a column is an array, or one of the columns of it."""
    number = column.removeprefix(name)
    return column.startswith(name) and (not number or number.isdigit())


FORMAT = table_format("HDF5 file", {".h5", ".hdf5", ".hdf"}, _read)
