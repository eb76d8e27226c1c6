"""Cache of slow results that depend on their inputs only.

Entries, named by a hash of their inputs, contain a hash of their content under a key of the user,
who alone may read folder, entries and key.
"""

import hashlib
import hmac
import logging
import os
import secrets
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

LIMIT = 256 * 1024 * 1024  # [B] per kind, some thousand FMUs
USED: Counter[tuple[str, bool]] = Counter()  # hits (True) and misses by kind, with workers
_SHELVES = 256  # folders per kind, by the first byte of names
_DIGEST = hashlib.sha256().digest_size
_OTHERS_PERMISSIONS = 0o077  # permissions of group and others
_log = logging.getLogger(__name__)


def compute_once(kind: str, inputs: Iterable[str | bytes], make: Callable[[], bytes]) -> bytes:
    """Return the result of `make`, computed once for all processes of a user.

    `inputs` have a fixed order. Concurrent calls wait for the first; damaged entries are rebuilt.
    """
    name = _hash_inputs(inputs)
    from filelock import FileLock  # slow to import

    # Lock files remain, so many entries share one.
    shelf = folder() / kind / name[:2]
    lock = FileLock(shelf / "lock", mode=0o600)
    try:
        for private_folder in (shelf.parent, shelf):
            _make_private(private_folder)
        content = _read_entry(shelf / name)
        if content is None:
            lock.acquire()
    except OSError:
        return make()
    if content is not None:
        USED[kind, True] += 1
        return content
    try:
        content = _read_entry(shelf / name)  # made meanwhile
        USED[kind, content is not None] += 1
        if content is None:
            content = make()
            with suppress(OSError):
                _replace(shelf / name, _digest(shelf / name, content) + content)
                # Shelves fill evenly: if this one is below its share, the cache is not full.
                if sum(size for _, size, _ in _list_entries(shelf)) > LIMIT / _SHELVES:
                    _prune(shelf.parent)
    finally:
        lock.release()
    return content


def _hash_inputs(inputs: Iterable[str | bytes]) -> str:
    key = hashlib.sha256()
    for item in inputs:
        data = item.encode() if isinstance(item, str) else item
        key.update(len(data).to_bytes(8, "little") + data)
    return key.hexdigest()


def find_result(kind: str, inputs: Iterable[str | bytes]) -> bytes | None:
    """Return the result kept for these inputs, if there is one."""
    name = _hash_inputs(inputs)
    return _read_entry(folder() / kind / name[:2] / name)


def count_hits(earlier: Counter[tuple[str, bool]]) -> dict[str, tuple[int, int]]:
    """Return hits and requests by kind since an earlier state."""
    uses = USED - earlier
    kinds = sorted({kind for kind, _ in uses})
    return {kind: (uses[kind, True], uses[kind, True] + uses[kind, False]) for kind in kinds}


def folder() -> Path:
    """Return a writable folder: in XDG_CACHE_HOME, .cache of HOME, or a private one."""
    return _choose_folder("XDG_CACHE_HOME", ".cache")


def key_with_secret(kind: str, content: bytes) -> bytes:
    """Return a hash of content that only this user can compute."""
    key = _load_key(_choose_folder("XDG_CONFIG_HOME", ".config"))
    return hmac.digest(key, kind.encode() + b"\0" + content, "sha256")


@cache
def _load_key(place: Path) -> bytes:
    file = place / "key"
    size = _DIGEST

    def read_key() -> bytes | None:
        secret = _read_private(file)
        if not secret or len(secret) != size:
            return None  # perhaps known to others
        return secret

    secret = read_key()
    if secret:
        return secret
    from filelock import FileLock  # slow to import

    try:
        with FileLock(place / "lock", mode=0o600):
            secret = read_key()
            if not secret:
                secret = secrets.token_bytes(size)
                _replace(file, secret)
    except OSError as error:
        _log.info("%s: cannot be written (%s); nothing is reused.", file, error)
        return secrets.token_bytes(size)
    return secret


def _choose_folder(variable: str, default: str) -> Path:
    named_folder = Path(os.environ.get(variable, ""))
    home = Path(os.environ.get("HOME", ""))
    places = []
    if named_folder.is_absolute():
        places.append(named_folder)
    if home.is_absolute() and home.is_dir():
        places.append(home / default)
    for place in places:
        path = place / "hesr"
        with suppress(OSError):
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not _is_private(path.lstat(), stat.S_ISDIR):
                _warn(path)
                break
            if os.access(path, os.W_OK | os.X_OK):
                return path
    return _temporary_folder()


@cache
def _warn(path: Path) -> None:
    _log.warning(
        "%s is a link, belongs to another user or is open to others; a private temporary folder "
        "is used. Remove it.",
        path,
    )


def _is_private(status: os.stat_result, is_kind: Callable[[int], bool]) -> bool:
    is_owned = not hasattr(os, "getuid") or (
        status.st_uid == os.getuid() and not status.st_mode & _OTHERS_PERMISSIONS
    )
    return is_kind(status.st_mode) and is_owned


def _make_private(path: Path) -> None:
    """Make a folder within a private one; raise OSError for links and those of others."""
    path.mkdir(mode=0o700, exist_ok=True)
    status = path.lstat()
    if (
        stat.S_ISDIR(status.st_mode)
        and status.st_mode & _OTHERS_PERMISSIONS
        and hasattr(os, "getuid")
    ):
        path.chmod(0o700)
        status = path.lstat()
    if not _is_private(status, stat.S_ISDIR):
        raise PermissionError(f"{path} is not private")


def _temporary_folder() -> Path:
    user = 0
    if hasattr(os, "getuid"):
        user = os.getuid()
    path = Path(tempfile.gettempdir(), f"hesr-cache-{user}")
    with suppress(OSError):
        path.mkdir(mode=0o700, exist_ok=True)
        if _is_private(path.lstat(), stat.S_ISDIR):
            return path
    return _make_folder()


@cache
def _make_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="hesr-cache-"))


def _read_private(file: Path) -> bytes | None:
    """Return the content of a private file that is no link; None for others."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    try:
        handle = os.open(file, flags)
    except OSError:
        return None
    with os.fdopen(handle, "rb") as private_file:
        if not _is_private(os.fstat(handle), stat.S_ISREG):
            return None
        return private_file.read()


def _read_entry(entry: Path) -> bytes | None:
    data = _read_private(entry)
    if data is None:
        return None
    content = data[_DIGEST:]
    if not hmac.compare_digest(data[:_DIGEST], _digest(entry, content)):
        return None
    with suppress(OSError):
        os.utime(entry)  # as recently used
    return content


def _replace(path: Path, data: bytes) -> None:
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)


def _digest(entry: Path, content: bytes) -> bytes:
    return key_with_secret(f"{entry.parts[-3]}/{entry.name}", content)


def _prune(kind: Path) -> None:
    files: list[tuple[float, int, str]] = []
    for shelf in kind.iterdir():
        files += _list_entries(shelf)
    files.sort()  # those that were not used for longest first
    total = sum(size for _, size, _ in files)
    for _, size, path in files:
        if total <= LIMIT:
            break
        if not path.endswith("lock"):
            Path(path).unlink(missing_ok=True)
            total -= size


def _list_entries(shelf: Path) -> Iterator[tuple[float, int, str]]:
    """Yield time of last use, size and path of entries, quicker than `Path` would."""
    for entry in os.scandir(shelf):
        with suppress(FileNotFoundError):
            status = entry.stat()
            yield status.st_mtime, status.st_size, entry.path
