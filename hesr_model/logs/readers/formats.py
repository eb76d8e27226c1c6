"""Formats of log files, also of other packages (see `docs/add-a-log-format.md`)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from hesr_model.errors import ConfigError
from hesr_model.logs.readers.bag import is_bag, read_bag
from hesr_model.logs.readers.columns import read_columns
from hesr_model.logs.readers.samples import LogSamples
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
    """

    name: str
    recognises: Callable[[Path], bool]
    read: Callable[[Path, RobotDescription], LogSamples]


BAG = FileFormat(name="ROS bag", recognises=is_bag, read=read_bag)
COLUMNS = FileFormat(name="table", recognises=lambda _: True, read=read_columns)
"""Fallback for every file: CSV, Parquet and MATLAB."""


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
