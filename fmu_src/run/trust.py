"""Which FMUs were exported here, by their hash: those run without a process of their own.

The hashes are kept as names of empty files in the user's cache folder. Whoever can write there can
do what the user can, without any FMU.
"""

import logging
import os
from contextlib import suppress
from itertools import islice
from pathlib import Path

from hesr_model.support import cache
from hesr_model.support.files import sha256

_MOST = 20_000
_log = logging.getLogger(__name__)


def folder() -> Path:
    """Return the folder of the hashes."""
    return cache.folder() / "exported"


def remember(fmu: Path) -> None:
    """Remember that an FMU may be run as our own code.

    Where the cache folder cannot be written, it will be run as one of strangers: slower, with the
    same results.
    """
    try:
        place = folder()
        place.mkdir(parents=True, exist_ok=True)
        (place / sha256(fmu)).touch()
        _forget_some(place)
    except OSError as error:
        _log.info("%s: will be run in a process of its own (%s).", fmu, error)


def is_known(digest: str) -> bool:
    """Whether an FMU of this SHA-256 has been exported or is trusted."""
    try:
        return (folder() / digest).is_file()
    except OSError:  # a folder that may not be looked into
        return False


def is_ours(fmu: Path) -> bool:
    """Whether an FMU has been exported or is trusted."""
    return is_known(sha256(fmu))


def _forget_some(place: Path) -> None:
    """Remove the older half of too many hashes."""
    with os.scandir(place) as entries:
        if next(islice(entries, _MOST, None), None) is None:
            return
    oldest = sorted(place.iterdir(), key=lambda file: file.stat().st_mtime)
    for file in oldest[: _MOST // 2]:
        with suppress(FileNotFoundError):  # another process was faster
            file.unlink()
