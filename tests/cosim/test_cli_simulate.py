"""hesr simulate: from a system file to a table, through the real command line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from containing import Containing, OneSentence
from small_fmus import LAGS
from small_study import Hesr, contents, hesr_here, hesr_in_a_process

from hesr_model.logs.tables import read_table

Write = Callable[..., Path]


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture
def write(tmp_path: Path, lag_fmu: Path) -> Write:
    """Write the system with some text replaced."""

    def file(old: str = "", new: str = "") -> Path:
        assert old in LAGS
        path = tmp_path / "system.toml"
        text = LAGS.replace(old, new) if old else LAGS
        path.write_text(text.replace("FMU", str(lag_fmu)), encoding="utf-8")
        return path

    return file


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_system_is_simulated_and_written(
    write: Write, tmp_path: Path, hesr: Hesr, suffix: str
) -> None:
    output = tmp_path / "results" / f"lags.{suffix}"
    answer = hesr("simulate", write(), "-o", output)
    assert answer.code == 0, answer.err
    assert answer.out == Containing("11 samples of 2 signals", "= 1 s.\n", f"Written: {output}\n")
    table = read_table(output)
    assert table.names == ("t", "a.y", "b.y")
    t, a, _ = table.numbers(table.names).T
    np.testing.assert_allclose(a, 2.0 - 1.75 * np.exp(-t / 0.5), rtol=1e-12)


def test_the_installed_program_does_the_same(write: Write, tmp_path: Path, hesr: Hesr) -> None:
    system, one, other = write(), tmp_path / "one.csv", tmp_path / "other.csv"
    assert hesr("simulate", system, "-o", one).code == 0
    answer = hesr_in_a_process("simulate", system, "-o", other)
    assert (answer.code, answer.err) == (0, "")
    assert one.read_bytes() == other.read_bytes()


def test_rows_before_a_failure_are_written(write: Write, tmp_path: Path, hesr: Hesr) -> None:
    output = tmp_path / "lags.csv"
    answer = hesr("simulate", write("u = 2.0", "refused = 0.45, u = 2.0"), "-o", output)
    assert answer.code == 2
    assert answer.err == Containing(
        "hesr: Lag.fmu ('a') at t = 0.4 s", "5 samples to t = 0.4 s", f"{output}.\n"
    )
    assert answer.out == ""
    t, a = read_table(output).numbers(["t", "a.y"]).T
    np.testing.assert_allclose(t, 0.1 * np.arange(5), rtol=1e-15)
    np.testing.assert_allclose(a, 2.0 - 1.75 * np.exp(-t / 0.5), rtol=1e-12)


def test_limits_name_time_and_signal(write: Write, tmp_path: Path, hesr: Hesr) -> None:
    output = tmp_path / "lags.csv"
    limited = 'limits = { "a.y" = [0.0, 1.0] }\nstop = 1.0'
    answer = hesr("simulate", write("stop = 1.0", limited), "-o", output)
    assert answer.code == 2
    assert answer.err == Containing("hesr: at t = 0.3 s a.y is 1.03958", "so far, 4 ")
    assert len(read_table(output).numbers(["t"])) == 4


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("stop = 1.0", "stop = 1.05", "the stop time is 1.05 s"),
        ("step = 0.2", "step = 0.15", "step of 'b' is 0.15 s"),
        ('"b.u" = "a.y"', '"b.v" = "a.y"', "{path}: connection 'b.v' = 'a.y': "),
        ('"b.u" = "a.y"', "", "{path}: input 'b.u' is not connected"),
        ("u = 2.0", "w = 2.0", "{path}: start values of 'a': "),
        ('["a.y", "b.y"]', "[]", "{path}: key 'observe' names no signals to wri"),
        ('["a.y", "b.y"]', '["c.y"]', "{path}: observed 'c.y': there is no component 'c'; there a"),
        ('"FMU"', '"Missing.fmu"', "{folder}/Missing.fmu: no such file."),
        ("T = 0.5", "T = -1.0", "Lag.fmu ('a') at t = 0 s: T is -1 s; it must be positive."),
    ],
)
def test_invalid_systems_are_refused(
    write: Write, tmp_path: Path, hesr: Hesr, old: str, new: str, said: str
) -> None:
    path = write(old, new)
    before = contents(tmp_path)
    answer = hesr("simulate", path, "-o", tmp_path / "lags.csv")
    assert answer.code == 2
    assert answer.err == OneSentence("hesr: ", said.format(path=path, folder=tmp_path))
    assert answer.out == ""
    assert contents(tmp_path) == before


def test_a_missing_file_is_reported(tmp_path: Path, hesr: Hesr) -> None:
    path = tmp_path / "system.toml"
    answer = hesr("simulate", path, "-o", tmp_path / "lags.csv")
    assert (answer.code, answer.err) == (2, f"hesr: {path}: no such file.\n")


def test_unwritable_outputs_are_reported(write: Write, tmp_path: Path, hesr: Hesr) -> None:
    answer = hesr("simulate", write(), "-o", tmp_path / "lags.txt")
    assert (answer.code, answer.err) == (
        2,
        Containing(f"hesr: {tmp_path / 'lags.txt'}: results are written"),
    )
    (tmp_path / "lags.csv").mkdir()
    answer = hesr("simulate", write(), "-o", tmp_path / "lags.csv")
    assert answer.code == 2
    assert "lags.csv: cannot be written there" in answer.err


def test_help_names_the_command(hesr: Hesr) -> None:
    assert "simulate" in hesr("--help").out
    assert "SYSTEM  System (.toml" in hesr("simulate", "--help").out
