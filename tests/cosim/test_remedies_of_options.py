"""Options and commands that refusals print are executed as printed: the refusals go away."""

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click
import pytest
from documents import ROOT
from small_study import Hesr, hesr_here

from hesr.cli import app
from hesr.cli.console import MOVED_VERBS

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
# Options after these words are the remedy; those before them are what is refused.
REMEDY = re.compile(r"\b(?:needs?|give|use|requires?)\b")


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """A command that is refused, and what a user has at hand for the options that it prints.

    Attributes
    ----------
    arguments : of the refused command; `{}` stands for the folder of the bench.
    values : values by option, which are added where the refusal prints the option.
    omitted : options of the refused command that the refusal excludes.
    """

    arguments: str
    values: dict[str, str] = field(default_factory=dict)
    omitted: Sequence[str] = ()


OPTIONS = {"options": "--option"} | {
    name: f"--{name.replace('_', '-')}"
    for name in (
        "robot", "write", "study", "joints", "torque_constants", "law", "prior", "add", "on",
        "kind", "rigid_body", "format", "inertia", "bench", "gravity", "log", "calibration", "kv",
    )
}  # fmt: skip
"""Options of the parameters that refusals name."""

REFUSALS = {
    "give 'robot' to read this log": Refusal(
        arguments="identify {}/run.csv", values={"--robot": "{}/robot.toml"}
    ),
    "'write' needs 'robot'": Refusal(
        arguments="inspect {}/run.csv --write {}/new.toml", values={"--robot": "{}/robot.toml"}
    ),
    "'study' needs 'write'": Refusal(
        arguments="inspect {}/run.csv --robot {}/robot.toml --study {}/study.toml",
        values={"--write": "{}/new.toml"},
    ),
    "'joints' needs 'robot'": Refusal(
        arguments="inspect {}/run.csv --joints motor", values={"--robot": "{}/robot.toml"}
    ),
    "need 'torque_constants'": Refusal(
        arguments="inspect {}/run.csv {}/second.csv --robot {}/robot.toml --mass-error 0.1",
        values={"--torque-constants": ""},
    ),
    "need logs; without logs give 'robot'": Refusal(
        arguments="inspect --torque-constants",
        values={"--robot": "{}/robot.toml"},
        omitted=("--torque-constants",),
    ),
    "give either 'law' or 'prior'": Refusal(
        arguments="fit {}/run.csv --robot {}/robot.toml -o {}/c.json",
        values={"--law": "coulomb_viscous"},
    ),
    "give 'add', and no 'options'": Refusal(
        arguments="fit {}/warming.csv --robot {}/robot.toml --law {}/lugre.json --option a=1 "
        "-o {}/c.json",
        values={"--add": "temperature"},
        omitted=("--option a=1",),
    ),
    "prediction needs 'on'": Refusal(
        arguments="test {}/law.json --kind prediction --robot {}/robot.toml "
        "--rigid-body {}/body.json",
        values={"--on": "{}/run.csv"},
    ),
    "prediction needs 'rigid_body'": Refusal(
        arguments="test {}/law.json --kind prediction --robot {}/robot.toml --on {}/run.csv",
        values={"--rigid-body": "{}/body.json"},
    ),
    "drive needs 'inertia'": Refusal(
        arguments="export {}/law.json -o {}/drive.fmu --format drive",
        values={"--inertia": "0.01"},
    ),
    "no elastic gears": Refusal(
        arguments="export {}/law.json -o {}/drive.fmu --format drive --rigid-body {}/body.json",
        values={"--inertia": "0.01"},
        omitted=("--rigid-body {}/body.json",),
    ),
    "has no band; give 'calibration'": Refusal(
        arguments="export {}/bare.json -o {}/observer.fmu --format observer "
        "--robot {}/robot.toml --rigid-body {}/body.json",
        values={"--calibration": "{}/second.csv"},
    ),
    "needs 'kv'": Refusal(
        arguments="export {}/law.json -o {}/plant.fmu --format plant --robot {}/robot.toml "
        "--rigid-body {}/body.json --ki 10",
        values={"--kv": "20"},
    ),
    "needs 'format'": Refusal(
        arguments="export {}/law.json -o {}/x.fmu --inertia 0.01", values={"--format": "drive"}
    ),
    "needs 'bench'": Refusal(arguments="new {}/fresh --inertia 0.01", values={"--bench": "rotary"}),
    "a rotary bench; use 'gravity'": Refusal(
        arguments="new {}/fresh --bench sliding --moment 1 --phase 0",
        values={"--gravity": ""},
        omitted=("--moment 1 --phase 0",),
    ),
    "needs 'torque_per_ampere' in 'log'": Refusal(
        arguments="new {}/fresh --bench rotary --source measured",
        values={"--log": "torque_per_ampere=0.11"},
    ),
}


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.mark.parametrize("words", REFUSALS)
def test_an_option_that_a_refusal_prints_makes_it_go_away(
    words: str, rotary_bench: Path, run: Hesr, tmp_path: Path
) -> None:
    folder = shutil.copytree(rotary_bench, tmp_path / "bench")
    refusal = REFUSALS[words]
    arguments = fill(refusal.arguments, folder)
    answer = run(*arguments)
    assert answer.code == 2
    assert to_options(words) in answer.err, answer.err
    for option, value in read_remedy(answer.err, refusal.values).items():
        arguments += [option, *fill(value, folder)]
    for omitted in refusal.omitted:
        arguments = remove_words(arguments, fill(omitted, folder))
    after = run(*arguments)
    assert after.code == 0, (arguments, after.err)


def fill(text: str, folder: Path) -> list[str]:
    return [word.replace("{}", str(folder)) for word in text.split()]


def to_options(words: str) -> str:
    """Return words of the product as the command line prints them."""
    return re.sub(r"'(\w+)'", lambda name: OPTIONS.get(name[1], name[0]), words)


def read_remedy(sentence: str, values: dict[str, str]) -> dict[str, str]:
    """Return the options that a refusal says to give, with the values at hand."""
    start = REMEDY.search(sentence)
    assert start, sentence
    printed = OPTION.findall(sentence[start.end() :])
    remedy = {option: values[option] for option in printed if option in values}
    assert remedy.keys() == values.keys(), f"{sentence} prints {printed}"
    return remedy


def remove_words(arguments: list[str], omitted: list[str]) -> list[str]:
    for k in range(len(arguments)):
        if arguments[k : k + len(omitted)] == omitted:
            return arguments[:k] + arguments[k + len(omitted) :]
    raise AssertionError(omitted)


PLACEHOLDERS = {
    "LAW...": "law.json",
    "LOG...": "run.csv",
    "LOG": "run.csv",
    "X.fmu": "Friction.fmu",
    "X.fmu...": "Friction.fmu",
    "ROBOT": "robot.toml",
    "SWEEP.toml": "robot.toml",
    "SYSTEM.toml": "robot.toml",
    "FLEET.toml": "robot.toml",
    "RESULT...": ".",
    "RESULT": ".",
    "RUN": "3",
    "FOLDER": "new",
}
"""Files of the bench, or other values, for the words in capitals."""


@pytest.mark.parametrize("verb", MOVED_VERBS)
def test_the_new_form_of_a_verb_is_a_command(
    verb: str, rotary_bench: Path, run: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(rotary_bench)
    _, _, forms = run(verb).err.strip().rstrip(".").partition(" is now: ")
    first_form, *endings = forms.split(", or ")
    if first_form.startswith("make "):
        target = re.match(r"make (\w+)", first_form)
        assert target
        assert f"\n{target[1]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")
        return
    command_line = re.match(r"[\w .<>-]+", first_form)
    assert command_line
    _, name, *words = command_line[0].split()
    parse(name, words)
    for ending in endings:
        options, _, _ = ending.partition(" for ")
        source = [word for word in words if not word.startswith("-")][:1]
        parse(name, [*source, *options.split()])


def parse(name: str, words: Sequence[str]) -> None:
    """Parse a command as the command line does; an unknown option or argument is an error."""
    context = click.Context(app, info_name="hesr")
    command = app.get_command(context, name)
    assert command, name
    arguments = [PLACEHOLDERS.get(word, word) for word in words]
    command.make_context(name, arguments, parent=context)
