"""Atomic writing of files and folders, and the folder of shipped models."""

import hashlib
import os
import signal
import stat
import tempfile
from pathlib import Path
from typing import Any

import pytest

from hesr_model.errors import ArtifactError
from hesr_model.support import file_locks, files
from hesr_model.support.files import (
    models_folder,
    scratch_folder,
    sha256,
    written_whole,
)


def everything_in(folder: Path) -> dict[str, str]:
    """Every file below a folder, including hidden ones, and its text."""
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()} | {
        f"{p.relative_to(folder)}/": "" for p in folder.rglob("*") if p.is_dir()
    }


def test_the_folder_of_models_holds_the_default_study() -> None:
    assert (models_folder() / "studies" / "default.toml").is_file()
    assert (models_folder() / "uf850" / "robot.toml").is_file()


def test_sha256_is_computed_from_the_bytes(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"\x00\xff friction \r\n")
    assert sha256(path) == hashlib.sha256(b"\x00\xff friction \r\n").hexdigest()


# --- one file ---------------------------------------------------------------------------------


def test_a_file_appears_only_when_complete(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "law.json"
    with written_whole(path) as temporary:
        temporary.write_text("done")
        assert not path.exists()
        assert temporary.name == "law.json"  # some writers go by the suffix
        assert temporary.is_relative_to(path.parent)  # the move must stay on one file system
    assert everything_in(tmp_path / "new" / "folder") == {"law.json": "done"}


def test_a_file_replaces_an_existing_one(tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    path.write_text("old")
    with written_whole(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert everything_in(tmp_path) == {"law.json": "new"}


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs the names of open files")
def test_a_file_is_on_the_disk_before_it_replaces_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a power failure there is the old file or the new one, but no empty one."""
    path = tmp_path / "law.json"
    path.write_text("old")
    synced: list[tuple[Path, str]] = []
    fsync = os.fsync

    def follow(handle: int) -> None:
        synced.append((Path(f"/proc/self/fd/{handle}").readlink(), path.read_text()))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", follow)
    with written_whole(path) as temporary:
        temporary.write_text("new")
    assert synced == [(temporary, "old"), (tmp_path, "new")]


def test_a_file_has_the_default_mode(tmp_path: Path) -> None:
    ordinary = tmp_path / "ordinary"
    ordinary.write_text("")
    with written_whole(tmp_path / "law.json") as temporary:
        temporary.write_text("")
    modes = [stat.S_IMODE(path.stat().st_mode) for path in (ordinary, tmp_path / "law.json")]
    assert modes[0] == modes[1]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_unfinished_file_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "law.json"
    path.write_text("old")

    def interrupted() -> None:
        with written_whole(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        interrupted()
    assert everything_in(tmp_path) == {"law.json": "old"}


def test_an_interrupted_file_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hold = file_locks.hold

    def interrupted(handle: int) -> bool:
        signal.raise_signal(signal.SIGINT)
        return hold(handle)

    monkeypatch.setattr(file_locks, "hold", interrupted)
    with pytest.raises(KeyboardInterrupt), written_whole(tmp_path / "law.json"):
        raise AssertionError("not reached")
    assert everything_in(tmp_path) == {}


def refused(path: Path) -> str:
    with pytest.raises(ArtifactError) as caught, written_whole(path) as temporary:
        temporary.write_text("never")
    return str(caught.value)


def test_a_path_below_a_regular_file_is_refused(tmp_path: Path) -> None:
    blocking = tmp_path / "file"
    blocking.write_text("")
    path = blocking / "sub" / "law.json"
    assert refused(path) == f"{path}: cannot be written there (Not a directory)."
    assert refused(blocking / "law.json").startswith(f"{blocking / 'law.json'}: cannot be written")


def test_a_folder_in_place_of_the_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    path.mkdir()
    assert refused(path) == f"{path}: cannot be written there (Is a directory)."
    assert everything_in(tmp_path) == {"law.json/": ""}


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="this system has no /proc")
def test_a_pipe_in_place_of_the_file_is_kept(tmp_path: Path) -> None:
    pipe = tmp_path / "p.json"
    os.mkfifo(pipe)
    said = rf"^{pipe}: is a pipe"
    with pytest.raises(ArtifactError, match=said), written_whole(pipe):
        pytest.fail("nothing is made that has no place")
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_an_unwritable_file_system_is_refused() -> None:
    assert refused(Path("/proc/law.json")).startswith("/proc/law.json: cannot be written there (")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        assert "Permission denied" in refused(tmp_path / "law.json")
    finally:
        tmp_path.chmod(0o700)


def test_a_folder_that_another_process_removes_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that fails removes its empty folders, also those that another run has begun to use."""
    make_scratch = files._make_scratch
    removals = iter([tmp_path / "new" / "folder", tmp_path / "new"])

    def remove_and_make(place: Path, *arguments: Any) -> Path:
        for folder in removals:
            folder.rmdir()
            if not tmp_path.joinpath("new").exists():
                break
        return make_scratch(place, *arguments)

    monkeypatch.setattr(files, "_make_scratch", remove_and_make)
    with written_whole(tmp_path / "new" / "folder" / "law.json") as temporary:
        temporary.write_text("done")
    assert (tmp_path / "new" / "folder" / "law.json").read_text() == "done"


# --- folders ----------------------------------------------------------------------------------


def test_the_hash_of_a_folder_covers_names_and_bytes(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "a").write_text("1", encoding="utf-8")
    first = sha256(folder)
    assert sha256(folder) == first
    (folder / "inner" / "a").write_text("2", encoding="utf-8")
    changed = sha256(folder)
    (folder / "inner" / "a").rename(folder / "inner" / "b")
    assert len({first, changed, sha256(folder)}) == 3


def test_a_scratch_folder_is_removed_with_any_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    outside = tmp_path.with_name(f"{tmp_path.name} outside")
    outside.mkdir()
    (outside / "kept").touch()
    with scratch_folder() as folder:
        (folder / "link").symlink_to(outside)
        (folder / "locked" / "inner").mkdir(parents=True)
        (folder / "locked" / "inner" / "file").touch()
        (folder / "locked").chmod(0)
        here = os.open(folder, os.O_RDONLY)
        for _ in range(1200):  # deeper than the path length limit
            os.mkdir("d", dir_fd=here)
            below = os.open("d", os.O_RDONLY, dir_fd=here)
            os.close(here)
            here = below
        os.close(here)
    assert list(tmp_path.iterdir()) == []
    assert (outside / "kept").is_file()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders")
def test_a_pipe_has_no_hash(tmp_path: Path) -> None:
    """Hashing must not wait for the end of a pipe."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="it is a pipe"):
        sha256(tmp_path / "pipe")
