"""Output, errors and signals of commands, without a command."""

import errno
import logging
import os
import signal
import sys
import time
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import TextIO

import click
import pytest
from containing import OneSentence
from processes import HANG

from hesr.cli.console import (
    _Ended,
    accept_any_text,
    direct_output,
    interrupt_on_signals,
    provide_answer_file,
    provide_home,
    refuse,
    report_errors,
    require_environment,
    show_progress,
)
from hesr_model.errors import ConfigError
from hesr_model.support.progress import Interrupted
from hesr_model.support.typed_files import write_json

Capture = pytest.CaptureFixture[str]


def answer(json_file: Path, data: dict[str, int], output: TextIO | None = None) -> None:
    with provide_answer_file(json_file, output) as file:
        assert file is not None
        write_json(file, data)


# --- quiet, verbose and JSON ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("quiet", "verbose", "levels"),
    [
        (True, False, ["ERROR"]),
        (False, False, ["WARNING", "ERROR"]),
        (False, True, ["DEBUG", "INFO", "WARNING", "ERROR"]),
    ],
)
def test_verbosity_decides_what_is_printed_and_logged(
    quiet: bool, verbose: bool, levels: list[str], capsys: Capture
) -> None:
    log = logging.getLogger("cosim.made_up")
    parent = logging.getLogger("cosim")
    level_before = parent.level
    with direct_output(quiet=quiet, verbose=verbose, json_file=None):
        click.echo("result")
        for level in ("DEBUG", "INFO", "WARNING", "ERROR"):
            log.log(logging.getLevelName(level), "as %s", level)
    log.error("afterwards")
    assert parent.level == level_before
    said = capsys.readouterr()
    assert said.out == ("" if quiet else "result\n")
    lines = said.err.splitlines()
    assert [line.rpartition(" ")[2] for line in lines] == levels
    assert all(line.startswith("hesr: as ") for line in lines) is not verbose


def test_quiet_and_verbose_exclude_each_other() -> None:
    with (
        pytest.raises(ConfigError, match="--quiet and --verbose are contradictory"),
        direct_output(quiet=True, verbose=True, json_file=None),
    ):
        pytest.fail("the block runs")


@pytest.mark.parametrize("quiet", [False, True])
def test_json_is_the_only_standard_output(quiet: bool, capsys: Capture) -> None:
    with direct_output(quiet=quiet, verbose=False, json_file=Path("-")) as output:
        click.echo("summary")
        answer(Path("-"), {"a": 1}, output)
    assert capsys.readouterr().out == ("" if quiet else '{\n  "a": 1\n}\n')


def test_a_failed_command_writes_no_json(tmp_path: Path, capsys: Capture) -> None:
    def fail(file: Path) -> None:
        with provide_answer_file(file, sys.stdout) as wanted:
            assert wanted
            wanted.write_text("half")
            raise KeyError

    for file in (Path("-"), tmp_path / "a.json"):
        with pytest.raises(KeyError):
            fail(file)
    assert capsys.readouterr().out == ""
    assert list(tmp_path.iterdir()) == []
    with provide_answer_file(None, None) as wanted:
        assert wanted is None
    answer(tmp_path / "b.json", {"b": 2})
    assert (tmp_path / "b.json").read_text() == '{\n  "b": 2\n}\n'


def test_progress_is_logged_with_verbose(capsys: Capture) -> None:
    for verbose in (True, False):
        with (
            direct_output(quiet=False, verbose=verbose, json_file=None),
            show_progress(is_hidden=verbose) as progress,
        ):
            for done in (0, 1):
                progress("fitting", done, 2)
        said = capsys.readouterr()
        assert said.out == ""
        told = [line.rpartition("console: ")[2] for line in said.err.splitlines()]
        assert told == (["fitting: 0 of 2", "fitting: 1 of 2"] if verbose else [])


# --- interrupts -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interrupt", "code", "sentence"),
    [
        (KeyboardInterrupt(), 130, "interrupted; no file is half-written."),
        (_Ended(), 143, "file is half-written"),
        (
            Interrupted("3 laws are kept", KeyboardInterrupt()),
            130,
            "interrupted; no file is half-written, and 3 laws are kept.",
        ),
        (
            Interrupted("3 laws are kept", _Ended()),
            143,
            "half-written, and 3 laws are kept",
        ),
    ],
)
def test_an_interrupt_is_one_sentence(
    interrupt: KeyboardInterrupt, code: int, sentence: str, capsys: Capture
) -> None:
    with (
        pytest.raises(click.exceptions.Exit) as ended,
        direct_output(quiet=True, verbose=False, json_file=None),
    ):
        raise interrupt
    assert ended.value.exit_code == code
    assert capsys.readouterr().err == OneSentence("hesr: ", sentence)


def send(number: int) -> None:
    os.kill(os.getpid(), number)


def handlers() -> list[object]:
    return [signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM), sys.unraisablehook]


@pytest.mark.parametrize(
    ("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, _Ended)]
)
def test_signals_end_a_command_once(number: int, kind: type[BaseException]) -> None:
    before = handlers()
    cleaned = []

    @interrupt_on_signals()
    def work() -> None:
        try:
            send(number)
            pytest.fail("the command goes on")
        finally:
            send(number)  # does not disturb the clean-up
            cleaned.append(True)

    with pytest.raises(kind) as ended:
        work()
    assert ended.type is kind
    assert cleaned
    assert handlers() == before


def test_an_ignored_interrupt_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupt_on_signals():
            send(signal.SIGINT)
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            with pytest.raises(_Ended):
                send(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGINT, before)


class Dropping:
    """Python drops an exception that is raised while it deallocates this object."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __del__(self) -> None:
        send(self.number)


@pytest.mark.parametrize(
    ("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, _Ended)]
)
def test_a_dropped_interrupt_is_raised_again(number: int, kind: type[BaseException]) -> None:
    waited = []

    @interrupt_on_signals()
    def work() -> None:
        Dropping(number)
        begin = time.monotonic()
        try:
            time.sleep(600.0)
        finally:
            waited.append(time.monotonic() - begin)

    with pytest.raises(kind) as ended:
        work()
    assert ended.type is kind
    assert waited[0] < HANG


# --- errors -----------------------------------------------------------------------------------

FULL = OSError(errno.ENOSPC, "No space left\n on device.", "some/file")


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (ConfigError("key 'a' is missing."), "key 'a' is missing."),
        (FULL, "some/file: the system reports an error (No space left on device)."),
        (OSError("odd"), "the system reports an error (odd)."),
        (MemoryError(), "give less data at once"),
        (RecursionError(), "input file is nested too deeply"),
    ],
)
def test_errors_are_one_sentence_and_exit_with_2(
    error: Exception, sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended, report_errors():
        raise error
    assert ended.value.code == 2
    assert capfd.readouterr().err == OneSentence("hesr: ", sentence)


def test_a_closed_output_ends_with_1(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, report_errors():
        raise BrokenPipeError
    assert ended.value.code == 1
    assert capfd.readouterr().err == ""
    with pytest.raises(ZeroDivisionError), report_errors():
        raise ZeroDivisionError  # bugs keep their traceback


def test_long_sentences_are_cut(capfd: pytest.CaptureFixture[str]) -> None:
    for length, shown in ((4000, "x" * 4000), (4001, f"{'x' * 4000}...")):
        with pytest.raises(SystemExit) as ended:
            refuse("x" * length)
        assert ended.value.code == 2
        assert capfd.readouterr().err == f"hesr: {shown}\n"


def test_text_is_plain_where_the_output_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    written = {}
    for encoding in ("ascii", "utf-8"):
        raw = BytesIO()
        monkeypatch.setattr(sys, "stdout", TextIOWrapper(raw, encoding=encoding))
        accept_any_text()
        print("✓ 3–4 · “a” µm 字", end="", flush=True)  # noqa: T201
        written[encoding] = raw.getvalue().decode("utf-8")
    assert written == {"ascii": '+ 3-4 . "a" um ?', "utf-8": "✓ 3–4 · “a” µm 字"}


def test_matplotlib_gets_a_folder_only_if_home_is_not_writable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, empty_cache: Path
) -> None:
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    provide_home()
    assert "MPLCONFIGDIR" not in os.environ
    monkeypatch.setenv("HOME", str(tmp_path / "none"))
    provide_home()
    assert os.environ["MPLCONFIGDIR"] == str(empty_cache / "matplotlib")
    monkeypatch.delenv("MPLCONFIGDIR")


@pytest.mark.skipif(os.name != "posix", reason="limits of processes are those of POSIX")
@pytest.mark.parametrize(
    ("limited", "least", "sentence"),
    [
        ("RLIMIT_AS", 1 << 30, "memory is 300 MB; at least 1073 MB"),
        ("RLIMIT_NOFILE", 64, "open files is 63; at least 64"),
    ],
)
def test_small_limits_are_named(
    limited: str, least: int, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource

    limits = {getattr(resource, limited): min(300_000_000, least - 1)}
    infinite = resource.RLIM_INFINITY
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (limits.get(kind, infinite),) * 2)
    with pytest.raises(ConfigError, match=sentence):
        require_environment()
    limits[getattr(resource, limited)] = least
    require_environment()


@pytest.mark.parametrize("date", ["x", "-1", "1.5", "\u0663", "9" * 12])
def test_dates_are_whole_seconds(date: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", date)
    with pytest.raises(ConfigError) as caught:
        require_environment()
    sentence = f"'{date}'; expected whole seconds since 1970"
    assert str(caught.value) == OneSentence(sentence)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1760000000")
    require_environment()
