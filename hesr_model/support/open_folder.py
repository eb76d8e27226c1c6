"""Operations on the entries of an open folder, which follow no link."""

import ctypes
import errno
import hashlib
import os
import stat
import sys
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from secrets import token_hex
from typing import Any, Self

from hesr_model.errors import ArtifactError

_HAS_HANDLES = os.open in os.supports_dir_fd  # of folders; Windows has none
_FOLDER_FLAGS = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)  # for the other end of a pipe
_BINARY = getattr(os, "O_BINARY", 0)
_EXCHANGE = 2  # RENAME_EXCHANGE
_CANNOT_EXCHANGE = {errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.EXDEV}
_CANNOT_SYNC = {errno.EINVAL, errno.EOPNOTSUPP, errno.EBADF}  # file systems without it
_MAX_DEPTH = 64  # folders within each other; each holds an open file


class OpenFolder:
    """A folder that stays the same one if another takes its name or a link replaces it."""

    def __init__(self, path: Path, handle: int | None) -> None:
        self.path = path  # for messages
        self._handle = handle

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a folder, also through links; raises OSError."""
        handle = None
        if _HAS_HANDLES:
            handle = os.open(path, _FOLDER_FLAGS)
        return cls(path, handle)

    def open_folder(self, name: str) -> "OpenFolder":
        """Open a folder in this one; a link to a folder raises OSError."""
        path = self.path / name
        if self._handle is not None:
            return OpenFolder(path, os.open(name, _FOLDER_FLAGS | _NO_LINK, dir_fd=self._handle))
        if not stat.S_ISDIR(self.status(name).st_mode):
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
        return OpenFolder(path, None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the folder."""
        if self._handle is not None:
            os.close(self._handle)

    def _at(self, name: str) -> str:
        """Return what a call with `dir_fd` takes for an entry: its path if there is no handle."""
        return name if self._handle is not None else str(self.path / name)

    def names(self) -> list[str]:
        """Return the names of all entries in order."""
        with os.scandir(self.path if self._handle is None else self._handle) as entries:
            return sorted(entry.name for entry in entries)

    def status(self, name: str = "") -> os.stat_result:
        """Return the status of an entry, which may be a link, or of the folder."""
        if not name:
            return self.path.stat() if self._handle is None else os.fstat(self._handle)
        return os.stat(self._at(name), dir_fd=self._handle, follow_symlinks=False)

    def has(self, name: str) -> bool:
        """Return whether there is an entry of this name; a link without target is one."""
        try:
            self.status(name)
        except FileNotFoundError:
            return False
        return True

    def is_folder(self, name: str) -> bool:
        """Return whether an entry is a folder, not a link to one."""
        return stat.S_ISDIR(self.status(name).st_mode)

    def make_folder(self, name: str, mode: int = 0o777) -> None:
        """Make a folder with the permissions that the user's mask leaves of `mode`."""
        os.mkdir(self._at(name), mode, dir_fd=self._handle)

    def open_file(self, name: str, flags: int, mode: int = 0o666) -> int:
        """Open a file that is no link and no pipe; return its descriptor, for which OSError."""
        handle = os.open(
            self._at(name), flags | _NO_LINK | _NO_WAIT | _BINARY, mode, dir_fd=self._handle
        )
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise OSError(errno.EINVAL, "it is a pipe or a device", str(self.path / name))
        return handle

    def read_file(self, name: str, limit: int) -> bytes:
        """Return at most `limit` bytes of a file."""
        with os.fdopen(self.open_file(name, os.O_RDONLY), "rb") as file:
            return file.read(limit)

    def write_file(self, name: str, data: bytes) -> None:
        """Write a new file."""
        handle = self.open_file(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        with os.fdopen(handle, "wb") as file:
            file.write(data)

    def hash_file(self, name: str) -> str:
        """Return the hex SHA-256 of a file."""
        with os.fdopen(self.open_file(name, os.O_RDONLY), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def remove(self, name: str) -> None:
        """Remove a file or a link."""
        os.unlink(self._at(name), dir_fd=self._handle)

    def remove_folder(self, name: str) -> None:
        """Remove an empty folder."""
        os.rmdir(self._at(name), dir_fd=self._handle)

    def rename(self, name: str, other: "OpenFolder", other_name: str) -> None:
        """Move an entry; replaces a file, or an empty folder where the system can."""
        os.replace(
            self._at(name),
            other._at(other_name),
            src_dir_fd=self._handle,
            dst_dir_fd=other._handle,
        )

    def share(self, name: str, other: "OpenFolder", other_name: str) -> None:
        """Give a file or a link a second name, or copy it where the file system has one name."""
        status = self.status(name)
        if stat.S_ISLNK(status.st_mode):
            target = os.readlink(self._at(name), dir_fd=self._handle)
            os.symlink(target, other._at(other_name), dir_fd=other._handle)
            return
        try:
            os.link(
                self._at(name),
                other._at(other_name),
                src_dir_fd=self._handle,
                dst_dir_fd=other._handle,
                follow_symlinks=False,
            )
        except (OSError, NotImplementedError):
            self._copy(name, other, other_name)

    def _copy(self, name: str, other: "OpenFolder", other_name: str) -> None:
        source_handle = self.open_file(name, os.O_RDONLY)
        with os.fdopen(source_handle, "rb") as source:
            status = os.fstat(source.fileno())
            target_handle = other.open_file(other_name, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
            with os.fdopen(target_handle, "wb") as target:
                while block := source.read(1 << 20):
                    target.write(block)
                target.flush()
                if hasattr(os, "fchmod"):
                    os.fchmod(target.fileno(), stat.S_IMODE(status.st_mode))
        times = (status.st_atime_ns, status.st_mtime_ns)
        os.utime(other._at(other_name), ns=times, dir_fd=other._handle)

    def copy_mode(self, other: "OpenFolder") -> None:
        """Give another folder the group of this one and its permissions for others."""
        if self._handle is None or other._handle is None:
            return
        status = os.fstat(self._handle)
        with suppress(OSError):
            os.fchown(other._handle, -1, status.st_gid)
        os.fchmod(other._handle, stat.S_IMODE(status.st_mode) | 0o700)

    def allow_all(self, name: str) -> None:
        """Permit its owner everything in a folder of this one."""
        status = self.status(name)
        if stat.S_ISDIR(status.st_mode) and status.st_mode & 0o700 != 0o700:
            os.chmod(self._at(name), 0o700, dir_fd=self._handle)

    def sync(self) -> None:
        """Write the names in this folder to the disk; raises OSError."""
        if self._handle is not None:
            _sync(self._handle)


def sync_file(path: Path) -> None:
    """Write a file to the disk; raises OSError."""
    handle = os.open(path, os.O_RDONLY if _HAS_HANDLES else os.O_RDWR | _BINARY)
    try:
        _sync(handle)
    finally:
        os.close(handle)


def sync_folder(path: Path) -> None:
    """Write the names in a folder to the disk; raises OSError."""
    with OpenFolder.open(path) as folder:
        folder.sync()


def sync_all(folder: OpenFolder, without: Collection[str] = ()) -> None:
    """Write a folder and all in it to the disk, except for some files; raises OSError."""
    for parent, path, name in walk(folder):
        if parent.is_folder(name):
            with parent.open_folder(name) as child:
                child.sync()
        elif path not in without:
            handle = parent.open_file(name, os.O_RDONLY if _HAS_HANDLES else os.O_RDWR)
            try:
                _sync(handle)
            finally:
                os.close(handle)
    folder.sync()


def _sync(handle: int) -> None:
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise


def walk(
    folder: OpenFolder, prefix: str = "", depth: int = 0
) -> Iterator[tuple[OpenFolder, str, str]]:
    """Yield (folder, relative path, name) of all entries, folders after what is in them."""
    if depth > _MAX_DEPTH:
        raise ArtifactError(
            f"{folder.path}: has more than {_MAX_DEPTH} folders within each other; give another "
            "folder.",
            code="folder.depth",
            where=folder.path,
        )
    for name in folder.names():
        path = f"{prefix}{name}"
        if folder.is_folder(name):
            with folder.open_folder(name) as child:
                yield from walk(child, f"{path}/", depth + 1)
        yield folder, path, name


def remove_all(parent: OpenFolder, name: str, last: str = "") -> None:
    """Remove a folder of any depth, its file `last` at the end, and follow no link; raises OSError.

    Folders in it are first moved to its top, because each level of a recursion holds a file open.
    """
    with _open_for_removal(parent, name) as folder:
        while entries := [entry for entry in folder.names() if entry != last]:
            for entry in entries:
                if not folder.is_folder(entry):
                    folder.remove(entry)
                    continue
                with _open_for_removal(folder, entry) as child:
                    _empty(child, folder)
                folder.remove_folder(entry)
        if last:
            with suppress(FileNotFoundError):
                folder.remove(last)
    parent.remove_folder(name)


def _empty(folder: OpenFolder, top: OpenFolder) -> None:
    """Remove the files of a folder and move its folders to `top`."""
    for name in folder.names():
        if folder.is_folder(name):
            _open_for_removal(folder, name).close()
            folder.rename(name, top, token_hex(16))
        else:
            folder.remove(name)


def _open_for_removal(parent: OpenFolder, name: str) -> OpenFolder:
    """Open a folder whose entries can be removed, whatever its permissions were."""
    parent.allow_all(name)
    return parent.open_folder(name)


def exchange(first: OpenFolder, name: str, second: OpenFolder, other_name: str) -> bool:
    """Exchange two entries in one step; return False where the system cannot. Raises OSError."""
    rename = _find_rename()
    if rename is None or first._handle is None or second._handle is None:
        return False
    ctypes.set_errno(0)
    if not rename(
        first._handle, os.fsencode(name), second._handle, os.fsencode(other_name), _EXCHANGE
    ):
        return True
    code = ctypes.get_errno()
    if code in _CANNOT_EXCHANGE:
        return False
    raise OSError(code, os.strerror(code), str(second.path / other_name))


@cache
def _find_rename() -> Any:
    if sys.platform != "linux":
        return None
    try:
        function = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):  # another C library
        return None
    function.argtypes = [
        ctypes.c_int,
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char_p,
        ctypes.c_uint,
    ]
    return function
