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
from hesr_model.logs.readers.formats import COLUMNS, format_of
from hesr_model.support.text import quoted
from hesr_model.support.typed_files import Config, RelativePath

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]

_TABLES = {".csv", ".gz", ".parquet", ".pq", ".feather"}
_BAG = "metadata.yaml"  # marks a folder as a ROS 2 bag
_WILD = re.compile(r"[*?\[]")
_DAY = re.compile(r"(?<!\d)(\d{4})-?(\d\d)-?(\d\d)(?!\d)")


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
    kind: RobotType
    logs: tuple[tuple[str, Path], ...]

    @property
    def days(self) -> dict[str, float]:
        """Days since the first log; indices unless all names hold a date."""
        found = [_day(name) for name, _ in self.logs]
        dated = [day for day in found if day is not None]
        first = min(dated, default=0)
        places = range(len(found)) if len(dated) < len(found) else (day - first for day in dated)
        return {name: float(at) for (name, _), at in zip(self.logs, places, strict=True)}


def members(study: FleetStudy, path: Path) -> list[Member]:
    """Find the robots of a fleet and their logs."""
    found: dict[str, Member] = {}
    for type_, kind in study.types.items():
        logs: dict[str, dict[str, Path]] = {}
        for root, folder in _matching(path, type_, kind.logs):
            files = logs.setdefault(folder.name.rpartition("=")[2], {})
            files |= {f.relative_to(root).with_suffix("").as_posix(): f for f in _logs_in(folder)}
        if not logs:
            raise ConfigError(
                f"{path}: type '{type_}': no folder matches '{kind.logs}'.",
                code="fleet.no_folder",
                where=path,
                key=f"types.{type_}.logs",
            )
        for name, files in logs.items():
            if name in found:
                raise ConfigError(
                    f"{path}: robot '{name}' has the types '{found[name].type}' and '{type_}'; "
                    "give each robot one type.",
                    code="fleet.two_types",
                    where=path,
                    key=f"types.{type_}.logs",
                )
            own = tuple(sorted(files.items()))
            found[name] = Member(name=name, type=type_, kind=kind, logs=own)
    return [found[name] for name in sorted(found)]


def _matching(path: Path, type_: str, pattern: str) -> list[tuple[Path, Path]]:
    parts = Path(pattern).parts
    wild = next((k for k, part in enumerate(parts) if _WILD.search(part)), len(parts) - 1)
    root = path.parent.joinpath(*parts[:wild])
    try:
        return [(root, f) for f in sorted(root.glob("/".join(parts[wild:]))) if f.is_dir()]
    except (OSError, ValueError, NotImplementedError) as error:  # names that no folder can have
        raise ConfigError(
            f"{path}: type '{type_}': {quoted(pattern)} is not a valid pattern of folders.",
            code="fleet.pattern",
            where=path,
            key=f"types.{type_}.logs",
        ) from error


def _logs_in(folder: Path, above: tuple[Path, ...] = ()) -> list[Path]:
    found: list[Path] = []
    own = Path(os.path.realpath(folder))
    if any(other.is_relative_to(own) for other in above):  # its logs would count repeatedly
        raise ConfigError(
            f"{folder}: links to a folder that contains it; remove the link.",
            code="fleet.link",
            where=folder,
        )
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith((".", "_")):
            continue
        if entry.is_dir() and not (entry / _BAG).exists():
            found += _logs_in(entry, (*above, own))
        elif entry.is_dir() or entry.suffix.lower() in _TABLES or format_of(entry) != COLUMNS:
            found.append(entry)
    return found


def _day(name: str) -> int | None:
    for match in _DAY.finditer(name):
        try:
            return date(*map(int, match.groups())).toordinal()
        except ValueError:
            continue
    return None
