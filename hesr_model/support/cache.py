"""Cache of slow results that depend on their inputs only.

Entries, named by a hash of their inputs, contain a hash of their content.
"""

import hashlib
import os
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from filelock import FileLock

LIMIT = 256 * 1024 * 1024  # [B] per kind, some thousand FMUs
USED: Counter[tuple[str, bool]] = Counter()
"""Cache hits (True) and misses by kind, of this process and its workers."""
_DIGEST = hashlib.sha256().digest_size


def kept(kind: str, inputs: Iterable[str | bytes], make: Callable[[], bytes]) -> bytes:
    """Return the result of `make`, computed once for all processes of a user.

    `inputs` have a fixed order. Concurrent calls wait for the first one; a damaged entry is
    rebuilt.
    """
    key = hashlib.sha256()
    for part in inputs:
        data = part.encode() if isinstance(part, str) else part
        key.update(len(data).to_bytes(8, "little") + data)
    name = key.hexdigest()
    # Lock files remain, so many entries share one.
    shelf = folder() / kind / name[:2]
    lock = FileLock(shelf / "lock")
    try:
        shelf.mkdir(parents=True, exist_ok=True)
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
                _write(shelf / name, found)
                _prune(shelf.parent)
    finally:
        lock.release()
    return found


def since(earlier: Counter[tuple[str, bool]]) -> dict[str, tuple[int, int]]:
    """Return hits and requests by kind since an earlier state."""
    used = USED - earlier
    kinds = sorted({kind for kind, _ in used})
    return {kind: (used[kind, True], used[kind, True] + used[kind, False]) for kind in kinds}


def folder() -> Path:
    """Return a writable folder: in XDG_CACHE_HOME, .cache of HOME, or a private one."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    home = Path(os.environ.get("HOME", ""))
    places = []
    if named.is_absolute():
        places.append(named)
    if home.is_absolute() and home.is_dir():
        places.append(home / ".cache")
    for place in places:
        with suppress(OSError):
            (place / "hesr").mkdir(mode=0o700, parents=True, exist_ok=True)
            if os.access(place / "hesr", os.W_OK | os.X_OK):
                return place / "hesr"
    return _temporary()


def _temporary() -> Path:
    user = os.getuid() if hasattr(os, "getuid") else 0
    path = Path(tempfile.gettempdir(), f"hesr-cache-{user}")
    with suppress(OSError):
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
        own = not hasattr(os, "getuid") or (
            found.st_uid == user and not stat.S_IMODE(found.st_mode) & 0o077
        )
        if stat.S_ISDIR(found.st_mode) and own:
            return path
    return Path(tempfile.mkdtemp(prefix="hesr-cache-"))


def _read(entry: Path) -> bytes | None:
    try:
        data = entry.read_bytes()
    except OSError:
        return None
    content = data[_DIGEST:]
    if data[:_DIGEST] != _digest(entry, content):
        return None
    with suppress(OSError):
        os.utime(entry)  # as recently used
    return content


def _write(entry: Path, content: bytes) -> None:
    handle, name = tempfile.mkstemp(dir=entry.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(_digest(entry, content) + content)
        Path(name).replace(entry)
    finally:
        Path(name).unlink(missing_ok=True)


def _digest(entry: Path, content: bytes) -> bytes:
    return hashlib.sha256(entry.name.encode() + content).digest()


def _prune(kind: Path) -> None:
    files = []
    for file in kind.glob("*/*"):
        with suppress(FileNotFoundError):
            files.append((file.stat(), file))
    total = sum(found.st_size for found, _ in files)
    for found, file in sorted(files, key=lambda pair: pair[0].st_mtime):
        if total <= LIMIT:
            break
        if file.name != "lock":
            file.unlink(missing_ok=True)
            total -= found.st_size
