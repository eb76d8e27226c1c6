"""Commands and options that sentences print exist: those who follow a remedy are not refused."""

import re
from functools import cache

import click
import pytest
from sentences import sentences

from hesr.cli.app import app

pytestmark = pytest.mark.ci  # imports every command

# Options of tools of others, which sentences of HESR name as well.
FOREIGN = {"--editable"}


@cache
def options_of_commands() -> dict[str, set[str]]:
    context = click.Context(app)
    options: dict[str, set[str]] = {}
    for verb in app.list_commands(context):
        command = app.get_command(context, verb)
        assert command is not None
        options[verb] = {
            name
            for parameter in command.params
            if isinstance(parameter, click.Option)
            for name in (*parameter.opts, *parameter.secondary_opts)
        }
    return options


def printed() -> list[str]:
    return sorted(
        {text for modules in sentences().values() for own in modules.values() for text in own}
    )


def test_printed_commands_exist() -> None:
    quoted = {verb for text in printed() for verb in re.findall(r"'hesr ([a-z]+)", text)}
    assert {"inspect", "run"} <= quoted
    assert quoted - set(options_of_commands()) == set()


def test_printed_options_exist() -> None:
    every_option = set().union(*options_of_commands().values())
    options = {
        option: text
        for text in printed()
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)
    }
    assert len(options) > 10  # other sentences name parameters, which become options
    unknown = {o: text for o, text in options.items() if o not in every_option | FOREIGN}
    assert unknown == {}


def test_options_next_to_a_command_are_its_own() -> None:
    wrong = [
        (verb, option, text)
        for text in printed()
        for verb, rest in re.findall(r"'hesr ([a-z]+)\b([^']*)'", text)
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest)
        if option not in options_of_commands().get(verb, set())
    ]
    assert wrong == []
