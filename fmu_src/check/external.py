"""FMPy and VDMCheck2, run on a copy of the FMU with all files but checked XML emptied."""

import re
import shutil
import zipfile
from collections.abc import Iterable
from pathlib import Path

from fmu_src.check.archive import Contents
from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.rules import Problem
from hesr_model.support.process import DiedError, FailedError, run, tie_command
from hesr_model.support.text import quote_names, sanitise

FMPY_SECONDS = 120.0
VDMCHECK_SECONDS = 300.0
VDMCHECK_VARIABLES = 5000  # it takes quadratic time

JAR = "vdmcheck2.jar"
NO_VDMCHECK = "VDMCheck2: no folder of it is given."
"""Why it was not run, which is said once for all files."""

_MAX_MESSAGE_LENGTH = 1000  # characters of a message: FMPy lists all unknowns in one
_RULE = re.compile(r"(\w+): (.+)")
_SETS = re.compile(r"Expected \{(.*)\} but was \{(.*)\}")
_DISPLAY_UNIT = re.compile(r"The display unit .* of (the )?variable .* is not defined\.")
_LINE = re.compile(r" at \w+\.xml:(\d+)$")


def write_copy(contents: Contents, readable: Iterable[str], path: Path) -> None:
    """Write an archive with the same names and the content of readable files."""
    readable = set(readable)
    with zipfile.ZipFile(path, "w") as archive:
        for name in contents.names:
            data = b""
            if name in readable:
                data = contents.read(name)
            archive.writestr(zipfile.ZipInfo(name), data)


def fmpy(copy: Path, reader: ReaderProcess, fmi: int) -> tuple[list[Problem], list[str]]:
    """Return the problems that FMPy finds in an FMU of FMI 2 or 3, and why it was not run."""
    try:
        messages, failure = reader.run("fmu_src.check.readers:validate", copy, FMPY_SECONDS)
    except DiedError as error:
        return [], [f"FMPy {error}."]
    problems = [(_choose_rule(text, fmi), _add_difference(text)) for text in messages]
    if failure:
        problems = [
            ("fmpy-failed", f"FMPy cannot read the description ({sanitise(failure, 400)}).")
        ]
    return problems, []


def _choose_rule(text: str, fmi: int) -> str:
    """Return the rule of a message; FMI 2 ignores display units that are not defined."""
    if fmi == 2 and _DISPLAY_UNIT.fullmatch(text):
        return "unit-ignored"
    return "fmpy"


def _add_difference(text: str) -> str:
    sentence = _sentence(text)
    sets = _SETS.search(text)
    if not sets:
        return sentence
    expected, actual = (dict.fromkeys(names.split(", ")) for names in sets.groups())
    for verb, candidates, excluded in (
        ("lacks", expected, actual),
        ("must not list", actual, expected),
    ):
        names = [name for name in candidates if name and name not in excluded]
        if names:
            sentence += f" It {verb} {quote_names(names)}."
    return sentence


def vdmcheck2(
    copy: Path, folder: Path, vdmcheck_folder: Path | None, count: int
) -> tuple[list[Problem], list[str]]:
    """Return the problems that VDMCheck2 finds, and why it was not run."""
    if vdmcheck_folder is None:
        return [], [NO_VDMCHECK]
    java = shutil.which("java")
    # A relative path lies in the current folder, whose content may be a stranger's.
    if java is None or not Path(java).is_absolute():
        return [], ["VDMCheck2: Java is not installed."]
    if count > VDMCHECK_VARIABLES:
        text = f"VDMCheck2: it would take too long for {count} variables"
        return [], [f"{text}; at most {VDMCHECK_VARIABLES} are given to it."]
    # Without -v it writes a file into its own folder.
    command = (
        java,
        "-jar",
        str((vdmcheck_folder / JAR).resolve()),
        "-v",
        str(folder / "model.vdm"),
        str(copy),
    )
    try:
        ended = run(tie_command(command), folder, VDMCHECK_SECONDS)
    except FailedError as error:
        return [], [f"VDMCheck2: {sanitise(str(error))}."]
    return _read_verdict(ended.stdout.splitlines())


def _read_verdict(lines: list[str]) -> tuple[list[Problem], list[str]]:
    """Return the problems in the output of VDMCheck2, and why it gave no verdict."""
    if "No errors found." in lines:
        return [], []
    if "Errors found." not in lines:
        first = sanitise(next(iter(lines), "no message"), _MAX_MESSAGE_LENGTH).rstrip(".")
        return [], [f"VDMCheck2: it gave no verdict but said '{first}'."]
    problems = []
    has_date = False
    for line in lines:
        match = _RULE.fullmatch(line)
        if match is None:
            continue
        if match[1] == "validGenerationDateAndTime":
            # FMI 2 only recommends a form of dates: see `date-format`.
            has_date = True
        elif not match[2].startswith(("//", "Warning:")):
            problems.append(_rule(match[1], match[2]))
    if not problems and not has_date:
        problems.append(("vdmcheck2", "it found unnamed errors."))
    return problems, []


def _rule(name: str, text: str) -> Problem:
    line = _LINE.search(text)
    if line is not None:
        text = f"modelDescription.xml, line {line[1]}: {text[: line.start()]}"
    return f"vdmcheck2:{name}", _sentence(text)


def _sentence(text: str) -> str:
    # Further lines are drawings of parsers.
    text = sanitise(next(iter(text.strip().splitlines()), "no message"), _MAX_MESSAGE_LENGTH)
    if text.endswith((".", "!", "?")):
        return text
    return f"{text}."
