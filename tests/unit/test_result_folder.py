"""Result folders: old or new as a whole, with the files of the user."""

import hashlib
import json
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from hesr_model.errors import ArtifactError
from hesr_model.support import files, open_folder, result_folder
from hesr_model.support.files import is_empty
from hesr_model.support.result_folder import (
    LIST,
    describe_leftover,
    folder_updated_whole,
    folder_written_whole,
)

pytestmark = pytest.mark.skipif(os.name != "posix", reason="folders have links on POSIX")


def everything_in(folder: Path) -> dict[str, str]:
    """Every entry below a folder, hidden ones included, with its text; the signed list without."""
    entries = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            entries[name] = f"-> {path.readlink()}"
        elif path.is_dir():
            entries[f"{name}/"] = ""
        else:
            entries[name] = "" if path.name == LIST else path.read_text()
    return entries


def write(path: Path, files: dict[str, str]) -> None:
    """Write a result with some files."""
    with folder_written_whole(path) as temporary:
        for name, text in files.items():
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
            (temporary / name).write_text(text)


@pytest.fixture(params=["exchange", "renames", "paths"])
def results(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Folder of a result where the system can exchange two folders, and where it cannot.

    With "paths" it has no open folders either, as Windows.
    """
    if request.param == "paths":
        monkeypatch.setattr(open_folder, "_HAS_HANDLES", False)
    elif request.param == "renames":
        monkeypatch.setattr(result_folder, "exchange", lambda *_: False)
    elif not can_exchange(tmp_path):
        pytest.skip("this file system cannot exchange two folders")
    return tmp_path / "results"


def can_exchange(folder: Path) -> bool:
    for name in "ab":
        (folder / name).mkdir()
    with open_folder.OpenFolder.open(folder) as opened:
        is_done = open_folder.exchange(opened, "a", opened, "b")
    for name in "ab":
        (folder / name).rmdir()
    return is_done


# --- one result ---------------------------------------------------------------------------------


def test_files_of_a_folder_appear_together(tmp_path: Path) -> None:
    path = tmp_path / "results" / "study"
    with folder_written_whole(path) as temporary:
        (temporary / "a.json").write_text("a")
        (temporary / "fmus").mkdir()
        (temporary / "fmus" / "b.fmu").write_text("b")
        assert not path.exists()
        assert is_empty(path.parent)  # temporary files are hidden
        assert temporary.name == path.name
    assert everything_in(path) == {"a.json": "a", "fmus/": "", "fmus/b.fmu": "b", LIST: ""}
    assert [p.name for p in path.parent.iterdir()] == ["study"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_unfinished_folder_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "a.json").write_text("old")

    def interrupted(path: Path) -> None:
        with folder_written_whole(path) as temporary:
            (temporary / "a.json").write_text("half")
            raise error

    for path in (tmp_path / "old", tmp_path / "new" / "deep"):
        with pytest.raises(error):
            interrupted(path)
    assert everything_in(tmp_path) == {"old/": "", "old/a.json": "old"}


# --- what stays and what goes -------------------------------------------------------------------


def test_files_of_an_earlier_result_go_and_those_of_the_user_stay(
    results: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write(results, {"run.json": "1", "laws/dahl.json": "1", "fmus/dahl.fmu": "1", "old/a": "1"})
    (results / "notes.txt").write_text("mine")
    (results / "laws" / "mine.json").write_text("mine")
    (results / "link").symlink_to("/etc")
    (results / "empty").mkdir()
    (results / "run.json").write_text("edited")
    write(results, {"run.json": "2", "laws/lugre.json": "2"})
    expected = {
        "run.json": "2",
        "run.json.~1~": "edited",
        "laws/": "",
        "laws/lugre.json": "2",
        "laws/mine.json": "mine",
        "notes.txt": "mine",
        "link": "-> /etc",
        "empty/": "",
        LIST: "",
    }
    assert everything_in(results) == expected
    assert [path.name for path in results.parent.iterdir()] == ["results"]
    assert "run.json.~1~" in caplog.text
    write(results, {"laws/lugre.json": "3"})
    del expected["run.json"]
    assert everything_in(results) == {**expected, "laws/lugre.json": "3"}


def test_a_folder_of_the_user_receives_a_result(results: Path) -> None:
    results.mkdir(mode=0o750)
    (results / "notes.txt").write_text("mine")
    os.mkfifo(results / "pipe")
    write(results, {"run.json": "1"})
    assert (results / "pipe").is_fifo()
    (results / "pipe").unlink()
    assert everything_in(results) == {"run.json": "1", "notes.txt": "mine", LIST: ""}
    if open_folder._HAS_HANDLES:
        assert results.stat().st_mode & 0o777 == 0o750


@pytest.mark.parametrize("list_text", [None, "{}", "[1]", "forged", "of another user"])
def test_a_result_that_is_not_signed_is_kept_whole(
    list_text: str | None,
    results: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Its list would choose the files that are removed."""
    with monkeypatch.context() as other_user:
        other_user.setenv("XDG_CONFIG_HOME", str(tmp_path / "other"))
        write(results, {"run.json": "1", "laws/dahl.json": "1"})
    (results / "notes.txt").write_text("mine")
    if list_text is None:
        (results / LIST).unlink()
    elif list_text == "forged":
        signed_list = json.loads((results / LIST).read_text())
        mine = hashlib.sha256(b"mine").hexdigest()
        (results / LIST).write_text(json.dumps(signed_list | {"files": {"notes.txt": mine}}))
    elif list_text != "of another user":
        (results / LIST).write_text(list_text)
    before = everything_in(results)
    write(results, {"run.json": "2"})
    assert everything_in(results) == {"run.json": "2", LIST: ""}
    assert everything_in(results.with_name("results.~1~")) == before
    assert "results.~1~" in caplog.text


def test_an_update_keeps_all_but_its_own_files(results: Path) -> None:
    write(results, {"run.json": "1", "report.html": "1", "figures/a": "1"})
    (results / "notes.txt").write_text("mine")
    with folder_updated_whole(results) as temporary:
        (temporary / "report.html").write_text("2")
        (temporary / "figures").mkdir()
        (temporary / "figures" / "b").write_text("2")
    assert everything_in(results) == {
        "run.json": "1",
        "report.html": "2",
        "figures/": "",
        "figures/a": "1",
        "figures/b": "2",
        "notes.txt": "mine",
        LIST: "",
    }
    write(results, {"run.json": "3"})  # all of it is still signed
    assert everything_in(results) == {"run.json": "3", "notes.txt": "mine", LIST: ""}


def test_a_file_that_comes_during_the_exchange_stays(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(results, {"run.json": "1"})
    exchange = result_folder.exchange

    def save_and_exchange(*names: Any) -> bool:
        (results / "late.txt").write_text("mine")
        return exchange(*names)

    monkeypatch.setattr(result_folder, "exchange", save_and_exchange)
    write(results, {"run.json": "2"})
    assert everything_in(results) == {"run.json": "2", "late.txt": "mine", LIST: ""}


# --- hostile folders ----------------------------------------------------------------------------


def plant_links(results: Path, outside: Path) -> dict[str, str]:
    """Put links to a folder of the user where a result has folders and files."""
    outside.mkdir()
    (outside / ".bashrc").write_text("mine")
    (outside / "report.html").write_text("mine")
    results.mkdir()
    for name in ("laws", "figures", ".hesr-whole", ".hesr-files", "notes"):
        (results / name).symlink_to(outside)
    (results / "report.html").symlink_to(outside / "report.html")
    (results / "run.json").symlink_to(outside / "new")
    (results.parent / ".results.hesr-earlier").symlink_to(outside)
    return everything_in(outside)


@pytest.mark.parametrize("open_result", [folder_written_whole, folder_updated_whole])
def test_no_link_in_a_folder_is_followed(
    open_result: Callable[[Path], AbstractContextManager[Path]], tmp_path: Path
) -> None:
    results, outside = tmp_path / "results", tmp_path / "outside"
    before = plant_links(results, outside)
    with open_result(results) as temporary:
        for name in ("laws/a", "figures/a", "report.html", "run.json"):
            (temporary / name).parent.mkdir(exist_ok=True)
            (temporary / name).write_text("new")
    assert everything_in(outside) == before
    assert (results / "laws" / "a").read_text() == "new"
    assert not (results / "laws").is_symlink()
    assert (results / "report.html").read_text() == "new"


def test_a_planted_scratch_folder_is_left_alone(tmp_path: Path) -> None:
    """Its name is not signed, or it is a link, whatever its lock says."""
    (tmp_path / "outside").mkdir()
    names = [f".hesr-{'0' * 16}-{'0' * 32}", ".hesr-abcd-1234-abcdefgh"]
    for name in names:
        (tmp_path / name / "files").mkdir(parents=True)
        (tmp_path / name / "lock").touch()
    token = "1" * 16
    (tmp_path / f".hesr-{token}-{files._sign_token(token)}").symlink_to(tmp_path / "outside")
    before = everything_in(tmp_path)
    write(tmp_path / "results", {"a": "1"})
    left = everything_in(tmp_path)
    assert {name: text for name, text in left.items() if not name.startswith("results")} == before


# --- refusals and failures ----------------------------------------------------------------------


def refused(path: Path) -> str:
    with pytest.raises(ArtifactError) as caught, folder_written_whole(path):
        pytest.fail("the work must not begin")
    return str(caught.value)


def test_an_unwritable_folder_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocking = tmp_path / "file"
    blocking.write_text("")
    for path in (blocking, blocking / "results"):
        assert refused(path) == f"{path}: cannot be written there (Not a directory)."
    (tmp_path / "read-only").mkdir()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    assert "(Permission denied)" in refused(tmp_path / "read-only")


def test_a_folder_that_cannot_be_replaced_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "outer" / "inner").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "outer" / "inner")
    assert "is the current folder" in refused(Path())
    assert "is the current folder" in refused(tmp_path / "outer")
    mounts = tmp_path / "mounts"
    mounts.write_text(f"36 35 98:0 / {tmp_path}/a\\040mount rw,noatime - ext4 /dev/root rw\n")
    monkeypatch.setattr(result_folder, "_MOUNTS", mounts)
    (tmp_path / "a mount").mkdir()
    assert "is a mount point" in refused(tmp_path / "a mount")
    write(tmp_path / "mount", {"a": "1"})


def test_an_old_result_between_two_renames_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """As a kill leaves it where the system cannot exchange folders."""
    monkeypatch.setattr(result_folder, "exchange", lambda *_: False)
    results = tmp_path / "results"
    write(results, {"a": "1"})
    results.rename(tmp_path / ".results.hesr-earlier")
    assert describe_leftover(results).startswith("a run was killed")
    before = everything_in(tmp_path / ".results.hesr-earlier")
    write(results, {"a": "2"})
    assert "a run was killed" in caplog.text
    with pytest.raises(ArtifactError, match="a run was killed"):
        write(results, {"a": "3"})
    assert everything_in(results) == {"a": "2", LIST: ""}
    assert everything_in(tmp_path / ".results.hesr-earlier") == before


def test_a_very_deep_folder_is_refused(tmp_path: Path) -> None:
    results = tmp_path / "results"
    (results / "/".join("d" * 70)).mkdir(parents=True)
    with pytest.raises(ArtifactError, match="within each other"):
        write(results, {"a": "1"})
    assert [path.name for path in results.iterdir()] == ["d"]
