"""Help of the command line: examples, exit codes, completion and start-up time."""

import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import click
import pytest
from documents import ROOT
from small_study import Hesr, hesr_here

from hesr.cli import app
from hesr.cli.console import MOVED_VERBS

CONTEXT = click.Context(app, info_name="hesr")
COMMANDS = {name: app.get_command(CONTEXT, name) for name in app.list_commands(CONTEXT)}
HEAVY = {"numpy", "scipy", "sympy", "mujoco", "matplotlib", "fmpy", "pinocchio", "pyarrow", "rich"}


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def examples(help_text: str) -> list[list[str]]:
    """Commands below "Example:", split as by the shell."""
    _, _, below = re.split(r"\n  (Examples?):\n", help_text)
    lines = re.sub(r" \\\n\s+", " ", below).splitlines()
    return [shlex.split(line) for line in lines if line.strip()]


def asked_for_help(hesr: Hesr, monkeypatch: pytest.MonkeyPatch, *command: str) -> str:
    monkeypatch.setenv("COLUMNS", "80")
    answer = hesr(*command, "--help")
    assert answer.code == 0
    return answer.out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_valid_example(
    name: str, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = examples(asked_for_help(hesr, monkeypatch, name))
    assert shown
    for program, command, *arguments in shown:
        assert (program, command) == ("hesr", name)
        # Fails for an unknown option, an invalid value or a missing argument.
        with COMMANDS[name].make_context(name, list(arguments)) as context:
            assert any(context.params.values()) or not arguments


def test_an_example_with_an_unknown_option_is_detected() -> None:
    """Guards the test above against passing vacuously."""
    with pytest.raises(Exception, match="no-such-option"):
        COMMANDS["fit"].make_context("fit", ["a.csv", "--no-such-option"])


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_fits_80_columns(name: str, hesr: Hesr, monkeypatch: pytest.MonkeyPatch) -> None:
    text = asked_for_help(hesr, monkeypatch, *([name] if name else []))
    assert max(map(len, text.splitlines())) <= 80
    assert not re.search(r"--[a-z-]+ <list", text)  # Python types mean nothing to users
    assert "[[" not in text


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_can_be_quiet_and_verbose(
    name: str, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = asked_for_help(hesr, monkeypatch, name)
    assert re.search(r"\n  --quiet +Print errors only\.", text)
    assert re.search(r"\n  --verbose +Log to standard error,", text)


def test_the_overview_has_full_sentences_in_order_of_use(
    hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = asked_for_help(hesr, monkeypatch)
    listed = re.findall(r"^  ([a-z]+)  +(\S.*)$", text.partition("Commands:")[2], re.MULTILINE)
    assert {name for name, _ in listed} == set(COMMANDS)
    assert all(told.endswith(".") and not told.endswith("..") for _, told in listed), listed
    assert [name for name, _ in listed][:2] == ["new", "inspect"]


def test_exit_codes_are_documented(hesr: Hesr, monkeypatch: pytest.MonkeyPatch) -> None:
    text = asked_for_help(hesr, monkeypatch)
    assert re.findall(r"^    (\d+) ", text.partition("Exit codes:")[2], re.MULTILINE) == [
        *("0", "1", "2", "130"),
    ]
    assert "143: ended by another program" in text


def test_version_is_printed(hesr: Hesr) -> None:
    answer = hesr("--version")
    assert (answer.code, answer.out, answer.err) == (0, f"hesr {version('hesr')}\n", "")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["fit", "--help"], ["no-such"]])
def test_help_imports_no_heavy_modules(arguments: list[str]) -> None:
    program = (
        "import sys, contextlib\nfrom hesr.cli import main\n"
        "with contextlib.suppress(SystemExit):\n    main()\n"
        "print('LOADED', *sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True
    )
    loaded = result.stdout.splitlines()[-1].split()
    assert loaded[0] == "LOADED"
    assert not HEAVY & set(loaded)


# --- completion -------------------------------------------------------------------------------

HESR = Path(sys.executable).with_name("hesr")
installed = pytest.mark.skipif(not HESR.is_file(), reason="hesr is not installed as a command")


def ask(**variables: str) -> str:
    result = subprocess.run(
        [HESR], capture_output=True, text=True, env=os.environ | variables, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@installed
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_gets_its_completion(shell: str) -> None:
    assert "_HESR_COMPLETE" in ask(_HESR_COMPLETE=f"{shell}_source")


@installed
@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("ide", "identify"),
        ("run --qu", "--quick --quiet"),
        ("export x --fo", "--format"),
        ("export x --format d", "drive"),
        ("fit --la", "--law"),
        ("fit --law parfam_", "parfam_h parfam_hx parfam_s parfam_s_load parfam_s_v parfam_v"),
        ("export x --platform lin", "linux64"),
    ],
)
def test_bash_completes(typed: str, completed: str) -> None:
    words = ask(
        _HESR_COMPLETE="bash_complete",
        COMP_WORDS=f"hesr {typed}",
        COMP_CWORD=str(len(typed.split())),
    )
    assert [line.partition(",")[2] for line in words.splitlines()] == completed.split()


@installed
@pytest.mark.skipif(not Path("/bin/bash").is_file(), reason="there is no bash")
def test_the_line_of_the_readme_switches_completion_on() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    [line] = re.findall(r"(?m)^ {4}(eval .*bash_source.*)$", readme)
    program = (
        f"PATH={HESR.parent}:$PATH\n"
        f"{line}\n"
        "COMP_WORDS=(hesr ide) COMP_CWORD=1\n"
        '_hesr_completion hesr\necho "${COMPREPLY[@]}"'
    )
    result = subprocess.run(
        ["/bin/bash", "-c", program], capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == ["identify"]


# --- verbs of earlier versions ----------------------------------------------------------------


@pytest.mark.parametrize("verb", MOVED_VERBS)
def test_an_old_verb_prints_its_new_form(verb: str, hesr: Hesr) -> None:
    answer = hesr(verb, "some", "--option", "x")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"hesr: {MOVED_VERBS[verb]}\n"
    new = re.search(r"hesr (\w+)", MOVED_VERBS[verb].partition(": ")[2])
    assert new is None or new[1] in COMMANDS
