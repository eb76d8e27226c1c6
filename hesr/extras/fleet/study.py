"""Fleet file: types of robots, their logs, and the laws to fit."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from fmu_src.export.toolchain import DEFAULT_PLATFORMS
from hesr_model.errors import ConfigError
from hesr_model.logs.readers.formats import COLUMNS, find_format
from hesr_model.support.text import quote
from hesr_model.support.typed_files import Config, RelativePath

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]

_TABLE_SUFFIXES = {".csv", ".gz", ".parquet", ".pq", ".feather"}
_BAG_FILE = "metadata.yaml"  # marks a folder as a ROS 2 bag
_WILDCARD = re.compile(r"[*?\[]")
_DATE_PATTERN = re.compile(r"(?<!\d)(\d{4})-?(\d\d)-?(\d\d)(?!\d)")


class RobotType(Config):
    """A type of robots; `logs` matches folders relative to the fleet file (see `docs/fleet.md`)."""

    robot: RelativePath
    logs: str = Field(min_length=1)
    accept: tuple[str, ...] = ()


class FleetStudy(Config):
    """Content of a fleet file."""

    name: Name = "fleet"
    seed: int = Field(default=0, ge=0)
    laws: tuple[str, ...] = Field(default=("lugre",), min_length=1)
    options: Mapping[str, Mapping[str, Any]] = {}
    rows: int = Field(default=20_000, ge=1000, le=10**7)
    level: float = Field(default=0.05, gt=0.0, lt=1.0)  # adjusted significance
    least_change: float = Field(default=0.05, ge=0.0)  # share of friction
    fmu: bool = True  # export FMUs per type
    platforms: tuple[str, ...] = DEFAULT_PLATFORMS
    types: Mapping[Name, RobotType] = Field(min_length=1)


@dataclass(frozen=True, kw_only=True)
class Member:
    """A robot of a fleet, with sorted names and files of its logs."""

    name: str
    type: str
    robot_type: RobotType
    logs: tuple[tuple[str, Path], ...]

    @property
    def days(self) -> dict[str, float]:
        """Days since the first log; indices unless all names hold a date."""
        log_days = [_find_day(name) for name, _ in self.logs]
        dated_days = [day for day in log_days if day is not None]
        if len(dated_days) < len(log_days):
            positions = list(range(len(log_days)))
        else:
            first_day = min(dated_days, default=0)
            positions = [day - first_day for day in dated_days]
        return {
            name: float(position) for (name, _), position in zip(self.logs, positions, strict=True)
        }


def find_members(study: FleetStudy, path: Path) -> list[Member]:
    """Find the robots of a fleet and their logs."""
    members_by_name: dict[str, Member] = {}
    for type_name, robot_type in study.types.items():
        logs: dict[str, dict[str, Path]] = {}
        for root, folder in _match_folders(path, type_name, robot_type.logs):
            files = logs.setdefault(folder.name.rpartition("=")[2], {})
            files |= {
                file.relative_to(root).with_suffix("").as_posix(): file
                for file in _find_logs(folder)
            }
        if not logs:
            raise ConfigError(
                f"{path}: type '{type_name}': no folder matches '{robot_type.logs}'.",
                code="fleet.no_folder",
                where=path,
                key=f"types.{type_name}.logs",
            )
        for robot_name, files in logs.items():
            if robot_name in members_by_name:
                raise ConfigError(
                    f"{path}: robot '{robot_name}' has the types "
                    f"'{members_by_name[robot_name].type}' and '{type_name}'; give each robot one "
                    "type.",
                    code="fleet.two_types",
                    where=path,
                    key=f"types.{type_name}.logs",
                )
            sorted_logs = tuple(sorted(files.items()))
            members_by_name[robot_name] = Member(
                name=robot_name, type=type_name, robot_type=robot_type, logs=sorted_logs
            )
    return [members_by_name[robot_name] for robot_name in sorted(members_by_name)]


def _match_folders(path: Path, type_: str, pattern: str) -> list[tuple[Path, Path]]:
    parts = Path(pattern).parts
    first_wild = next(
        (index for index, part in enumerate(parts) if _WILDCARD.search(part)), len(parts) - 1
    )
    root = path.parent.joinpath(*parts[:first_wild])
    try:
        return [
            (root, folder)
            for folder in sorted(root.glob("/".join(parts[first_wild:])))
            if folder.is_dir()
        ]
    except (OSError, ValueError, NotImplementedError) as error:  # names that no folder can have
        raise ConfigError(
            f"{path}: type '{type_}': {quote(pattern)} is not a valid pattern of folders.",
            code="fleet.pattern",
            where=path,
            key=f"types.{type_}.logs",
        ) from error


def _find_logs(folder: Path, parent_folders: tuple[Path, ...] = ()) -> list[Path]:
    logs: list[Path] = []
    real_folder = Path(os.path.realpath(folder))
    # The logs of a folder that contains itself would count repeatedly.
    if any(parent_folder.is_relative_to(real_folder) for parent_folder in parent_folders):
        raise ConfigError(
            f"{folder}: links to a folder that contains it; remove the link.",
            code="fleet.link",
            where=folder,
        )
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith((".", "_")):
            continue
        if entry.is_dir() and not (entry / _BAG_FILE).exists():
            logs += _find_logs(entry, (*parent_folders, real_folder))
        elif (
            entry.is_dir()
            or entry.suffix.lower() in _TABLE_SUFFIXES
            or find_format(entry) != COLUMNS
        ):
            logs.append(entry)
    return logs


def _find_day(name: str) -> int | None:
    for match in _DATE_PATTERN.finditer(name):
        try:
            return date(*map(int, match.groups())).toordinal()
        except ValueError:
            continue
    return None
