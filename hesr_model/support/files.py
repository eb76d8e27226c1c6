"""Files: shipped models, hashes, provenance of results, and atomic writing."""

import errno
import hashlib
import hmac
import logging
import os
import platform
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex
from typing import Any

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.support import file_locks
from hesr_model.support.open_folder import OpenFolder, remove_all, sync_file, sync_folder
from hesr_model.support.progress import deferred

SCRATCH = "hesr-"
HIDDEN = f".{SCRATCH}"  # prefix of HESR's own files and folders next to those of users
FILES = "files"  # folder in a scratch folder, next to its lock
_LOCK = "lock"
_SIGNATURE_LENGTH = 32  # hexadecimal digits
_SCRATCH_NAME = re.compile(
    rf"\.?{SCRATCH}(?P<token>[0-9a-f]{{16}})-(?P<signature>[0-9a-f]{{{_SIGNATURE_LENGTH}}})"
)
_PROBE_SIZE = 1 << 20  # [B] that a folder with room takes
_MAX_ATTEMPTS = 100  # to make a folder that another process removes while it is empty
NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}
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
def room_for(path: Path) -> Iterator[None]:
    """Report a full or broken disk below `path` as ArtifactError.

    An error that names a file of the user is kept: a page may be on another disk than its results.
    """
    try:
        yield
    except (OSError, ArtifactError) as error:
        if isinstance(error, ArtifactError) and error.where and not is_temporary(Path(error.where)):
            raise
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(cause, OSError) and cause.errno in NO_ROOM:
            raise unwritable(path, cause) from cause
        raise


def require_room(*folders: Path) -> None:
    """Raise ArtifactError for the first folder that takes no more data."""
    for folder in folders:
        try:
            with tempfile.TemporaryFile(dir=folder) as file:
                file.write(bytes(_PROBE_SIZE))
                file.flush()
        except OSError as error:
            raise unwritable(folder, error) from error


def find_temporary_folder() -> Path:
    """Return the folder for temporary files; raises ArtifactError."""
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError as error:
        raise ArtifactError(
            "no folder for temporary files can be written; free disk space, or set TMPDIR.",
            code="file.no_temporary",
            key="TMPDIR",
        ) from error


def is_empty(folder: Path) -> bool:
    """Return whether a folder has at most leftovers of a killed run."""
    return all(entry.name.startswith(HIDDEN) for entry in folder.iterdir())


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


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # not empty, or never made
        folder.rmdir()


@contextmanager
def scratch_folder(parent: Path | None = None, prefix: str = SCRATCH) -> Iterator[Path]:
    """Yield a temporary folder; interrupts leave none, and the next process removes those of kills.

    It is within another one, which has a signed name and a locked file: only this user's HESR made
    that name, and its process runs as long as the lock is held. Both hold across containers.
    """
    place = find_temporary_folder() if parent is None else parent
    with ExitStack() as cleanup:
        try:
            with deferred():
                folder = _make_scratch(place, prefix, cleanup)
        except OSError as error:
            if parent is None:
                raise unwritable(place, error) from error
            raise
        yield folder


def is_temporary(path: Path) -> bool:
    """Return whether a path is within a scratch folder."""
    return any(_SCRATCH_NAME.fullmatch(part) for part in path.parts)


def remove_scratch(folder: Path) -> None:
    """Remove a folder of `scratch_folder` whose process has ended."""
    _remove(folder.parent if _SCRATCH_NAME.fullmatch(folder.parent.name) else folder)


def _make_scratch(place: Path, prefix: str, cleanup: ExitStack) -> Path:
    if is_temporary(place):  # it is removed with the folder around it
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
        cleanup.callback(_remove, folder)
        return folder
    sweep_folder(place)
    handle = None
    while handle is None:
        token = token_hex(8)
        scratch = place / f"{prefix}{token}-{_sign_token(token)}"
        scratch.mkdir(mode=0o700)
        handle = _lock_scratch(scratch)
    cleanup.callback(file_locks.remove_locked, handle, _remove, scratch)
    folder = scratch / FILES
    folder.mkdir()
    return folder


def _lock_scratch(scratch: Path) -> int | None:
    """Make and lock the file of a scratch folder; return it, or None if a sweep came first."""
    try:
        handle = os.open(scratch / _LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    except FileNotFoundError:
        return None
    except OSError:
        with suppress(OSError):
            scratch.rmdir()
        raise
    if file_locks.hold(handle) and file_locks.is_linked(handle):
        return handle
    os.close(handle)
    return None


def _sign_token(token: str) -> str:
    from hesr_model.support.cache import key_with_secret

    return key_with_secret("scratch folder", token.encode()).hex()[:_SIGNATURE_LENGTH]


@cache
def sweep_folder(place: Path) -> None:
    """Remove scratch folders of killed processes of this user, once per process."""
    with suppress(OSError), OpenFolder.open(place) as folder:
        for name in folder.names():
            match = _SCRATCH_NAME.fullmatch(name)
            if match and hmac.compare_digest(match["signature"], _sign_token(match["token"])):
                with suppress(OSError):
                    _remove_unowned(folder, name)


def _remove_unowned(folder: OpenFolder, name: str) -> None:
    """Remove a scratch folder if no process holds its lock."""
    with folder.open_folder(name) as scratch:
        if hasattr(os, "getuid") and scratch.status().st_uid != os.getuid():
            return
        if not scratch.has(_LOCK):  # it is being made, or was almost removed
            folder.remove_folder(name)
            return
        handle = scratch.open_file(_LOCK, os.O_RDWR)
    with ExitStack() as cleanup:
        cleanup.callback(os.close, handle)
        if not file_locks.try_lock(handle):
            return
        _log.info("removing %s, left behind by a killed process", folder.path / name)
        cleanup.pop_all()
        file_locks.remove_locked(handle, remove_all, folder, name, _LOCK)


def _remove(path: Path) -> None:
    with deferred(), suppress(OSError), OpenFolder.open(path.parent) as folder:
        remove_all(folder, path.name, last=_LOCK)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path of the same name that becomes `path` when the block succeeds.

    On any exception, also an interrupt, an existing file stays unchanged; after a power failure
    there is the old file or the new one. Raises ArtifactError.
    """
    with room_for(path), ExitStack() as cleanup:
        temporary = _prepare_file(path, cleanup)
        yield temporary
        try:
            _finish_file(temporary, path)
            temporary.replace(path)
            if not is_temporary(path.parent):
                sync_folder(path.parent)
        except OSError as error:
            raise unwritable(path, error) from error


def require_writable(*paths: Path) -> None:
    """Raise ArtifactError for the first file that `written_whole` would refuse.

    Commands call this before their work, which may take minutes.
    """
    for path in paths:
        with room_for(path), ExitStack() as cleanup:
            _prepare_file(path, cleanup)


def find_real_path(path: Path) -> Path:
    """Return an absolute path without links; `Path.resolve` may raise for a link to itself."""
    return Path(os.path.realpath(path))


def refuse_broken_link(path: Path) -> None:
    """Raise ArtifactError if a path or one of its folders is a link to itself or to nothing.

    A file or folder would be made where the link points, out of the user's sight.
    """
    for link in (path, *path.parents):
        if link.is_symlink() and not link.exists():
            place = "" if link == path else f"its folder {link} "
            raise ArtifactError(
                f"{path}: {place}is a link that leads nowhere; remove it, or give another name.",
                code="file.broken_link",
                where=path,
            )


def _prepare_file(path: Path, cleanup: ExitStack) -> Path:
    """Return a temporary path in a scratch folder next to `path`; raises ArtifactError."""
    try:
        refuse_broken_link(path)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if path.exists() and not path.is_file():  # a file would replace it
            raise ArtifactError(
                f"{path}: is a pipe or a device; give the name of a file.",
                code="file.special",
                where=path,
            )
        folder = make_scratch_in(path.parent, cleanup)
        sweep_folder(find_temporary_folder())
        temporary = folder / path.name
        temporary.touch(exist_ok=False)  # refuses names that the file system does not have
    except OSError as error:
        raise unwritable(path, error) from error
    return temporary


def make_scratch_in(place: Path, cleanup: ExitStack) -> Path:
    """Return a hidden scratch folder in a folder that is made if missing; raises OSError.

    Another process may remove its own empty folders meanwhile, so missing ones are made again.
    """
    for attempt in range(_MAX_ATTEMPTS):
        with ExitStack() as made:
            try:
                made.enter_context(folder_made(place))
                folder = made.enter_context(scratch_folder(place, HIDDEN))
            except FileNotFoundError:
                if attempt + 1 == _MAX_ATTEMPTS:
                    raise
                continue
            cleanup.enter_context(made.pop_all())
            return folder
    raise AssertionError("unreachable")


def _finish_file(temporary: Path, path: Path) -> None:
    """Write a complete file to the disk, unless a folder is written whole around it."""
    if not is_temporary(path.parent):
        sync_file(temporary)


@contextmanager
def written_together(main: Path) -> Iterator[Callable[[Path], Path]]:
    """Yield `written_whole` for several paths; on any error all files are the old ones.

    A killed process leaves no new files with an old `main`, which is missing meanwhile.
    """
    with room_for(main), ExitStack() as cleanup:
        temporaries = {main: _prepare_file(main, cleanup)}

        def provide_temporary(path: Path) -> Path:
            if path not in temporaries:
                with room_for(path):
                    temporaries[path] = _prepare_file(path, cleanup)
            return temporaries[path]

        yield provide_temporary
        with deferred():
            for path, temporary in temporaries.items():
                try:
                    _finish_file(temporary, path)
                except OSError as error:
                    raise unwritable(path, error) from error
            _replace_together(main, temporaries)


def _replace_together(main: Path, temporaries: Mapping[Path, Path]) -> None:
    """Replace several files, `main` last; an error puts the old ones back."""
    with ExitStack() as undo:
        path = main
        try:
            for path in temporaries:  # `main` is the first
                old_file = temporaries[path].with_name(token_hex(8))
                if os.path.lexists(path):
                    path.replace(old_file)
                    undo.callback(old_file.replace, path)
                if path != main:
                    temporaries[path].replace(path)
                    undo.callback(path.unlink)
            path = main
            temporaries[main].replace(main)
            undo.pop_all()
            for folder in {path.parent for path in temporaries}:
                if not is_temporary(folder):
                    sync_folder(folder)
        except OSError as error:
            undo.close()
            raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> ArtifactError:
    """Return the error that a file or folder cannot be written."""
    # Libraries add more to the error's own text.
    reason = os.strerror(error.errno) if error.errno else error.strerror
    return ArtifactError(
        f"{path}: cannot be written there ({reason}).", code="file.unwritable", where=path
    )
