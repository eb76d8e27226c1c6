"""Formats of log files, also of other packages (see `docs/add-a-log-format.md`)."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from hesr_model.errors import ConfigError
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.readers.bag import is_bag, read_bag
from hesr_model.logs.readers.columns import samples_of
from hesr_model.logs.readers.samples import LogSamples
from hesr_model.logs.tables import read_table
from hesr_model.robots.robot import RobotDescription
from hesr_model.support import plugins

GROUP = "hesr.logs"


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A kind of log file.

    Attributes
    ----------
    name : name in messages.
    recognises : whether a path is a file of this format.
    read : samples of a file, with the columns and units of the robot's description.
    table : named columns of a file, which `hesr inspect` can recognise; None for other formats.
    """

    name: str
    recognises: Callable[[Path], bool]
    read: Callable[[Path, RobotDescription], LogSamples]
    table: Callable[[Path, LogFormat], LogTable] | None = None


def table_format(
    name: str, suffixes: Collection[str], table: Callable[[Path, LogFormat], LogTable]
) -> FileFormat:
    """Return the format of tables with named columns in files of some suffixes, or of any."""

    def opened(path: Path, log: LogFormat) -> LogTable:
        return table(path, log).named(log.columns.names)

    return FileFormat(
        name=name,
        recognises=lambda path: not suffixes or path.suffix.lower() in suffixes,
        read=lambda path, robot: samples_of(opened(path, robot.log), robot),
        table=opened,
    )


BAG = FileFormat(name="ROS bag", recognises=is_bag, read=read_bag)
COLUMNS = table_format("table", (), lambda path, log: read_table(path, log.columns.names))
"""Fallback for every file: CSV, Parquet and Feather."""


@cache
def formats() -> tuple[FileFormat, ...]:
    """Return all formats in order of precedence, other packages first."""
    found = {plugin: plugin.load() for plugin in plugins.load(GROUP).values()}
    for plugin, value in found.items():
        if not isinstance(value, FileFormat):
            raise ConfigError(
                f"{plugin.label} is a {type(value).__name__}; the entry point must name a "
                "FileFormat."
            )
    ours = [value for plugin, value in found.items() if plugin.own and value is not COLUMNS]
    return (*(value for plugin, value in found.items() if not plugin.own), *ours, COLUMNS)


def format_of(path: Path) -> FileFormat:
    """Return the first format that recognises a path."""
    return next(each for each in formats() if each.recognises(path))
