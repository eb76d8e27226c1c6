"""Files: found where the package is installed, hashed, and written whole or not at all."""

import errno
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hesr_model import interrupts
from hesr_model.errors import ArtifactError


def models_folder() -> Path:
    """Folder of the shipped robots and studies, in a checkout, an editable install and a wheel."""
    installed = Path(__file__).parent / "_models"
    return installed if installed.is_dir() else Path(__file__).parents[1] / "models"


def sha256(path: Path) -> str:
    """Hex SHA-256 of a file's bytes; of a folder, of the names and hashes of its files."""
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        lines = [f"{sha256(file)}  {file.relative_to(path).as_posix()}\n" for file in files]
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    return hashlib.sha256(path.read_bytes()).hexdigest()


@contextmanager
def folder_written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary folder whose files move into `path` when the block succeeds.

    Files of the same name are replaced, others that stand in `path` are left alone. On any
    exception nothing at `path` has changed.

    Raises
    ------
    ArtifactError
        If the folder cannot be created or written; found out before the block runs.
    """
    try:
        existing = next(p for p in (path, *path.parents) if p.exists())
        temporary = Path(tempfile.mkdtemp(dir=existing, prefix=".hesr-"))
    except OSError as error:
        raise _unwritable(path, error) from error
    try:
        yield temporary
        with interrupts.put_off():  # half of the files would fit nothing
            _move(temporary, path)
    finally:
        with interrupts.put_off():
            shutil.rmtree(temporary)


def _move(temporary: Path, path: Path) -> None:
    for file in sorted(p for p in temporary.rglob("*") if p.is_file()):
        target = path / file.relative_to(temporary)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
        except OSError as error:
            raise _unwritable(target, error) from error


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that becomes `path` when the block succeeds.

    On any exception, an interrupt included, the temporary file is removed and a file that stood
    at `path` stays as it was.

    Raises
    ------
    ArtifactError
        If the folder cannot be created or written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix
        )
        os.close(handle)
    except OSError as error:
        raise _unwritable(path, error) from error
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes files private; a result has the mode that any new file would have.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> ArtifactError:
    return ArtifactError(f"{path}: cannot be written there ({error.strerror}).")
