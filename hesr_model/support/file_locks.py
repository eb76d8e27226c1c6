"""Locks of open files, which end with their process, also if it is killed.

They hold across PID namespaces and containers that share a folder, unlike process IDs.
"""

import os
import sys
from collections.abc import Callable

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


def try_lock(handle: int) -> bool:
    """Lock an open file; return False if it is locked elsewhere.

    Raises OSError if the file system has no locks.
    """
    try:
        if sys.platform == "win32":
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # Windows reports the latter
        return False
    return True


def hold(handle: int) -> bool:
    """Lock an open file of this process; return False if another process has locked it.

    Some network file systems have no locks. A file there is then not locked, and nobody else can
    take it for one without owner, because `try_lock` raises OSError.
    """
    try:
        return try_lock(handle)
    except OSError:
        return True


def remove_locked(handle: int, remove: Callable[..., object], *arguments: object) -> None:
    """Call `remove` for the name of a locked file, and close the file."""
    if os.name == "posix":  # it is locked until it is removed
        try:
            remove(*arguments)
        finally:
            os.close(handle)
    else:  # Windows removes no open file
        os.close(handle)
        remove(*arguments)


def is_linked(handle: int) -> bool:
    """Return whether an open file still has a name."""
    return os.fstat(handle).st_nlink > 0
