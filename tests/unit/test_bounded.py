"""Texts, data and names from untrusted files, at their limits."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from containing import Containing

from hesr_model.errors import ConfigError
from hesr_model.support import cache
from hesr_model.support import text as bounded
from hesr_model.support.process import describe_end
from hesr_model.support.progress import UNITS_PER_JOB, make_file_progress, report_progress, watched
from hesr_model.support.text import (
    count_noun,
    parse_json,
    parse_toml,
    quote,
    quote_names,
    read_text,
    require_printable,
    sanitise,
)
from hesr_model.support.typed_files import Config


def refused(make: Callable[[], object]) -> str:
    try:
        make()
    except ValueError as error:
        return str(error)
    return ""


def test_only_one_thing_is_singular() -> None:
    assert [count_noun(count, "gap") for count in (0, 1, 2)] == ["0 gaps", "1 gap", "2 gaps"]


def test_text_length_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert bounded.MOST_BYTES == 256 * 1024 * 1024
    monkeypatch.setattr(bounded, "MOST_BYTES", 2**21)
    path = tmp_path / "text"
    path.write_bytes(b"x" * 2**21)
    assert len(read_text(path)) == 2**21
    path.write_bytes(b"x" * (2**21 + 1))
    assert refused(lambda: read_text(path)) == "it is longer than 2 MB"
    # System files report no size.
    monkeypatch.setattr(bounded, "MOST_BYTES", 10)
    if (system := Path("/proc/self/stat")).exists():
        assert "longer" in refused(lambda: read_text(system))


def test_integers_have_at_most_300_digits() -> None:
    nines = "9" * 300
    assert parse_json(nines) == parse_toml(f"a = {nines}")["a"] == int(nines)
    assert parse_toml(f"a = {10**300}")["a"] == -parse_toml(f"a = [-{10**300}]")["a"][0]
    assert refused(lambda: parse_json(nines + "9")) == "it holds an integer of 301 digits"
    told = "integer of more than 300 digits"
    for text in ("a = {}", "a = -{}", "a = [1, {}]", "[b]\na = [{{c = {}}}]"):
        assert refused(lambda t=text: parse_toml(t.format(10**300 + 1))) == Containing(told)


def test_keys_have_at_most_100_dots() -> None:
    assert parse_toml(".".join(["a"] * 101) + " = 1")
    deep = ".".join(["a"] * 102)
    told = "it is nested too deeply"
    assert refused(lambda: parse_toml(f"{deep} = 1")) == told
    assert refused(lambda: parse_toml(f"[{deep}]")) == told
    assert parse_toml(f"  # {deep}\na = '{deep}'")["a"] == deep
    assert refused(lambda: parse_json("[" * 100_000)) == told


def test_names_have_one_to_a_thousand_characters() -> None:
    assert require_printable("x") == "x"
    assert len(require_printable("x" * 1000)) == 1000
    for name in ("", "x" * 1001):
        assert f"name has {len(name)} characters" in refused(lambda n=name: require_printable(n))
    assert r"name 'a\tb' holds '\t', which cannot" in refused(lambda: require_printable("a\tb"))


def test_untrusted_texts_are_shown_on_one_short_line() -> None:
    assert sanitise("a" * 160) == "a" * 160
    assert sanitise("a" * 161) == "a" * 160 + "..."
    assert sanitise("abc", 2) == "ab..."
    assert sanitise("a\n\x1b\u202e\ud800é") == r"a\n\x1b\u202e\ud800é"
    assert quote("a\0") == r"'a\x00'"
    assert quote_names("abcde") == "'a', 'b', 'c', 'd', 'e'"
    assert quote_names("abcdef") == "'a', 'b', 'c', 'd', 'e' and 1 more"
    assert quote_names("abcd", 2) == "'a', 'b' and 2 more"


@pytest.mark.parametrize(
    ("code", "told"),
    [
        (0, "ended its process with exit code 0"),
        (3, "ended its process with exit code 3"),
        (-9, "crashed with signal 9 (SIGKILL)"),
        (-1, "crashed with signal 1 (SIGHUP)"),
        (-4000, "crashed with signal 4000"),
    ],
)
def test_exit_statuses_are_described(code: int, told: str) -> None:
    assert describe_end(code) == told


class Inner(Config):
    a: int = 1


class Outer(Config):
    inner: Inner = Inner()
    text: str = ""


def test_wrong_values_are_shown_up_to_200_characters() -> None:
    def told(data: object) -> str:
        with pytest.raises(ConfigError) as refusal:
            Outer.from_data(Path("x.toml"), data)
        return str(refusal.value)

    assert told({"inner": {"b": 1}}) == "x.toml: unknown key 'inner.b'; allowed here: a."
    assert told({"b": 1, "text": 2}) == "x.toml: unknown key 'b'; allowed here: inner, text."
    whole = told({"text": [0] * 66 + [10]})  # 200 + 2 characters, including brackets and commas
    assert len(repr([0] * 66 + [10])) == 202
    assert f"is {repr([0] * 66 + [10])[:200]}...:" in whole
    assert f"is {[0] * 66}: " in told({"text": [0] * 66})
    exact = [0] * 65 + [100]
    assert len(repr(exact)) == 200
    assert f"is {exact}: " in told({"text": exact})


def test_progress_is_reported_in_parts(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    assert list(report_progress("ab", lambda *x: told.append(x))) == ["a", "b"]
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert UNITS_PER_JOB == 100
    tell, path = make_file_progress(tmp_path / "p"), tmp_path / "p"
    tell(0, 7)
    assert not path.exists()
    for done, total, share in ((1, 7, "14"), (3, 7, "42"), (2, 7, "42"), (7, 7, "100")):
        tell(done, total)
        assert path.read_text() == share
    fresh = make_file_progress(tmp_path / "n")
    fresh(0, 0)
    assert not (tmp_path / "n").exists()
    fresh(1, 0)
    assert (tmp_path / "n").read_text() == "100"
    told.clear()
    with watched([path, tmp_path / "other"], lambda *x: told.append(x)):
        pass
    assert (told[0], told[-1]) == ((0, 200), (200, 200))


def test_the_cache_is_cut_to_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The least recently used entries are removed until there is room; locks stay."""
    assert cache.LIMIT == 256 * 1024 * 1024
    shelf = tmp_path / "kind" / "ab"
    shelf.mkdir(parents=True)
    for age, name in enumerate(("lock", "old", "middle", "new")):
        (shelf / name).write_bytes(b"x" * 10)
        os.utime(shelf / name, (age, age))
    for limit, left in ((40, 4), (39, 3), (30, 3), (29, 2), (0, 1)):
        monkeypatch.setattr(cache, "LIMIT", limit)
        cache._prune(tmp_path / "kind")
        assert len(list(shelf.iterdir())) == left, limit
    assert [file.name for file in shelf.iterdir()] == ["lock"]


def test_cache_entries_are_keyed_by_all_inputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made: list[int] = []

    def kept(*inputs: str | bytes, kind: str = "kind") -> bytes:
        return cache.compute_once(
            kind, inputs, lambda: made.append(1) or json.dumps(len(made)).encode()
        )

    assert (kept("ab", "c"), kept("a", "bc"), kept("ab", "c")) == (b"1", b"2", b"1")
    assert (kept(b"ab", b"c"), kept("ab", "c", kind="other")) == (b"1", b"3")
    entries = [p for p in tmp_path.rglob("*") if p.is_file() and p.name != "lock"]
    assert all(p.parent.name == p.name[:2] and p.parents[2] == tmp_path / "hesr" for p in entries)
    for entry in entries:  # all but one have a damaged last byte
        entry.write_bytes(entry.read_bytes()[:-1] + b"x")
    assert kept("ab", "c") == b"4"
