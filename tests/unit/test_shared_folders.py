"""Folders of slow fixtures: filled once, kept while the sources are the same, oldest out."""

import os
from pathlib import Path

import pytest
import shared_folders
from shared_folders import fill_once, keep, remove_oldest


class Filler:
    """Fills a folder and counts its calls."""

    def __init__(self) -> None:
        self.calls = 0

    def fill(self, folder: Path) -> None:
        self.calls += 1
        (folder / "file").write_text("text", encoding="utf-8")


@pytest.fixture(autouse=True)
def cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(shared_folders, "CACHE", tmp_path / "cache")
    return tmp_path / "cache"


def test_a_folder_is_filled_once_while_the_sources_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filler = Filler()
    monkeypatch.setattr(shared_folders, "hash_of_sources", lambda: "first")
    folders = {keep("a name", filler.fill, tmp_path) for _ in range(2)}
    assert filler.calls == 1
    monkeypatch.setattr(shared_folders, "hash_of_sources", lambda: "second")
    folders.add(keep("a name", filler.fill, tmp_path))
    assert filler.calls == 2
    assert [(folder / "file").read_text(encoding="utf-8") for folder in folders] == ["text"] * 2


def test_a_folder_of_a_killed_process_is_filled_again(tmp_path: Path) -> None:
    (tmp_path / "place" / "shared").mkdir(parents=True)
    (tmp_path / "place" / "shared" / "half").touch()
    folder = fill_once(tmp_path / "place", "name", Filler().fill, tmp_path)
    assert [path.name for path in folder.iterdir()] == ["file"]


def test_a_failure_is_not_repeated_in_its_session(tmp_path: Path) -> None:
    calls = []

    def fail(folder: Path) -> None:
        calls.append(folder)
        raise ValueError("no motion")

    with pytest.raises(ValueError, match="no motion"):
        keep("name", fail, tmp_path)
    with pytest.raises(pytest.fail.Exception, match="name could not be filled: ValueError: no"):
        keep("name", fail, tmp_path)
    assert len(calls) == 1
    another_session = tmp_path / "another"
    another_session.mkdir()
    with pytest.raises(ValueError, match="no motion"):
        keep("name", fail, another_session)


def test_the_oldest_folders_are_removed(tmp_path: Path) -> None:
    for age, name in enumerate(("new", "old", "oldest")):
        folder = fill_once(tmp_path / "cache" / name, name, Filler().fill, tmp_path)
        os.utime(folder.parent / "done", (1e9 - age, 1e9 - age))
    remove_oldest(tmp_path / "cache", 2 * len("text"))
    assert sorted(path.name for path in (tmp_path / "cache").iterdir()) == ["new", "old"]


def test_every_source_but_tests_determines_the_key() -> None:
    names = {
        path.relative_to(shared_folders.ROOT).as_posix() for path in shared_folders.source_files()
    }
    assert {"hesr/cli/__init__.py", "tests/conftest.py", "tests/cosim/small_study.py"} <= names
    assert any(name.endswith(".c") for name in names)
    assert not any("test_" in Path(name).name for name in names if name.startswith("tests/"))
