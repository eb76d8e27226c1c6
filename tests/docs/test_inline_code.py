"""Inline code of README and docs: its options, files and names exist."""

import csv
import re
import shlex
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import click
from documents import PAGES, ROOT

SOURCES = ("hesr", "cosim", "fmu_src", "hesr_model", "models", "tests", ".ci")
SUFFIXES = {".py", ".pyi", ".c", ".h", ".toml", ".j2", ".js", ".json", ".rs", ".java", ""}

FOREIGN_OPTIONS = {
    "--output-interval",
    "--interface-type",
    "-k",
    "-h",
    "-v7",
    "-O3",
    "-ffp-contract",
}
"""Options of other programs: fmusim, fmuCheck, MATLAB, compilers."""

FOREIGN_NAMES = {
    *("Extras", "Delay", "Interfaces"),  # menus of other tools
    *("oms_importFile", "oms_setVariableStepSize", "libOMSimulator"),
    *("conda", "forge", "twine", "upload", "cuda", "fmucontainer"),
}

GENERATED_NAMES = {"band_floor", "band_slow", "friction_begin", "friction_side_by_side"}
GENERATED_NAMES |= {"thermal_coldest", "thermal_warmest"}
"""Names composed by HESR: parameters, and functions with a prefix."""


def spans(text: str) -> Iterator[str]:
    """Yield the inline code of a page without fenced and indented blocks."""
    text = re.sub(r"(?ms)^```.*?^```$", "", text)
    text = re.sub(r"(?m)^ {4}.*$", "", text)
    for match in re.finditer(r"(?s)(?<!`)`([^`]+)`(?!`)", text):
        yield " ".join(match[1].split())


INLINE = sorted(
    {(page.name, span) for page in PAGES for span in spans(page.read_text(encoding="utf-8"))}
)


@cache
def commands() -> dict[str, set[str]]:
    """Return the options of each command of hesr."""
    from hesr.cli import app

    context = click.Context(app)
    found = {}
    for name in app.list_commands(context):
        command = app.get_command(context, name)
        assert command is not None
        found[name] = {option for parameter in command.params for option in parameter.opts}
    return found


@cache
def sources() -> list[Path]:
    """Return the files of the sources."""
    files = [file for folder in SOURCES for file in (ROOT / folder).rglob("*")]
    return [
        ROOT / "pyproject.toml",
        ROOT / "Makefile",
        *(
            f
            for f in files
            if f.suffix in SUFFIXES and f.is_file() and "__pycache__" not in f.parts
        ),
    ]


@cache
def texts() -> str:
    """Return all sources as one text."""
    return "\n".join(file.read_text(encoding="utf-8", errors="ignore") for file in sources())


@cache
def words() -> set[str]:
    """Return every word of the sources, of their file names, and of blocks on the pages."""
    fenced = (re.findall(r"(?ms)^```.*?^```$", page.read_text(encoding="utf-8")) for page in PAGES)
    names = " ".join(file.stem for file in sources())
    return set(re.findall(r"\w+", " ".join([texts(), names, *(b for one in fenced for b in one)])))


def test_inline_code_is_found() -> None:
    assert len(INLINE) > 300


def test_commands_and_their_options_exist() -> None:
    wrong = []
    for page, span in INLINE:
        if not re.match(r"hesr [a-z]", span):
            continue
        _, name, *rest = shlex.split(span)
        options = {part.partition("=")[0] for part in rest if re.match(r"--?[a-z]", part)}
        unknown = options - commands().get(name, set()) - {"--help"}
        if name not in commands() or unknown:
            wrong.append(f"{page}: `{span}` {sorted(unknown)}")
    assert not wrong, "\n".join(wrong)


def test_options_belong_to_some_command() -> None:
    known = set().union(*commands().values()) | FOREIGN_OPTIONS
    wrong = [
        f"{page}: `{span}`"
        for page, span in INLINE
        if span.startswith("-")
        for option in re.findall(r"(?<!\S)--?[a-zA-Z][\w-]*", span)
        if option not in known
    ]
    assert not wrong, "\n".join(wrong)


def test_files_exist() -> None:
    wrong = [
        f"{page}: `{span}`"
        for page, span in INLINE
        if re.fullmatch(r"(hesr|cosim|fmu_src|hesr_model|models|tests|docs|\.ci)/[\w./-]+", span)
        and not (ROOT / span).exists()
    ]
    assert not wrong, "\n".join(wrong)


def test_dotted_names_can_be_imported() -> None:
    wrong = []
    for page, span in INLINE:
        if not re.fullmatch(r"(hesr|cosim|fmu_src|hesr_model)(\.\w+)+", span):
            continue
        parts = span.split(".")
        for size in range(len(parts), 0, -1):
            try:
                found: object = import_module(".".join(parts[:size]))
            except ModuleNotFoundError:
                continue
            for name in parts[size:]:
                found = getattr(found, name, None)
            break
        else:
            found = None
        if found is None and f'"{span}"' not in texts():
            wrong.append(f"{page}: `{span}`")
    assert not wrong, "\n".join(wrong)


def test_names_occur_in_the_sources() -> None:
    """Detects names that were renamed in the code."""
    known = words() | FOREIGN_NAMES | GENERATED_NAMES
    wrong = [
        f"{page}: `{span}` ({name})"
        for page, span in INLINE
        if page != "data.md"  # which names repositories of others
        for name in re.findall(r"[A-Za-z_]\w{2,}", span)
        if not {name, re.sub(r"^[A-Z]+", "", name)} & known and not name.isupper()
    ]
    assert not wrong, "\n".join(wrong)


def test_the_readme_prints_means_and_worst_joints() -> None:
    with (ROOT / "docs/results_tables/robots.csv").open(encoding="utf-8") as file:
        _, *rows = csv.reader(file)
    ratios: dict[str, list[list[str]]] = {}
    for group, joint, *cells in rows:
        ratios.setdefault(group, []).append([joint, *cells[2:]])
    expected = []
    for group_rows in ratios.values():
        (_, *means), *joint_rows = group_rows
        cells: list[str] = []
        for mean, *values in zip(means, *(row[1:] for row in joint_rows), strict=True):
            worst = max((float(value) for value in values if value), default=0.0)
            cells.append(f"{float(mean):.2f} ({worst:.2f})" if mean else "–")
        expected.append(cells)
    table = (ROOT / "README.md").read_text(encoding="utf-8").split("| robot | recommended |")[1]
    lines = table.splitlines()[2 : 2 + len(expected)]
    assert [line.strip("| ").split(" | ")[2:] for line in lines] == expected
