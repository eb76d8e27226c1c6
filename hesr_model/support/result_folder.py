"""Result folders, which are replaced whole by one exchange of names.

A run writes a new folder next to the result and exchanges both. Files that HESR did not write stay:
each result lists its files, signed with the user's key.
"""

import errno
import hmac
import json
import logging
import os
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from hesr_model.errors import ArtifactError
from hesr_model.support import file_locks
from hesr_model.support.files import (
    HIDDEN,
    find_real_path,
    is_temporary,
    make_scratch_in,
    refuse_broken_link,
    room_for,
    unwritable,
)
from hesr_model.support.open_folder import OpenFolder, exchange, sync_all, walk
from hesr_model.support.progress import deferred

LIST = f"{HIDDEN}files"  # signed list of the files of a result
_EARLIER = f"{HIDDEN}earlier"  # suffix of an old result between two renames
_LOCK = f"{HIDDEN}lock-"  # prefix of the lock of a result
_MAX_LIST_SIZE = 64 << 20  # [B]
_MAX_BACKUPS = 1000
_MOUNTS = Path("/proc/self/mountinfo")
_Selection = Callable[[OpenFolder, str, str], bool]  # of a file by folder, path and name
_log = logging.getLogger(__name__)


@contextmanager
def folder_written_whole(path: Path, *, is_listed: bool = True) -> Iterator[Path]:
    """Yield a new folder that replaces `path` when the block succeeds.

    Files of an earlier result go, those of the user stay. An earlier result without the signature
    of this user is kept as ``path.~1~``. Unless `is_listed`, the files become the user's.

    On any exception nothing at `path` changes. Where the system can exchange two folders, a kill or
    a power failure leaves the old or the new one as well. Raises ArtifactError before the block if
    another run is writing into the folder or it cannot be written.
    """
    with _new_folder(path) as new:
        yield new.path
        with deferred():
            new.replace(is_listed=is_listed)


@contextmanager
def folder_updated_whole(path: Path) -> Iterator[Path]:
    """Yield a folder whose files replace those of the same name in `path`; others stay.

    Errors are those of `folder_written_whole`.
    """
    with _new_folder(path) as new:
        yield new.path
        with deferred():
            new.update()


def describe_leftover(path: Path) -> str:
    """Return a sentence about an old result that a killed run has left next to `path`, or ''."""
    leftover = path.with_name(f".{path.name}{_EARLIER}")
    if not os.path.lexists(leftover):
        return ""
    return (
        f"a run was killed while it replaced {path}; its earlier result is in {leftover}, which "
        "you can rename"
    )


@contextmanager
def _new_folder(path: Path) -> Iterator["_NewFolder"]:
    with room_for(path), ExitStack() as cleanup:
        refuse_broken_link(path)
        target = find_real_path(path)
        _require_replaceable(path, target)
        try:
            scratch = make_scratch_in(target.parent, cleanup)
            (scratch / target.name).mkdir()
            parent = cleanup.enter_context(OpenFolder.open(target.parent))
            if not is_temporary(target.parent):
                _lock_name(path, parent, target.name, cleanup)
        except OSError as error:
            raise unwritable(path, error) from error
        leftover = describe_leftover(target)
        if leftover:
            _log.warning("%s.", leftover)
        yield _NewFolder(path, target, scratch / target.name, parent)


def _require_replaceable(path: Path, target: Path) -> None:
    """Refuse what cannot be exchanged; raises ArtifactError."""
    if os.path.lexists(target) and not target.is_dir():
        raise unwritable(path, OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)))
    if target.is_dir() and Path.cwd().is_relative_to(target):
        raise ArtifactError(
            f"{path}: is the current folder or has it inside, which cannot be replaced; give "
            "another folder.",
            code="folder.current",
            where=path,
        )
    if target.is_dir() and not os.access(target, os.W_OK | os.X_OK):
        raise unwritable(path, OSError(errno.EACCES, os.strerror(errno.EACCES)))
    if _is_mount_point(target):
        raise ArtifactError(
            f"{path}: is a mount point, which cannot be replaced; give a folder inside it.",
            code="folder.mount",
            where=path,
        )


def _is_mount_point(target: Path) -> bool:
    if os.path.ismount(target):  # Python 3.11 has no Path.is_mount on Windows
        return True
    try:
        lines = _MOUNTS.read_bytes().splitlines()
    except OSError:
        return False
    name = os.fsencode(target)
    for character in (b"\\", b" ", b"\t", b"\n"):
        name = name.replace(character, b"\\%03o" % ord(character))
    return any(line.split()[4] == name for line in lines)  # bind mounts of the same disk


def _lock_name(path: Path, parent: OpenFolder, name: str, cleanup: ExitStack) -> None:
    """Lock the name of a result in its folder; raises ArtifactError if a run holds it."""
    lock_name = f"{_LOCK}{name}"
    while True:
        handle = parent.open_file(lock_name, os.O_RDWR | os.O_CREAT)
        if not file_locks.hold(handle):
            os.close(handle)
            raise ArtifactError(
                f"{path}: another run is writing here; wait for it, or give another folder.",
                code="folder.busy",
                where=path,
            )
        try:
            is_current = os.path.samestat(os.fstat(handle), parent.status(lock_name))
        except FileNotFoundError:  # the run that held it has ended meanwhile
            is_current = False
        if is_current:
            break
        os.close(handle)
    cleanup.callback(file_locks.remove_locked, handle, _remove_lock, parent, lock_name)


def _remove_lock(parent: OpenFolder, lock_name: str) -> None:
    with suppress(OSError):
        parent.remove(lock_name)


class _NewFolder:
    """A new folder that replaces an old one or is merged into it."""

    def __init__(self, path: Path, target: Path, new_path: Path, parent: OpenFolder) -> None:
        self.path = new_path
        self._given_path = path  # for messages
        self._target = target
        self._parent = parent

    def replace(self, *, is_listed: bool) -> None:
        """Replace the old folder; raises ArtifactError."""
        with self._reported(), ExitStack() as cleanup:
            new = cleanup.enter_context(OpenFolder.open(self.path))
            if is_listed:
                write_list(new, hash_files(new))
            old = self._open_old(cleanup)
            listed = None
            if old:
                listed = read_list(old)
            if old and listed is None and _have_common_files(old, new):
                old.copy_mode(new)
                sync_all(new)
                self._keep_whole()
            else:
                self._take_name(new, old, partial(_is_user_file, listed or {}))

    def update(self) -> None:
        """Add the files of the old folder that the new one does not have, and replace it."""
        with self._reported(), ExitStack() as cleanup:
            new = cleanup.enter_context(OpenFolder.open(self.path))
            hashes = hash_files(new)
            old = self._open_old(cleanup)
            listed = None
            if old:
                listed = read_list(old)
            replaced_files = set(hashes)
            if listed is not None:
                write_list(new, {**listed, **hashes})
                replaced_files.add(LIST)
            self._take_name(new, old, lambda _folder, path, _name: path not in replaced_files)

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise unwritable(self._given_path, error) from error

    def _open_old(self, cleanup: ExitStack) -> OpenFolder | None:
        if not self._parent.has(self._target.name):
            return None
        return cleanup.enter_context(self._parent.open_folder(self._target.name))

    def _take_name(self, new: OpenFolder, old: OpenFolder | None, is_kept: _Selection) -> None:
        """Exchange both folders; `is_kept` selects old files that are in both."""
        carrier = None
        carried: Collection[str] = ()
        if old:
            carrier = _Carrier(old, new, self._given_path)
            old.copy_mode(new)
            carrier.carry(is_kept)
            carried = carrier.carried
        sync_all(new, carried)
        with OpenFolder.open(self.path.parent) as scratch:
            self._exchange(scratch, self.path.name)
            if carrier:
                with (
                    scratch.open_folder(self.path.name) as old_now,
                    self._parent.open_folder(self._target.name) as new_now,
                ):
                    carrier.carry_latecomers(old_now, new_now)
        self._parent.sync()

    def _keep_whole(self) -> None:
        """Exchange old and new folder, and keep the old one under a numbered name."""
        name = _find_free(self._target.name, self._parent)
        with OpenFolder.open(self.path.parent) as scratch:
            scratch.rename(self.path.name, self._parent, name)
            try:
                self._exchange(self._parent, name)
            except (OSError, ArtifactError):
                self._parent.rename(name, scratch, self.path.name)
                raise
        self._parent.sync()
        _log.warning(
            "%s held files that are not signed with your key; they are kept in %s.",
            self._given_path,
            self._given_path.with_name(name),
        )

    def _exchange(self, place: OpenFolder, name: str) -> None:
        target = self._target.name
        if not self._parent.has(target):
            place.rename(name, self._parent, target)
            return
        if exchange(place, name, self._parent, target):
            return
        # A kill between these two leaves the old result under its third name.
        earlier = f".{target}{_EARLIER}"
        if self._parent.has(earlier):
            raise ArtifactError(
                f"{self._given_path}: {describe_leftover(self._target)}.",
                code="folder.leftover",
                where=self._given_path,
            )
        self._parent.rename(target, self._parent, earlier)
        try:
            place.rename(name, self._parent, target)
        except OSError:
            self._parent.rename(earlier, self._parent, target)
            raise
        self._parent.rename(earlier, place, name)


def _find_free(name: str, *folders: OpenFolder) -> str:
    """Return a numbered name, as GNU's backups have, that is in none of the folders."""
    for number in range(1, _MAX_BACKUPS):
        free_name = f"{name}.~{number}~"
        if not any(folder.has(free_name) for folder in folders):
            return free_name
    raise OSError(errno.EEXIST, os.strerror(errno.EEXIST), name)


def hash_files(folder: OpenFolder) -> dict[str, str]:
    """Return the SHA-256 of all files of a folder by relative path."""
    return {
        path: parent.hash_file(name)
        for parent, path, name in walk(folder)
        if not parent.is_folder(name)
    }


def write_list(folder: OpenFolder, hashes: Mapping[str, str]) -> None:
    """Write the signed list of the files of a result."""
    data = {"files": dict(hashes), "signature": _sign(hashes)}
    folder.write_file(LIST, json.dumps(data, indent=0).encode())


def read_list(folder: OpenFolder) -> dict[str, str] | None:
    """Return the hashes of a list that this user's HESR has signed; None if there is none.

    Raises OSError for a list that cannot be read.
    """
    if not folder.has(LIST) or not stat.S_ISREG(folder.status(LIST).st_mode):
        return None
    try:
        data = json.loads(folder.read_file(LIST, _MAX_LIST_SIZE))
        hashes: dict[str, str] = data["files"]
        is_signed = hmac.compare_digest(str(data["signature"]).encode(), _sign(hashes).encode())
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    if not is_signed:
        return None
    return hashes


def _sign(hashes: Mapping[str, str]) -> str:
    from hesr_model.support.cache import key_with_secret

    return key_with_secret("result", json.dumps(hashes, sort_keys=True).encode()).hex()


def _is_user_file(listed: Mapping[str, str], folder: OpenFolder, path: str, name: str) -> bool:
    """Return whether a file is not as HESR wrote it."""
    if path == LIST:
        return False
    if path not in listed or not stat.S_ISREG(folder.status(name).st_mode):
        return True
    return folder.hash_file(name) != listed[path]


def _have_common_files(old: OpenFolder, new: OpenFolder) -> bool:
    """Return whether two folders have a file in common, or a file where the other has a folder."""
    with ExitStack() as cleanup:
        for name in set(old.names()).intersection(new.names()) - {LIST}:
            if not (old.is_folder(name) and new.is_folder(name)):
                return True
            old_child = cleanup.enter_context(old.open_folder(name))
            if _have_common_files(old_child, cleanup.enter_context(new.open_folder(name))):
                return True
    return False


class _Carrier:
    """Shares files of an old folder with a new one.

    Where the new one has another file of the name, the old file gets a numbered name.
    """

    def __init__(self, old: OpenFolder, new: OpenFolder, given_path: Path) -> None:
        self._old = old
        self._new = new
        self._given_path = given_path
        self._seen: set[str] = set()
        self._new_names: dict[str, str] = {}  # of folders, by their path in the old folder
        self.carried: set[str] = set()  # paths in the new folder

    def carry(self, is_kept: _Selection) -> None:
        """Share the selected files and empty folders; raises OSError."""
        for path in self._select(is_kept):
            self._share(path)

    def carry_latecomers(self, old: OpenFolder, new: OpenFolder) -> None:
        """Share what has come into the old folder until both were exchanged; raises OSError.

        The folders are opened again: without handles, their paths have changed.
        """
        self._old = old
        self._new = new
        seen_before = frozenset(self._seen)
        for path in self._select(lambda _folder, path, _name: path not in seen_before):
            self._share(path)

    def _select(self, is_kept: _Selection) -> list[str]:
        paths = []
        for folder, path, name in walk(self._old):
            is_first_look = path not in self._seen
            self._seen.add(path)
            if not folder.is_folder(name):
                if is_kept(folder, path, name):
                    paths.append(path)
                continue
            with folder.open_folder(name) as child:
                if is_first_look and not child.names():
                    paths.append(path)
        return paths

    def _share(self, path: str) -> None:
        """Share an entry, below the new folders of its parents, whose names may differ."""
        *parents, name = path.split("/")
        with ExitStack() as cleanup:
            old = self._old
            new = self._new
            old_path = ""
            new_path = ""
            for parent in parents:
                old_path += f"{parent}/"
                new_name = self._provide_folder(old, new, parent, old_path)
                new_path += f"{new_name}/"
                old = cleanup.enter_context(old.open_folder(parent))
                new = cleanup.enter_context(new.open_folder(new_name))
            if old.is_folder(name):
                self._provide_folder(old, new, name, f"{path}/")
                return
            new_name = name
            if new.has(name):
                new_name = self._find_backup(old, new, name, path)
            old.share(name, new, new_name)
            self.carried.add(f"{new_path}{new_name}")

    def _provide_folder(self, old: OpenFolder, new: OpenFolder, name: str, old_path: str) -> str:
        """Return the name of the new folder for an old one, which is made if missing."""
        if old_path not in self._new_names:
            self._new_names[old_path] = name
            if new.has(name) and not new.is_folder(name):
                self._new_names[old_path] = self._find_backup(old, new, name, old_path)
        new_name = self._new_names[old_path]
        if not new.has(new_name):
            new.make_folder(new_name)
            with old.open_folder(name) as old_child, new.open_folder(new_name) as new_child:
                old_child.copy_mode(new_child)
        return new_name

    def _find_backup(self, old: OpenFolder, new: OpenFolder, name: str, path: str) -> str:
        backup = _find_free(name, old, new)
        _log.warning("%s was changed; it is kept as %s.", self._given_path / path, backup)
        return backup
