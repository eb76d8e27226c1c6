"""Formats of log files, also of other packages (see `docs/add-a-log-format.md`)."""

import math
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import ConfigError, LogError
from hesr_model.logs.column_names import read_unit
from hesr_model.logs.log_format import OPTIONAL, Columns, LogFormat, column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.readers.bag import is_bag, read_bag
from hesr_model.logs.readers.samples import LogSamples
from hesr_model.logs.tables import read_table, table_pieces
from hesr_model.robots.robot import RobotDescription
from hesr_model.support import plugins
from hesr_model.support.arrays import Array
from hesr_model.support.text import format_settings
from hesr_model.units import LOG_UNITS, find_si_factor

GROUP = "hesr.logs"
_UNIT_KEYS = {
    "t": "t",
    "q": "q",
    "dq": "dq",
    "tau": "tau",
    "current": "current",
    "q_link": "q_link",
}
_UNIT_KEYS |= {"q_cmd": "q", "dq_cmd": "dq", "current_size": "current"}
_UNIT_KEYS |= {"temperature": "temperature"}
_MIN_COMMON_SHARE = 0.5  # of rows with numbers of two columns; fewer are rows of several topics


def read_samples(table: LogTable, description: RobotDescription) -> LogSamples:
    """Read the columns of the robot file; errors as `Log.read`."""
    try:
        return _read_columns(table, description)
    except LogError as error:
        if error.code == "log.finite" and not description.log.allows_missing:
            _require_common_rows(table, description)
        raise


def _require_common_rows(table: LogTable, description: RobotDescription) -> None:
    """Raise LogError if columns have numbers in different rows, as those of several topics."""
    log_format = description.log.model_copy(update={"missing": "drop"})
    _read_columns(table, description.model_copy(update={"log": log_format}))
    names = sorted(table.used - {description.log.columns.time_name}, key=table.names.index)
    is_known = np.isfinite(table.numbers(names, missing=True))
    counts = is_known.sum(axis=0)
    slowest = int(np.argmin(counts))
    common_counts = is_known[is_known[:, slowest]].sum(axis=0)
    other = int(np.argmin(common_counts))
    if common_counts[other] < _MIN_COMMON_SHARE * counts[slowest]:
        raise LogError(
            f"{table.path}: columns '{names[slowest]}' and '{names[other]}' have {counts[slowest]} "
            f"and {counts[other]} numbers, {common_counts[other]} of them in the same rows; [log] "
            "missing = 'interpolate' interpolates between them.",
            code="log.staggered",
            where=table.path,
            key=names[other],
        )


def _read_columns(table: LogTable, description: RobotDescription) -> LogSamples:
    log_format = description.log
    columns = description.log.columns
    allows_missing = log_format.allows_missing
    if log_format.rate and columns.time_name not in table.names:
        t = (table.rows_before + np.arange(table.rows)) / log_format.rate
        time = f"rate {log_format.rate:g} Hz"
    else:
        t = table.times(
            columns.t, float(log_format.units.factors("t", 1)[0]), missing=allows_missing
        )
        time = f"column '{columns.time_name}'"
    q = _read_named(table, columns.q, description)
    dq = _read_named(table, columns.dq, description)
    effort, is_current = _read_effort(table, description)
    optional: dict[str, Any] = {
        quantity: _read_optional(table, quantity, description) for quantity in OPTIONAL
    }
    for name in table.units:
        if name in table.used:
            _require_unit_of_cells(table, name, description)
    return LogSamples(
        t=t,
        q=q,
        dq=dq,
        effort=effort,
        is_current=is_current,
        time=time,
        place=lambda k: f"row {table.row(k)}",
        q_link=_read_named(table, columns.q_link, description),
        current_size=_read_named(table, columns.current_size, description),
        left_over=tuple(
            name for name in (*table.names, *table.other_names) if name not in table.used
        ),
        left_out=table.left_out,
        **optional,
    )


def _require_unit_of_cells(table: LogTable, name: str, description: RobotDescription) -> None:
    """Raise LogError if the robot file has another unit for a column than its cells."""
    cell_quantity, cell_unit = read_unit(f"[{table.units[name]}]") or ("", "")
    for quantity, unit_key in _UNIT_KEYS.items():
        columns = getattr(description.log.columns, quantity)
        names = column_names(columns, description.joints)
        is_pair = quantity == "t" and not isinstance(columns, str)  # with units in their names
        if name not in names or is_pair:
            continue
        key = f"log.units.{unit_key}"
        remedy = f"'log.columns.{quantity}' needs another column"
        if cell_quantity == unit_key.removesuffix("_link"):
            units = description.log.units.expand_per_joint(unit_key, len(names))
            if _is_same_unit(unit_key, units[names.index(name)], cell_unit):
                continue
            cell_unit = cell_unit or next(iter(LOG_UNITS.get(unit_key, {"degC": 1.0})))
            remedy = f"{format_settings({key: cell_unit})} says so"
        raise LogError(
            f"{table.path}: the cells of column '{name}' are in '{table.units[name]}', unlike the "
            f"robot file; {remedy}.",
            code="log.unit_of_cells",
            where=table.path,
            key=key,
        )


def _is_same_unit(unit_key: str, stated_unit: str | float, cell_unit: str | float) -> bool:
    """Return whether a unit of a robot file, in any direction, has the size of one of cells."""
    if not isinstance(stated_unit, str):
        return True  # the size may contain a gear as well
    if unit_key == "temperature":
        return stated_unit == (cell_unit or "degC")
    cell_size = find_si_factor(unit_key, cell_unit) if cell_unit else 1.0
    return math.isclose(abs(find_si_factor(unit_key, stated_unit)), cell_size)


def _read_joints(table: LogTable, columns: Columns, description: RobotDescription) -> Array:
    if isinstance(columns, str) and "{name}" not in columns:
        n = len(description.joints)
        # One joint more than the file can have, numbered.
        names = column_names(columns, [""] * (len(table.names) + n + 1))
        existing_names = set(table.names)
        column_count = next(k for k, name in enumerate(names) if name not in existing_names)
        if column_count > n:
            raise LogError(
                f"{table.path}: has column '{names[n]}', but the robot has {n} joints; name the "
                "columns to use under 'log.columns' of the robot file.",
                code="log.more_columns",
                where=table.path,
                key=names[n],
            )
        if 0 < column_count < n and names[n - 1] not in table.names:
            raise LogError(
                f"{table.path}: column '{names[column_count]}' is missing; it has {column_count} "
                f"joints, but the robot has {n}.",
                code="log.column_missing",
                where=table.path,
                key=names[column_count],
            )
    return table.numbers(
        column_names(columns, description.joints), missing=description.log.allows_missing
    )


def _read_named(table: LogTable, columns: Columns, description: RobotDescription) -> Array | None:
    if not columns:
        return None
    return _read_joints(table, columns, description)


def _read_optional(table: LogTable, quantity: str, description: RobotDescription) -> Array | None:
    columns = getattr(description.log.columns, quantity)
    is_default = columns == OPTIONAL[quantity]
    if is_default and not set(column_names(columns, description.joints)) & set(table.names):
        return None
    if not is_default or quantity == "temperature":
        return _read_joints(table, columns, description)
    with suppress(LogError):  # commands that were not asked for must not make a log unreadable
        if np.isfinite(signal := _read_joints(table, columns, description)).all():
            return signal
    return None


def _read_effort(table: LogTable, description: RobotDescription) -> tuple[Array, bool]:
    columns = description.log.columns
    gains = description.log.torque_per_ampere
    if description.log.cylinder is not None:
        names = list(chain.from_iterable(description.log.cylinder.pressures))
        return table.numbers(names, missing=description.log.allows_missing), False
    torque_name = column_names(columns.tau, description.joints)[0]
    current_name = column_names(columns.current, description.joints)[0]
    # Currents without a sign are no torques, though their columns may be named so.
    signed_names = {*table.names} - {*column_names(columns.current_size, description.joints)}
    if gains is not None and current_name in signed_names:
        return _read_joints(table, columns.current, description), True
    if torque_name in signed_names:
        return _read_joints(table, columns.tau, description), False
    if current_name in signed_names:
        raise LogError(
            f"{table.path}: column '{torque_name}' is missing; for the currents in "
            f"'{current_name}' add 'log.torque_per_ampere' to the robot file.",
            code="log.torque_per_ampere",
            where=table.path,
            key="log.torque_per_ampere",
        )
    command_name = column_names(columns.q_cmd, description.joints)[0]
    if command_name in table.names:
        return np.empty((table.rows, 0)), False  # friction follows from commands
    raise LogError(
        f"{table.path}: column '{torque_name}' (torque) or '{current_name}' (current), or instead "
        f"'{command_name}' (commanded position), is missing; it has {table.listing}.",
        code="log.no_torque",
        where=table.path,
        key=torque_name,
    )


Pieces = Callable[[Path, LogFormat, int], Iterator[LogTable]]


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A kind of log file.

    Attributes
    ----------
    name : name in messages.
    recognises : whether a path is a file of this format.
    read : samples of a file, with the columns and units of the robot's
        description.
    table : named columns of a file, which `hesr inspect` can recognise; None
        for other formats.
    pieces : tables of successive rows, of at most the given number; None if
        read as a whole.
    """

    name: str
    recognises: Callable[[Path], bool]
    read: Callable[[Path, RobotDescription], LogSamples]
    table: Callable[[Path, LogFormat], LogTable] | None = None
    pieces: Pieces | None = None


def table_format(
    name: str,
    suffixes: Collection[str],
    table: Callable[[Path, LogFormat], LogTable],
    pieces: Pieces | None = None,
) -> FileFormat:
    """Return the format of tables with named columns in files of some suffixes, or of any."""

    def open_table(path: Path, log_format: LogFormat) -> LogTable:
        renamed_table = table(path, log_format).rename_columns(log_format.columns.names)
        return renamed_table.hide_empty_columns()

    return FileFormat(
        name=name,
        recognises=lambda path: not suffixes or path.suffix.lower() in suffixes,
        read=lambda path, description: read_samples(open_table(path, description.log), description),
        table=open_table,
        pieces=pieces,
    )


BAG = FileFormat(name="ROS bag", recognises=is_bag, read=read_bag)
COLUMNS = table_format(
    "table",
    (),
    lambda path, log_format: read_table(path, log_format.columns.names),
    lambda path, log_format, rows: table_pieces(path, log_format.columns.names, rows),
)  # Fallback for every file: CSV, Parquet and Feather


def read_sample_pieces(
    path: Path, description: RobotDescription, max_rows: int
) -> Iterator[LogSamples]:
    """Yield the samples of successive rows; none of a format that is read as a whole."""
    first_table = None
    rows_before = 0
    open_pieces = find_format(path).pieces
    if open_pieces is None:
        return
    for piece in open_pieces(path, description.log, max_rows):
        table = replace(
            piece.rename_columns(description.log.columns.names),
            first_piece=first_table,
            rows_before=rows_before,
        )
        yield read_samples(table, description)
        first_table = first_table or table
        rows_before += table.rows


@cache
def formats() -> tuple[FileFormat, ...]:
    """Return all formats in order of precedence, other packages first."""
    formats_by_plugin = {plugin: plugin.load() for plugin in plugins.load(GROUP).values()}
    for plugin, file_format in formats_by_plugin.items():
        if not isinstance(file_format, FileFormat):
            raise ConfigError(
                f"{plugin.label} is a {type(file_format).__name__}; the entry point must name a "
                "FileFormat."
            )
    built_in_formats = [
        file_format
        for plugin, file_format in formats_by_plugin.items()
        if plugin.is_built_in and file_format is not COLUMNS
    ]
    return (
        *(
            file_format
            for plugin, file_format in formats_by_plugin.items()
            if not plugin.is_built_in
        ),
        *built_in_formats,
        COLUMNS,
    )


def find_format(path: Path) -> FileFormat:
    """Return the first format that recognises a path."""
    return next(file_format for file_format in formats() if file_format.recognises(path))
