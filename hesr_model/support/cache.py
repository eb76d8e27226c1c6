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
_OTHERS = 0o077  # permissions of group and others
_log = logging.getLogger(__name__)


def kept(kind: str, inputs: Iterable[str | bytes], make: Callable[[], bytes]) -> bytes:
    """Return the result of `make`, computed once for all processes of a user.

    `inputs` have a fixed order. Concurrent calls wait for the first; damaged entries are rebuilt.
    """
    name = _name(inputs)
    from filelock import FileLock  # slow to import

    # Lock files remain, so many entries share one.
    shelf = folder() / kind / name[:2]
    lock = FileLock(shelf / "lock", mode=0o600)
    try:
        for place in (shelf.parent, shelf):
            _make_private(place)
        found = _read(shelf / name)
        if found is None:
            lock.acquire()
    except OSError:
        return make()
    if found is not None:
        USED[kind, True] += 1
        return found
    try:
        found = _read(shelf / name)  # made meanwhile
        USED[kind, found is not None] += 1
        if found is None:
            found = make()
            with suppress(OSError):
                _replace(shelf / name, _digest(shelf / name, found) + found)
                # Shelves fill evenly: if this one is below its share, the cache is not full.
                if sum(size for _, size, _ in _files(shelf)) > LIMIT / _SHELVES:
                    _prune(shelf.parent)
    finally:
        lock.release()
    return found


def _name(inputs: Iterable[str | bytes]) -> str:
    key = hashlib.sha256()
    for part in inputs:
        data = part.encode() if isinstance(part, str) else part
        key.update(len(data).to_bytes(8, "little") + data)
    return key.hexdigest()


def found(kind: str, inputs: Iterable[str | bytes]) -> bytes | None:
    """Return the result kept for these inputs, if there is one."""
    name = _name(inputs)
    return _read(folder() / kind / name[:2] / name)


def since(earlier: Counter[tuple[str, bool]]) -> dict[str, tuple[int, int]]:
    """Return hits and requests by kind since an earlier state."""
    used = USED - earlier
    kinds = sorted({kind for kind, _ in used})
    return {kind: (used[kind, True], used[kind, True] + used[kind, False]) for kind in kinds}


def folder() -> Path:
    """Return a writable folder: in XDG_CACHE_HOME, .cache of HOME, or a private one."""
    return _own("XDG_CACHE_HOME", ".cache")


def key_with_secret(kind: str, content: bytes) -> bytes:
    """Return a hash of content that only this user can compute."""
    key = _key(_own("XDG_CONFIG_HOME", ".config"))
    return hmac.digest(key, kind.encode() + b"\0" + content, "sha256")


@cache
def _key(place: Path) -> bytes:
    file = place / "key"
    size = _DIGEST

    def stored() -> bytes | None:
        found = _content(file)
        return found if found and len(found) == size else None  # else perhaps known to others

    found = stored()
    if found:
        return found
    from filelock import FileLock  # slow to import

    try:
        with FileLock(place / "lock", mode=0o600):
            found = stored()
            if not found:
                found = secrets.token_bytes(size)
                _replace(file, found)
    except OSError as error:
        _log.info("%s: cannot be written (%s); nothing is reused.", file, error)
        return secrets.token_bytes(size)
    return found


def _own(variable: str, default: str) -> Path:
    named = Path(os.environ.get(variable, ""))
    home = Path(os.environ.get("HOME", ""))
    places = []
    if named.is_absolute():
        places.append(named)
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
    return _temporary()


@cache
def _warn(path: Path) -> None:
    _log.warning(
        "%s is a link, belongs to another user or is open to others; a private temporary folder "
        "is used. Remove it.",
        path,
    )


def _is_private(of: os.stat_result, is_kind: Callable[[int], bool]) -> bool:
    own = not hasattr(os, "getuid") or (of.st_uid == os.getuid() and not of.st_mode & _OTHERS)
    return is_kind(of.st_mode) and own


def _make_private(path: Path) -> None:
    """Make a folder within a private one; raise OSError for links and those of others."""
    path.mkdir(mode=0o700, exist_ok=True)
    found = path.lstat()
    if stat.S_ISDIR(found.st_mode) and found.st_mode & _OTHERS and hasattr(os, "getuid"):
        path.chmod(0o700)
        found = path.lstat()
    if not _is_private(found, stat.S_ISDIR):
        raise PermissionError(f"{path} is not private")


def _temporary() -> Path:
    user = os.getuid() if hasattr(os, "getuid") else 0
    path = Path(tempfile.gettempdir(), f"hesr-cache-{user}")
    with suppress(OSError):
        path.mkdir(mode=0o700, exist_ok=True)
        if _is_private(path.lstat(), stat.S_ISDIR):
            return path
    return _new_folder()


@cache
def _new_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="hesr-cache-"))


def _content(file: Path) -> bytes | None:
    """Return the content of a private file that is no link; None for others."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    try:
        handle = os.open(file, flags)
    except OSError:
        return None
    with os.fdopen(handle, "rb") as opened:
        return opened.read() if _is_private(os.fstat(handle), stat.S_ISREG) else None


def _read(entry: Path) -> bytes | None:
    data = _content(entry)
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
    files = sorted(file for shelf in kind.iterdir() for file in _files(shelf))
    total = sum(size for _, size, _ in files)
    for _, size, path in files:
        if total <= LIMIT:
            break
        if not path.endswith("lock"):
            Path(path).unlink(missing_ok=True)
            total -= size


def _files(shelf: Path) -> Iterator[tuple[float, int, str]]:
    """Yield time of last use, size and path of entries, quicker than `Path` would."""
    for entry in os.scandir(shelf):
        with suppress(FileNotFoundError):
            found = entry.stat()
            yield found.st_mtime, found.st_size, entry.path
