"""The cache: each entry is made once, complete and in a usable place."""

import hashlib
import hmac
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from hesr_model.support import cache
from hesr_model.support.cache import compute_once, count_hits, folder
from hesr_model.support.parallel import results_of


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "cache" / "hesr"


class Maker:
    """Makes an entry and counts its calls."""

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.times = 0

    def __call__(self) -> bytes:
        self.times += 1
        time.sleep(0.01)  # lets the other threads arrive meanwhile
        return self.content


def entries(here: Path) -> list[Path]:
    return [p for p in here.rglob("*") if p.is_file() and p.name != "lock"]


def test_the_same_inputs_are_made_once(here: Path) -> None:
    make = Maker(b"made")
    assert [compute_once("things", ("a", b"b"), make) for _ in range(3)] == [b"made"] * 3
    assert make.times == 1
    assert len(entries(here)) == 1


def test_hits_in_workers_are_counted(here: Path) -> None:
    def asked(name: str) -> bytes:
        return compute_once("counted", [name], lambda: b"made")

    jobs = [partial(asked, name) for name in ("a", "b", "a", "b")]
    before = cache.USED.copy()
    assert asked("a") == b"made"
    with results_of(jobs, 2) as results:
        assert list(results) == [b"made"] * 4
    assert count_hits(before) == {"counted": (3, 5)}


@pytest.mark.parametrize("other", [("a", "c"), ("ab",), ("a", "b", ""), ("b", "a"), ("", "ab")])
def test_other_inputs_make_another_entry(other: tuple[str, ...]) -> None:
    compute_once("things", ("a", "b"), Maker(b"one"))
    assert compute_once("things", other, Maker(b"two")) == b"two"


def test_kinds_are_separate() -> None:
    compute_once("things", ("a",), Maker(b"one"))
    assert compute_once("others", ("a",), Maker(b"two")) == b"two"


def test_twenty_concurrent_requests_make_one_entry() -> None:
    make = Maker(b"made")
    with ThreadPoolExecutor(20) as pool:
        got = list(pool.map(lambda _: compute_once("things", ("a",), make), range(20)))
    assert got == [b"made"] * 20
    assert make.times == 1


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-1],
        lambda data: data[:20],
        lambda data: data[:0],
        lambda data: data[:-1] + bytes([data[-1] ^ 1]),
        lambda data: bytes([data[0] ^ 1]) + data[1:],
    ],
    ids=["cut", "cut in the digest", "empty", "changed", "digest changed"],
)
def test_a_damaged_entry_is_made_again(here: Path, damage: Callable[[bytes], bytes]) -> None:
    make = Maker(b"made of something long enough")
    compute_once("things", ("a",), make)
    (entry,) = entries(here)
    whole = entry.read_bytes()
    entry.write_bytes(damage(whole))
    assert compute_once("things", ("a",), make) == make.content
    assert make.times == 2
    assert entry.read_bytes() == whole


def test_an_entry_of_other_inputs_is_not_used(here: Path) -> None:
    compute_once("things", ("a",), Maker(b"one"))
    (one,) = entries(here)
    compute_once("things", ("b",), Maker(b"two"))
    (two,) = set(entries(here)) - {one}
    two.replace(one)
    assert compute_once("things", ("a",), Maker(b"one")) == b"one"


def test_a_failure_is_not_cached(here: Path) -> None:
    def fail() -> bytes:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        compute_once("things", ("a",), fail)
    assert entries(here) == []
    assert compute_once("things", ("a",), Maker(b"made")) == b"made"


def test_without_a_cache_folder_entries_are_made_every_time(here: Path) -> None:
    folder()
    (here / "things").write_text("in the way")
    make = Maker(b"made")
    assert [compute_once("things", ("a",), make) for _ in range(2)] == [b"made"] * 2
    assert make.times == 2


def test_the_least_recently_used_entry_is_removed_first(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for age, name in enumerate("abc"):
        before = set(entries(here))
        compute_once("things", (name,), Maker(name.encode() * 1000))
        (new,) = set(entries(here)) - before
        os.utime(new, (age, age))
    compute_once("things", ("a",), Maker(b""))  # marks the entry as used
    monkeypatch.setattr(cache, "LIMIT", 3500)
    compute_once("things", ("d",), Maker(b"d" * 1000))
    made = {name: Maker(name.encode() * 1000) for name in "acdb"}
    for name, make in made.items():
        assert compute_once("things", (name,), make) == make.content
    assert {name: make.times for name, make in made.items()} == {"a": 0, "c": 0, "d": 0, "b": 1}


# --- location ---------------------------------------------------------------------------------


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / f"hesr-cache-{os.getuid()}"


def test_the_users_own_folder_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert folder() == tmp_path / "cache" / "hesr"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert folder() == tmp_path / ".cache" / "hesr"
    assert folder().stat().st_mode & 0o777 == 0o700


# Not even root can write to /proc; on some machines a service has no other home.
@pytest.mark.parametrize("home", [None, "", "/proc", "/dev/null", "/nowhere/at/all", "relative"])
def test_without_a_home_a_private_folder_is_used(
    temporary: Path, home: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HOME", raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home)
    assert [folder(), folder()] == [temporary] * 2
    assert temporary.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_another_user_is_not_trusted(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HOME")
    temporary.mkdir(mode=0o700)
    os.chown(temporary, 12345, 12345)
    assert folder() != temporary


@pytest.mark.parametrize("way", ["open", "link"])
def test_a_folder_writable_by_others_is_not_trusted(
    temporary: Path, way: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("HOME")
    if way == "open":
        temporary.mkdir()
        temporary.chmod(0o777)
    else:
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        temporary.symlink_to(tmp_path / "elsewhere")
    assert folder() != temporary
    assert folder().stat().st_mode & 0o777 == 0o700


# --- poisoned caches --------------------------------------------------------------------------

GOOD, EVIL = b"made of something", b"planted by others"


def poisoned(here: Path, deed: str, tmp_path: Path) -> None:
    """Put the content of another user in the place of the only entry."""
    (entry,) = entries(here)
    name = entry.name.encode()
    planted = tmp_path / "planted"
    planted.write_bytes(hashlib.sha256(name + EVIL).digest() + EVIL)  # without the key
    planted.chmod(0o600)
    entry.unlink()
    if deed == "planted":
        planted.rename(entry)
    elif deed == "link":
        entry.symlink_to(planted)
    elif deed == "other key":
        key = b"k" * 32
        message = f"things/{entry.name}".encode() + b"\0" + EVIL
        entry.write_bytes(hmac.digest(key, message, "sha256") + EVIL)
        entry.chmod(0o600)
    elif deed == "other kind":
        compute_once("others", ("a",), lambda: EVIL)
        (other,) = (here / "others").glob("*/?*[!k]")
        other.rename(entry)


@pytest.mark.parametrize("deed", ["planted", "link", "other key", "other kind"])
def test_planted_entries_are_not_used(here: Path, tmp_path: Path, deed: str) -> None:
    compute_once("things", ("a",), lambda: GOOD)
    poisoned(here, deed, tmp_path)
    make = Maker(GOOD)
    assert compute_once("things", ("a",), make) == GOOD
    assert make.times == 1


def give_away(path: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can give a file or folder away")
    os.chown(path, 12345, 12345)


@pytest.mark.parametrize("deed", ["readable", "foreign", "link to a good one"])
def test_entries_that_others_may_have_changed_are_not_used(
    here: Path, tmp_path: Path, deed: str
) -> None:
    compute_once("things", ("a",), lambda: GOOD)
    (entry,) = entries(here)
    if deed == "readable":
        entry.chmod(0o666)
    elif deed == "foreign":
        give_away(entry)
    else:
        entry.symlink_to(entry.rename(tmp_path / "moved"))
    make = Maker(GOOD)
    assert compute_once("things", ("a",), make) == GOOD
    assert make.times == 1


@pytest.mark.parametrize("place", ["things", "things/ab"])
def test_links_to_folders_are_not_followed(here: Path, tmp_path: Path, place: str) -> None:
    compute_once("things", ("a",), lambda: GOOD)
    (entry,) = entries(here)
    shelf = entry.parent if "/" in place else entry.parent.parent
    shelf.symlink_to(shelf.rename(tmp_path / "moved"))
    make = Maker(GOOD)
    assert compute_once("things", ("a",), make) == GOOD
    assert make.times == 1
    assert len(entries(tmp_path / "moved")) == 1  # nothing is written there


def spoiled(place: Path, deed: str) -> None:
    place.mkdir(parents=True, mode=0o700)
    if deed == "open":
        place.chmod(0o777)
    elif deed == "readable":
        place.chmod(0o755)
    elif deed == "foreign":
        give_away(place)
    else:
        place.rename(place.with_name("elsewhere"))
        place.symlink_to(place.with_name("elsewhere"))


@pytest.mark.parametrize("deed", ["open", "readable", "foreign", "link"])
@pytest.mark.parametrize("place", ["cache", "config"])
def test_folders_of_others_are_replaced_with_a_warning(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    place: str,
    deed: str,
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    spoiled(tmp_path / place / "hesr", deed)
    make = Maker(GOOD)
    with caplog.at_level(logging.WARNING):
        assert [compute_once("things", ("a",), make) for _ in range(2)] == [GOOD] * 2
    assert make.times == 1
    (warning,) = caplog.messages  # once
    assert f"{tmp_path / place / 'hesr'} is a link, belongs" in warning
    (own,) = temporary.iterdir()
    assert own.stat().st_mode & 0o777 == 0o700
    assert not list((tmp_path / place / "hesr").iterdir())


def test_folders_and_files_are_private(here: Path, tmp_path: Path) -> None:
    compute_once("things", ("a",), lambda: GOOD)
    for path in (*here.rglob("*"), here, *(tmp_path / "config" / "hesr").rglob("*")):
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path
    assert len((tmp_path / "config" / "hesr" / "key").read_bytes()) == 32


@pytest.mark.parametrize("deed", ["readable", "short", "link"])
def test_a_key_that_others_may_know_is_replaced(here: Path, tmp_path: Path, deed: str) -> None:
    place = tmp_path / "config" / "hesr"
    place.mkdir(parents=True, mode=0o700)
    key = place / "key"
    key.write_bytes(b"k" * (16 if deed == "short" else 32))
    key.chmod(0o644 if deed == "readable" else 0o600)
    if deed == "link":
        key.symlink_to(key.rename(tmp_path / "known"))
    compute_once("things", ("a",), lambda: GOOD)
    assert not key.is_symlink()
    assert len(key.read_bytes()) == 32
    assert key.read_bytes() != b"k" * 32
    assert key.stat().st_mode & 0o777 == 0o600


def test_another_user_with_a_copy_of_the_cache_reuses_nothing(
    here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compute_once("things", ("a",), lambda: EVIL)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "victim"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "copy"))
    shutil.copytree(here, tmp_path / "copy" / "hesr", copy_function=shutil.copy2)
    assert compute_once("things", ("a",), lambda: GOOD) == GOOD
