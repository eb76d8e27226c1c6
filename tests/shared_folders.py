"""Folders of slow fixtures: shared by the workers of a session, and kept for later sessions.

A kept folder is `~/.cache/hesr-tests/NAME-KEY`; the key is that of the sources of the product, of
all modules that tests share, and of the file of the fixture.
"""

import hashlib
import os
import platform
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

TESTS = Path(__file__).parent
ROOT = TESTS.parent
SOURCES = ("hesr", "hesr_model", "fmu_src", "cosim", "models")
NOT_READ_BY_FIXTURES = ("durations.toml", "nightly.toml")

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hesr-tests"
LARGEST_CACHE = 2 << 30  # bytes

Fill = Callable[[Path], object]


def fill_once(place: Path, name: str, fill: Fill, failures: Path) -> Path:
    """Return the folder of a name within a place, filled by the first process that needs it.

    A failure is noted for the session: no other process tries again.
    """
    folder, done, failure = place / "shared", place / "done", failures / f"{name}.failed"
    place.mkdir(parents=True, exist_ok=True)
    with FileLock(place / "lock"):
        if failure.exists():
            pytest.fail(f"{name} could not be filled: {failure.read_text(encoding='utf-8')}")
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)  # left by a process that was killed
            folder.mkdir()
            try:
                fill(folder)
            except Exception as error:
                failure.write_text(f"{type(error).__name__}: {error}", encoding="utf-8")
                raise
        done.touch()  # also says when it was last used
    return folder


def keep(name: str, fill: Fill, failures: Path) -> Path:
    """Return the folder of a name, filled in this or in an earlier session."""
    place = CACHE / f"{name.replace(' ', '_')}-{key_of(fill)}"
    is_new = not (place / "done").exists()
    folder = fill_once(place, name, fill, failures)
    if is_new:
        remove_oldest(CACHE, LARGEST_CACHE)
    return folder


def key_of(fill: Fill) -> str:
    """Return a key of what determines the content of a folder."""
    code = Path(fill.__code__.co_filename)
    kernel = os.environ.get("OPENBLAS_CORETYPE", "")  # fits differ in their last digits
    versions = f"{platform.python_version()} {np.__version__} {kernel}"
    parts = (hash_of_sources(), code.read_bytes().hex(), versions)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@cache
def hash_of_sources() -> str:
    """Return a hash of the product and of the modules and files that tests share."""
    digest = hashlib.sha256()
    for path in source_files():
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def source_files() -> Iterator[Path]:
    """Yield all files but tests, in order."""
    for folder in (*(ROOT / name for name in SOURCES), TESTS):
        for path in sorted(folder.rglob("*")):
            is_test = path.is_relative_to(TESTS) and (
                path.name.startswith("test_") or path.name in NOT_READ_BY_FIXTURES
            )
            if path.is_file() and "__pycache__" not in path.parts and not is_test:
                yield path


def remove_oldest(cache_folder: Path, largest: int) -> None:
    """Remove the folders that were not used for the longest time, down to a size in bytes."""
    places = [done.parent for done in cache_folder.glob("*/done")]
    places.sort(key=lambda place: (place / "done").stat().st_mtime, reverse=True)
    total = 0
    for place in places:
        total += sum(path.lstat().st_size for path in place.rglob("*") if path.is_file())
        if total > largest:
            shutil.rmtree(place, ignore_errors=True)
