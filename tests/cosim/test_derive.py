"""Click commands derived from the signature and docstring of a made-up function."""

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import click
import pytest
from click.testing import CliRunner

from hesr.cli.derive import command
from hesr_model.errors import ConfigError

SOURCE = '''
from __future__ import annotations
from typing import Literal

Colour = Literal["red", "blue"]

def paint(
    logs: Logs,
    target: PathArg,
    margin: float = 1.0,
    *,
    count: int = 3,
    ratio: float = 1.0,
    colour: Colour = "red",
    word: str | None = None,
    robot: PathArg | None = None,
    seed: int = 0,
    seeds: int = 1,
    only: int | None = None,
    workers: int | None = None,
    inertia: PerJoint | None = None,
    options: Mapping[str, Any] | None = None,
    accept: Sequence[str] = (),
    weights: Sequence[float] = (),
    dry_run: bool = False,
    output: PathArg | None = None,
    progress: Stages | None = None,
    **more: Unpack[Others],
) -> None:
    """Paint logs.

    Second paragraph of `paint`.

    Parameters
    ----------
    logs : paths
        Logs to paint.
    count : int
        Number of coats,
        from one.
    progress : callable
        Not shown.

    Other Parameters
    ----------------
    word : str
        A ``word``.

    Examples
    --------
    On the command line::

        $ hesr paint a.csv wall --colour red \\\\
          --count 3
        $ hesr paint {long} --dry-run
        $ hesr paint {longer} --dry-run

    >>> paint("a.csv")
    """
'''
# The longest that leaves room for an option on the same line of 75 characters and a margin.
LONG = "x" * 53


def made(monkeypatch: pytest.MonkeyPatch, more: str = "") -> tuple[click.Command, list[Any]]:
    """The command, and the arguments of its function."""
    module = ModuleType("painting")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    text = SOURCE.replace("{longer}", f"{LONG}y").replace("{long}", LONG)
    exec(compile(text + more, "painting.py", "exec"), vars(module))
    calls: list[Any] = []
    return command("paint", vars(module)["paint"], lambda _, given: calls.append(given)), calls


@pytest.fixture
def paint(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Return a function that gives the parsed values of a command line."""
    own, calls = made(monkeypatch)

    def call(*arguments: str) -> dict[str, Any]:
        answer = CliRunner().invoke(own, arguments, standalone_mode=False)
        if answer.exception:
            raise answer.exception
        (given,) = calls
        calls.clear()
        return given

    return call


COMMON = {"fail_on": "error", "quiet": False, "verbose": False, "dry_run": False}


def test_values_not_given_are_left_to_the_function(paint: Callable[..., dict[str, Any]]) -> None:
    assert paint("a.csv", "wall", "2") == COMMON | {
        "logs": ("a.csv",),
        "target": "wall",
        "margin": "2",
    }
    assert paint("a.csv", "b.csv", "wall", "2")["logs"] == ("a.csv", "b.csv")


@pytest.mark.parametrize(
    ("given", "name", "value"),
    [
        (["--count", "4"], "count", 4),
        (["--count", "-4"], "count", -4),
        (["--ratio", "1e-3"], "ratio", 1e-3),
        (["--colour", "blue"], "colour", "blue"),
        (["--word", "7"], "word", "7"),
        (["--seed", "0"], "seed", 0),
        (["--only", "0"], "only", 0),
        (["--seeds", "1"], "seeds", 1),
        (["--workers", "1"], "workers", 1),
        (["--inertia", "3,3,0.6"], "inertia", (3.0, 3.0, 0.6)),
        (["--inertia", "2"], "inertia", (2.0,)),
        (["--option", "a=1", "--option", 'b="x"'], "options", {"a": 1, "b": "x"}),
        (["--option", "a.b=1", "--option", "a.c=2"], "options", {"a": {"b": 1, "c": 2}}),
        (["--option", "a={b=1}", "--option", "a=3"], "options", {"a": 3}),
        (["--accept", "x", "--accept", "y"], "accept", ("x", "y")),
        (["--weights", "1", "--weights", "2.5"], "weights", (1.0, 2.5)),
        (["--dry-run"], "dry_run", True),
        (["-o", "f"], "output", "f"),
        (["--output", "f"], "output", "f"),
        (["--json", "-"], "json_file", "-"),
        (["--fail-on", "never"], "fail_on", "never"),
        (["--quiet"], "quiet", True),
        (["--verbose"], "verbose", True),
    ],
)
def test_options_have_the_types_of_the_parameters(
    paint: Callable[..., dict[str, Any]], given: list[str], name: str, value: object
) -> None:
    found = paint("a.csv", "wall", "2", *given)
    rest = COMMON | {"logs": ("a.csv",), "target": "wall", "margin": "2"}
    assert found == rest | {name: value}
    assert type(found[name]) is type(value)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (["a.csv", "wall", "2", "--seed", "-1"], "--seed"),
        (["a.csv", "wall", "2", "--only", "-1"], "--only"),
        (["a.csv", "wall", "2", "--seeds", "0"], "--seeds"),
        (["a.csv", "wall", "2", "--workers", "0"], "--workers"),
        (["a.csv", "wall", "2", "--colour", "green"], "--colour"),
        (["a.csv", "wall", "2", "--count", "1.5"], "--count"),
        (["a.csv", "wall", "2", "--list"], "--list"),
        ([], "LOG..."),
    ],
)
def test_wrong_usage_is_refused(
    paint: Callable[..., dict[str, Any]], given: list[str], named: str
) -> None:
    with pytest.raises(click.UsageError) as caught:
        paint(*given)
    assert named in caught.value.format_message()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["--inertia", "1,,2"], "--inertia is '1,,2'; expected numbers such as"),
        (["--option", "a"], "--option is 'a'; expected KEY=VALUE in TOML"),
    ],
)
def test_values_of_wrong_form_are_reported(
    paint: Callable[..., dict[str, Any]], given: list[str], sentence: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        paint("a.csv", "wall", "2", *given)
    assert str(caught.value).startswith(sentence)


def test_the_help_has_names_texts_and_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    own, _ = made(monkeypatch)
    monkeypatch.setenv("COLUMNS", "80")
    shown = own.get_help(click.Context(own, info_name="paint", **own.context_settings))
    told = " ".join(shown.split())
    assert told.startswith("Usage: paint [OPTIONS] LOG... TARGET [MARGIN] Paint logs. Second par")
    for text in (
        "of 'paint'.",
        "--count N Number of coats, from one.",
        "--word NAME A --word.",
        "--ratio X",
        "--colour [red|blue]",
        "--robot ROBOT",
        "--inertia X[,X...]",
        "--option KEY=VALUE",
        "--weights X",
        "-o, --output FILE",
        "--accept CHECK",
        "--workers N",
        "--json FILE",
    ):
        assert text in told, text
    for text in ("--progress", "--more", "--list", ">>>"):
        assert text not in told, text
    assert own.short_help == "Paint logs."
    assert shown.rstrip().partition("Examples:\n")[2].splitlines() == [
        "    hesr paint a.csv wall --colour red --count 3",
        f"    hesr paint {LONG} --dry-run",
        f"    hesr paint {LONG}y \\",
        "      --dry-run",
    ]


def test_a_listing_needs_no_argument(monkeypatch: pytest.MonkeyPatch) -> None:
    own, calls = made(monkeypatch, "\ndef listing(): ...\n")
    CliRunner().invoke(own, ["--list"], standalone_mode=False, catch_exceptions=False)
    assert calls == [COMMON | {"listing": True}]
    own, _ = made(monkeypatch, "\ndef listing(): ...\n")
    with pytest.raises(click.UsageError, match="logs"):
        CliRunner().invoke(own, [], standalone_mode=False, catch_exceptions=False)
