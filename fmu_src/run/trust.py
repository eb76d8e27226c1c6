"""Trusted FMUs: empty files in the user's cache folder.

They are named after hashes of FMUs under the user's key, which others cannot compute.
"""

import logging
from contextlib import suppress
from pathlib import Path

from hesr_model.support import cache
from hesr_model.support.files import sha256

_MAX_HASHES = 20_000
_log = logging.getLogger(__name__)


def hash_folder() -> Path:
    """Return the folder of the hashes of trusted FMUs."""
    return cache.folder() / "exported"


def remember(fmu: Path) -> None:
    """Trust an FMU, if the cache folder can be written."""
    try:
        folder = hash_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        (folder / _mark(sha256(fmu))).touch(mode=0o600)
        _forget_oldest(folder)
    except OSError as error:
        _log.info("%s: will be run in a process of its own (%s).", fmu, error)


def is_known(digest: str) -> bool:
    """Whether an FMU of this SHA-256 is trusted."""
    try:
        return (hash_folder() / _mark(digest)).is_file()
    except OSError:  # no permission
        return False


def _mark(digest: str) -> str:
    return cache.key_with_secret("exported", digest.encode()).hex()


def is_trusted(fmu: Path) -> bool:
    """Whether an FMU is trusted."""
    return is_known(sha256(fmu))


def _forget_oldest(folder: Path) -> None:
    hash_files = list(folder.iterdir())
    if len(hash_files) <= _MAX_HASHES:
        return
    for file in sorted(hash_files, key=lambda file: file.stat().st_mtime)[: _MAX_HASHES // 2]:
        with suppress(FileNotFoundError):  # another process was faster
            file.unlink()
