"""Measured robots whose logs are public but may not ship: from a clone to a study."""

import hashlib
import io
import shutil
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from cosim.study.starter import NewProject, require_new
from hesr_model.errors import ConfigError
from hesr_model.robots.model_file import find_driven_joints
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array
from hesr_model.support.files import models_folder
from hesr_model.support.result_folder import folder_written_whole
from hesr_model.support.text import read_text

_SOURCE = "source.toml"
_GIVEN_MODEL = "robot.urdf"


@dataclass(frozen=True, kw_only=True)
class SourceTable:
    """A file of a source, or the kind of its files, and the columns of logs that it has.

    Attributes
    ----------
    columns : names in the written log, in the order of the file unless it has a header.
    file : in the folder of the source; by default each log names its own.
    header : names of the columns in the file; by default it has no header, and the columns are its
        first ones.
    is_stacked : whether each line has one number, and the columns of a row follow each other.
    decimals : digits that are written.
    """

    columns: tuple[str, ...]
    file: str = ""
    header: tuple[str, ...] = ()
    is_stacked: bool = False
    decimals: int = 6


@dataclass(frozen=True, kw_only=True)
class PublicSource:
    """A public repository with logs of a robot.

    Attributes
    ----------
    name : of the robot, as in `models/public`.
    repository, commit, licence : of the source.
    folder : path of the folder with logs in the repository.
    tables : files with the columns of a log, t [s] first; their rows belong together.
    time_decimals : digits of the time that are written, which starts at 0.
    logs : by written file, its first row and that after the last, the SHA-256 of what is written,
        and its source file if the tables name none.
    model : path of the robot model in the repository; by default the user gives it.
    """

    name: str
    repository: str
    commit: str
    licence: str
    folder: str
    tables: tuple[SourceTable, ...]
    time_decimals: int
    logs: dict[str, dict[str, Any]]
    model: str = ""

    def list_files(self, log: str) -> list[str]:
        """Return the files of a log, relative to the repository."""
        files = [table.file or self.logs[log]["file"] for table in self.tables]
        return [f"{self.folder}/{file}" for file in files]

    @property
    def shipped_files(self) -> Iterator[Path]:
        """Files of the study that ship with HESR."""
        for path in sorted((models_folder() / "public" / self.name).iterdir()):
            if path.name != _SOURCE:
                yield path


def list_sources() -> list[PublicSource]:
    """Return the public repositories that HESR knows."""
    sources = []
    for path in sorted((models_folder() / "public").glob(f"*/{_SOURCE}")):
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        tables = []
        for table in data.pop("tables"):
            columns = tuple(table.pop("columns"))
            header = tuple(table.pop("header", ()))
            tables.append(SourceTable(columns=columns, header=header, **table))
        sources.append(PublicSource(name=path.parent.name, tables=tuple(tables), **data))
    return sources


def start_public(folder: Path, clone: Path, given_model: Path | None = None) -> NewProject:
    """Create a project folder from the clone of a public repository.

    Logs are cut, named and rounded as `docs/data.md` says, and compared with the recorded hashes.
    A model is given if the repository has none.
    """
    require_new(folder)
    source = _find_source(clone)
    model_path = _find_model(source, clone, given_model)
    shipped_robot = models_folder() / "public" / source.name / "robot.toml"
    joints = RobotDescription.read(shipped_robot).joints
    find_driven_joints(model_path, joints)  # refuse the model of another robot
    with folder_written_whole(folder, is_listed=False) as temporary:
        for name, entry in source.logs.items():
            paths = [clone / file for file in source.list_files(name)]
            content = _convert(source, paths, *entry["rows"]).encode()
            if hashlib.sha256(content).hexdigest() != entry["sha256"]:
                raise ConfigError(
                    f"{paths[0]}: differs from commit {source.commit} of {source.repository}; "
                    "check that commit out.",
                    code="public.changed",
                    where=paths[0],
                    key=name,
                )
            (temporary / name).write_bytes(content)
        model_name = _GIVEN_MODEL if given_model else model_path.name
        shutil.copyfile(model_path, temporary / model_name)
        for path in source.shipped_files:
            shutil.copyfile(path, temporary / path.name)
    return NewProject(folder=folder, joints=joints, source=source.repository)


def _find_model(source: PublicSource, clone: Path, given_model: Path | None) -> Path:
    """Return the model of the robot; raises ConfigError if it is missing, or one too many."""
    if source.model and given_model:
        raise ConfigError(
            f"{given_model}: {source.repository} has a model of its own, {source.model}; leave "
            "'robot' out.",
            code="public.model",
            where=given_model,
            key="robot",
        )
    if not source.model and given_model is None:
        raise ConfigError(
            f"{clone}: {source.repository} has no URDF; give that of the robot as 'robot'.",
            code="public.model",
            where=clone,
            key="robot",
        )
    return given_model or clone / source.model


def _find_source(clone: Path) -> PublicSource:
    """Return the repository whose files a folder has."""
    sources = list_sources()
    source = next((source for source in sources if (clone / source.folder).is_dir()), None)
    if source is None:
        known = ", ".join(f"{source.repository} ({source.name})" for source in sources)
        raise ConfigError(
            f"{clone}: is not a clone of a repository that HESR knows: {known}.",
            code="public.unknown",
            where=clone,
            key="public",
        )
    files = []
    if source.model:
        files.append(source.model)
    for log in source.logs:
        files += source.list_files(log)
    for name in files:
        path = clone / name
        if not path.is_file():
            raise ConfigError(
                f"{path}: is missing; check out commit {source.commit} of {source.repository}.",
                code="public.missing",
                where=path,
                key="public",
            )
    return source


def _convert(source: PublicSource, paths: Sequence[Path], first_row: int, end_row: int) -> str:
    """Return rows of files as one log whose time starts at 0."""
    names: list[str] = []
    formats: list[str] = []
    columns: list[Array] = []
    for path, table in zip(paths, source.tables, strict=True):
        names += table.columns
        formats += [f"%.{table.decimals}f"] * len(table.columns)
        columns.append(_read_rows(path, table, first_row, end_row))
    formats[0] = f"%.{source.time_decimals}f"
    rows = np.hstack(columns)
    rows[:, 0] -= rows[0, 0]
    file = io.StringIO()
    np.savetxt(file, rows, fmt=formats, delimiter=",", header=",".join(names), comments="")
    return file.getvalue()


def _read_rows(path: Path, table: SourceTable, first_row: int, end_row: int) -> Array:
    """Return rows of a file (N, columns); raises ConfigError for another file."""
    width = len(table.columns)
    try:
        lines = read_text(path).splitlines()
        places = list(range(width))
        if table.header:
            names = lines.pop(0).split(",")
            places = [names.index(name) for name in table.header]
        if table.is_stacked:
            numbers = np.array(lines[first_row * width : end_row * width], dtype=float)
            return numbers.reshape(end_row - first_row, width)
        select_cells = itemgetter(*places)
        rows = [select_cells(line.split(",")) for line in lines[first_row:end_row]]
        return np.array(rows, dtype=float).reshape(end_row - first_row, width)
    except (IndexError, ValueError) as error:
        raise ConfigError(
            f"{path}: has no numbers in rows {first_row} to {end_row}; it is another file.",
            code="public.changed",
            where=path,
            key="rows",
        ) from error
