"""Measured robots whose logs are public but may not ship: from a clone to a study."""

import hashlib
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.study.starter import NewProject, require_new
from hesr_model.errors import ConfigError
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.files import models_folder
from hesr_model.support.result_folder import folder_written_whole
from hesr_model.support.text import read_text

_SOURCE = "source.toml"
_TIME_DECIMALS = 3
_DECIMALS = 6


@dataclass(frozen=True, kw_only=True)
class PublicSource:
    """A public repository with logs of a robot.

    Attributes
    ----------
    name : of the robot, as in `models/public`.
    repository, commit, licence : of the source.
    model : path of the robot model in the repository.
    folder : path of the folder with logs in the repository.
    columns : names of the first columns of its files, which have no header; t [s] first.
    logs : by written file, the source file, its first row and that after the last, and the
        SHA-256 of what is written.
    """

    name: str
    repository: str
    commit: str
    licence: str
    model: str
    folder: str
    columns: tuple[str, ...]
    logs: dict[str, dict[str, Any]]

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
        data["columns"] = tuple(data["columns"])
        sources.append(PublicSource(name=path.parent.name, **data))
    return sources


def start_public(folder: Path, clone: Path) -> NewProject:
    """Create a project folder from the clone of a public repository.

    Logs are cut, named and rounded as `docs/data.md` says, and compared with the recorded hashes.
    """
    require_new(folder)
    source = _find_source(clone)
    with folder_written_whole(folder, is_listed=False) as temporary:
        for name, entry in source.logs.items():
            path = clone / source.folder / entry["file"]
            text = _convert(path, source.columns, *entry["rows"])
            content = text.encode()
            if hashlib.sha256(content).hexdigest() != entry["sha256"]:
                raise ConfigError(
                    f"{path}: differs from commit {source.commit} of {source.repository}; check "
                    "that commit out.",
                    code="public.changed",
                    where=path,
                    key=name,
                )
            (temporary / name).write_bytes(content)
        model_path = clone / source.model
        shutil.copyfile(model_path, temporary / model_path.name)
        for path in source.shipped_files:
            shutil.copyfile(path, temporary / path.name)
        joints = RobotDescription.read(temporary / "robot.toml").joints
    return NewProject(folder=folder, joints=joints, source=source.repository)


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
    log_files = [f"{source.folder}/{entry['file']}" for entry in source.logs.values()]
    for name in (source.model, *log_files):
        path = clone / name
        if not path.is_file():
            raise ConfigError(
                f"{path}: is missing; check out commit {source.commit} of {source.repository}.",
                code="public.missing",
                where=path,
                key="public",
            )
    return source


def _convert(path: Path, columns: tuple[str, ...], first_row: int, end_row: int) -> str:
    """Return rows of a CSV without a header as a log whose time starts at 0."""
    try:
        lines = read_text(path).splitlines()[first_row:end_row]
        rows = [line.split(",")[: len(columns)] for line in lines]
        start = float(rows[0][0])
        texts = [",".join(columns)]
        for row in rows:
            values = [f"{float(row[0]) - start:.{_TIME_DECIMALS}f}"]
            values += [f"{float(cell):.{_DECIMALS}f}" for cell in row[1:]]
            texts.append(",".join(values))
    except (IndexError, ValueError) as error:
        raise ConfigError(
            f"{path}: has no numbers in rows {first_row} to {end_row}; it is another file.",
            code="public.changed",
            where=path,
            key="rows",
        ) from error
    return "\n".join(texts) + "\n"
