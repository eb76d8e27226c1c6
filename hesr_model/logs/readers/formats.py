"""The formats of log files there are: those of HESR, then those of other packages.

A package of anybody brings a format by an entry point of the group `hesr.logs`, whose value is a
`FileFormat` (see `docs/add-a-log-format.md`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from hesr_model.errors import ConfigError
from hesr_model.logs.readers.bag import is_bag, read_bag
from hesr_model.logs.readers.columns import read_columns
from hesr_model.logs.readers.samples import Samples
from hesr_model.robots.robot import RobotDescription

GROUP = "hesr.logs"
"""Group of the entry points by which other packages bring formats."""


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A kind of log file.

    Attributes
    ----------
    name : what messages call it.
    recognises : whether a path is a file of this kind.
    read : samples of a file, columns and units as the robot's description says.
    """

    name: str
    recognises: Callable[[Path], bool]
    read: Callable[[Path, RobotDescription], Samples]


BAG = FileFormat(name="ROS bag", recognises=is_bag, read=read_bag)
COLUMNS = FileFormat(name="table", recognises=lambda _: True, read=read_columns)
"""CSV, Parquet and MATLAB: whatever no other format recognises."""


@cache
def formats() -> tuple[FileFormat, ...]:
    """Return all formats in the order in which they are tried; those of other packages first.

    Raises
    ------
    ConfigError
        If the format of another package cannot be loaded.
    """
    others = []
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            found = entry.load()
        except Exception as error:  # whatever the module of somebody else may raise
            raise ConfigError(
                f"log format '{entry.name}' cannot be loaded ({type(error).__name__}: {error}); "
                "mend its package or uninstall it."
            ) from error
        if not isinstance(found, FileFormat):
            raise ConfigError(
                f"log format '{entry.name}' is a {type(found).__name__}; the entry point must name "
                "a FileFormat."
            )
        others.append(found)
    return (*others, BAG, COLUMNS)


def format_of(path: Path) -> FileFormat:
    """Return the first format that recognises a path."""
    return next(each for each in formats() if each.recognises(path))
