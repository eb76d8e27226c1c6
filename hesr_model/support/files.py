"""Files: shipped models, hashes, provenance of results, and atomic writing."""

import errno
import hashlib
import logging
import os
import platform
import re
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex
from typing import Any

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.support.progress import deferred

_TEMPORARY = ".hesr-"
_LOCK = f"{_TEMPORARY}lock"
_COMPLETE = f"{_TEMPORARY}whole"  # folder of a complete result, which is moved into place
_MACHINE = f"{zlib.crc32(platform.node().encode()) & 0xFFFF:04x}"
_OF_A_PROCESS = re.compile(rf"(\..+\.|hesr-){_MACHINE}-(\d+)-\w{{8}}(\.\w+|-\w{{16}})?")
"""Temporary names, with machine and process, and those of parts during removal."""
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}
"""Errors of the writer; others may come from files that the block reads."""
PathArg = str | os.PathLike[str]
_log = logging.getLogger(__name__)
_VERSIONED_PACKAGES = ("hesr", "numpy", "scipy", "sympy", "pin")


def provenance(*, files: Sequence[Path], seed: int | None = None, **entries: Any) -> dict[str, Any]:
    """Return the provenance of a result as JSON data."""
    return {
        "files": [{"name": file.name, "sha256": sha256(file)} for file in files],
        "seed": seed,
        "versions": {
            "python": platform.python_version(),
            **{p: version(p) for p in _VERSIONED_PACKAGES},
        },
        **entries,
    }


def newest(files: Sequence[Path]) -> str:
    """Return the modification time of the newest file, ISO 8601 in UTC."""
    seconds = max(int(file.stat().st_mtime) for file in files)
    return datetime.fromtimestamp(seconds, tz=UTC).isoformat()


def to_path(value: object, subject: str) -> Path:
    """Return a path from text or a path, or raise ConfigError about `subject`."""
    if isinstance(value, str | os.PathLike):
        return Path(value)
    raise ConfigError(
        f"{subject} is given as {type(value).__name__}; expected a path, as text or as a Path."
    )


def models_folder() -> Path:
    """Return the folder of the shipped robots and studies."""
    installed = Path(__file__).parents[1] / "_models"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "models"


def sha256(path: Path) -> str:
    """Return the hex SHA-256 of a file, or of a folder's names and hashes."""
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        lines = [f"{sha256(file)}  {file.relative_to(path).as_posix()}\n" for file in files]
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    if path.exists() and not path.is_file():  # may have no end
        raise OSError(errno.EINVAL, "it is a pipe or a device", str(path))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def folder_written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary folder whose files move into `path` when the block succeeds.

    On any exception nothing at `path` changes; a killed process leaves all files or none to
    `settle`. Raises ArtifactError before the block if another run is writing into the folder or it
    cannot be written.
    """
    with _room_for(path), ExitStack() as cleanup:
        try:
            cleanup.enter_context(folder_made(path))
        except OSError as error:
            raise _unwritable(path, error) from error
        _take_folder(path, cleanup)
        temporary = cleanup.enter_context(scratch_folder(path, _TEMPORARY))
        yield temporary
        with deferred():
            for file in temporary.rglob("*"):
                target = path / file.relative_to(temporary)
                if target.exists() and target.is_dir() != file.is_dir():
                    code = errno.EISDIR if target.is_dir() else errno.ENOTDIR
                    raise _unwritable(target, OSError(code, os.strerror(code)))
            temporary.rename(path / _COMPLETE)  # from here on all files, even if killed
            _move_into_place(path)


def settle(path: Path) -> None:
    """Complete or remove what a killed run has left in a folder, unless a run is writing there."""
    with ExitStack() as cleanup, suppress(ArtifactError, OSError):
        if any(path.glob(f"{_TEMPORARY}*")):
            _take_folder(path, cleanup)


@contextmanager
def _room_for(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, ArtifactError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(cause, OSError) and cause.errno in _NO_ROOM:
            raise _unwritable(path, cause) from cause
        raise


def is_empty(folder: Path) -> bool:
    """Return whether a folder has at most leftovers of a killed run."""
    return all(entry.name.startswith(_TEMPORARY) for entry in folder.iterdir())


@contextmanager
def folder_made(path: Path) -> Iterator[None]:
    """Make a folder and its parents; empty new ones are removed."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    with ExitStack() as cleanup:
        for folder in reversed(missing):
            cleanup.callback(_remove_empty, folder)
            folder.mkdir(exist_ok=True)
        if not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        yield


def _take_folder(path: Path, cleanup: ExitStack) -> None:
    from filelock import FileLock, Timeout  # slow to import

    lock = FileLock(path / _LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise ArtifactError(
            f"{path}: another run is writing here; wait for it, or give another folder."
        ) from error
    except OSError as error:
        raise _unwritable(path, error) from error
    cleanup.callback(lock.release)
    cleanup.callback((path / _LOCK).unlink, missing_ok=True)
    _move_into_place(path)
    for leftover in path.glob(f"{_TEMPORARY}*/"):
        _log.info("removing %s, left behind by a killed run", leftover)
        shutil.rmtree(leftover, ignore_errors=True)
    for folder in (path, *path.glob("*/")):
        _sweep_folder(folder)


@cache
def _sweep_folder(folder: Path) -> None:
    """Remove temporary files and folders of killed processes, once per process."""
    import psutil  # slow to import

    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = _OF_A_PROCESS.fullmatch(entry.name)
            if not match or psutil.pid_exists(int(match[2])):
                continue
            with suppress(OSError):
                owner = entry.stat(follow_symlinks=False).st_uid
                if hasattr(os, "getuid") and owner != os.getuid():
                    continue
                if entry.is_dir(follow_symlinks=False):
                    _remove_whatever(Path(entry.path))
                else:
                    Path(entry.path).unlink()


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # not empty, or never made
        folder.rmdir()


def _move_into_place(path: Path) -> None:
    """Move all files of a complete result into place; may be repeated."""
    complete_folder = path / _COMPLETE
    for file in sorted(p for p in complete_folder.rglob("*") if p.is_file()):
        target = path / file.relative_to(complete_folder)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
        except OSError as error:
            raise _unwritable(target, error) from error
    if complete_folder.is_dir():
        _remove_whatever(complete_folder)


@contextmanager
def scratch_folder(parent: Path | None = None, prefix: str = "hesr-") -> Iterator[Path]:
    """Yield a temporary folder; interrupts leave none."""
    with ExitStack() as cleanup:
        with deferred():
            if parent is None:
                _sweep_folder(Path(tempfile.gettempdir()))
            name_prefix = f"{prefix}{_MACHINE}-{os.getpid()}-"
            folder = Path(tempfile.mkdtemp(prefix=name_prefix, dir=parent))
            cleanup.callback(_remove_folder, folder)
        yield folder


def _remove_folder(folder: Path) -> None:
    with deferred(), suppress(OSError):
        _remove_whatever(folder)


def _remove_whatever(folder: Path) -> None:
    """Remove a folder of any depth: `shutil.rmtree` recurses once per level."""
    pending_folders = [folder]
    while pending_folders:
        path = pending_folders.pop()
        path.chmod(0o700)
        with os.scandir(path) as entries:
            folder_entries = list(entries)
        for entry in folder_entries:
            if entry.is_dir(follow_symlinks=False):
                sibling = folder.with_name(f"{folder.name}-{token_hex(8)}")
                pending_folders.append(Path(entry.path).rename(sibling))
            else:
                Path(entry.path).unlink()
        path.rmdir()


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that becomes `path` when the block succeeds.

    On any exception, also an interrupt, an existing file stays unchanged. Raises ArtifactError.
    """
    with _room_for(path), ExitStack() as cleanup:
        try:
            cleanup.enter_context(folder_made(path.parent))
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            if path.exists() and not path.is_file():  # a file would replace it
                raise ArtifactError(f"{path}: is a pipe or a device; give the name of a file.")
            _sweep_folder(path.parent)
            _sweep_folder(Path(tempfile.gettempdir()))
            with deferred():
                name_prefix = f".{path.name}.{_MACHINE}-{os.getpid()}-"
                handle, name = tempfile.mkstemp(
                    dir=path.parent, prefix=name_prefix, suffix=path.suffix
                )
                temporary = Path(name)
                cleanup.callback(temporary.unlink, missing_ok=True)
            os.close(handle)
        except OSError as error:
            raise _unwritable(path, error) from error
        yield temporary
        # mkstemp makes files private, unlike results.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)


@contextmanager
def written_together(main: Path) -> Iterator[Callable[[Path], Path]]:
    """Yield `written_whole` for several paths; a killed process leaves no new files with `main`."""
    with ExitStack() as cleanup:
        temporaries = {main: cleanup.enter_context(written_whole(main))}

        def temporary(path: Path) -> Path:
            if path not in temporaries:
                temporaries[path] = cleanup.enter_context(written_whole(path))
            return temporaries[path]

        yield temporary
        with deferred():
            main.unlink(missing_ok=True)
            cleanup.close()


def _unwritable(path: Path, error: OSError) -> ArtifactError:
    # Libraries add more to the error's own text.
    reason = os.strerror(error.errno) if error.errno else error.strerror
    return ArtifactError(f"{path}: cannot be written there ({reason}).")
