"""All checks of one untrusted FMU, in order of dependence; of FMI 1.0 only those without rules."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lxml import etree

from fmu_src.check import (
    archive,
    binaries,
    external,
    general,
    hostile,
    markup,
    paths,
    sources,
    structure,
    terminals,
    variables,
)
from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription, read_description
from hesr_model.errors import ConfigError
from hesr_model.findings import Finding
from hesr_model.support.text import plain, quoted
from hesr_model.support.typed_json import to_json

_MODEL = "modelDescription.xml"
_BUILD = "sources/buildDescription.xml"
_OTHER_XML = (terminals.FILE, _BUILD)

MOST_PROBLEMS = 1000  # per check


@dataclass(frozen=True)
class Report:
    """Findings of all checks in one FMU, and reasons for validators that were not run."""

    path: Path
    problems: tuple[Finding, ...]
    skipped: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """One-line summary."""
        count = len(self.problems)
        return f"{count} problem{'s' if count > 1 else ''} found." if count else "no problem found."

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        return {
            "fmu": str(self.path),
            "problems": [to_json(finding) for finding in self.problems],
            "skipped": list(self.skipped),
        }


def check(path: Path, *, vdmcheck: Path | None = None, hostile: bool = False) -> Report:
    """Check an FMU; `hostile` also runs it under an adverse master.

    Raises ArtifactError if the file is unreadable, ConfigError if VDMCheck2 is not in its folder.
    """
    if vdmcheck is not None and not (vdmcheck / external.JAR).is_file():
        raise ConfigError(f"--vdmcheck is '{vdmcheck}', which does not contain {external.JAR}.")
    with TemporaryDirectory(prefix="hesr-check-") as temporary:
        files, folder = Path(temporary, "files"), Path(temporary, "work")
        files.mkdir()
        folder.mkdir()
        found = _Found(folder, vdmcheck, hostile=hostile)
        found.check(archive.unpack(path, files))
    return Report(path=path, problems=tuple(found.problems), skipped=tuple(found.skipped))


def problems_of(check: str, texts: Iterable[str]) -> list[Finding]:
    """Return the findings of one check, without repetitions and at most `MOST_PROBLEMS`."""
    kept: dict[str, None] = {}
    more = 0
    for text in texts:
        if len(kept) < MOST_PROBLEMS:
            kept[text] = None
        elif text not in kept:
            more += 1
    problems = [Finding(check=check, found=text) for text in kept]
    if more:
        problems.append(Finding(check=check, found=f"{more} more findings are not listed."))
    return problems


class _Found:
    def __init__(self, folder: Path, vdmcheck: Path | None, *, hostile: bool) -> None:
        self._folder = folder
        self._vdmcheck = vdmcheck
        self._hostile = hostile
        self.problems: list[Finding] = []
        self.skipped: list[str] = []

    def _add(self, check: str, texts: Iterable[str]) -> bool:
        problems = problems_of(check, texts)
        self.problems += problems
        return bool(problems)

    def _add_run(self, check: str, found: tuple[list[str], list[str]]) -> None:
        self._add(check, found[0])
        self.skipped += found[1]

    def check(self, contents: Contents) -> None:
        damaged = self._add("archive", contents.problems)
        if not contents.names and damaged:
            self.skipped.append("All other checks: not run; the archive could not be read.")
            return
        self._add("paths", paths.problems(contents))
        self.skipped += paths.skipped(contents)
        root, texts = _model(contents)
        broken = self._add("xml", texts)
        if root is None:
            self.skipped.append(f"All other checks: {_MODEL} could not be read.")
            return
        version = str(root.get("fmiVersion", ""))
        texts = markup.schema_problems(_MODEL, contents.files[_MODEL], self._folder)
        invalid = self._add("schema", texts)
        file = contents.files.get(_BUILD)
        about = read_description(root, markup.parse(_BUILD, file)[0] if file else None)
        if version != "1.0":
            self._check_rules(about, contents)
        else:
            self.skipped.append("Rules, sources and binaries: not checked in FMI 1.0.")
        if damaged or broken or invalid:
            self.skipped.append(
                "FMPy and VDMCheck2: not run; the archive, its XML or the schema is wrong."
            )
        else:
            self._run_others(contents, version)
        if self._hostile and (version != "2.0" or damaged):
            self.skipped.append("Hostile master: not run; it needs FMI 2.0 and a valid archive.")
        elif self._hostile:
            self._add_run("hostile", hostile.problems(about, contents, self._folder))

    def _check_rules(self, about: ParsedDescription, contents: Contents) -> None:
        more = variables.RULES_2 if about.fmi == 2 else variables.RULES_3
        rules = (*general.RULES, *variables.RULES, *structure.RULES, *more)
        self._add("rules", chain.from_iterable(rule(about) for rule in rules))
        if terminals.FILE in contents.files:
            connected, _ = markup.parse(terminals.FILE, contents.files[terminals.FILE])
            if connected is not None:
                self._add("terminals", terminals.problems(connected, about, contents))
        self._add("sources", sources.problems(about, contents))
        self._add("binaries", binaries.problems(about, contents, self._folder))
        self.skipped += binaries.skipped(about, contents)

    def _run_others(self, contents: Contents, version: str) -> None:
        readable = [_MODEL]
        for name in _OTHER_XML:
            if name in contents.files:
                texts = markup.parse(name, contents.files[name])[1]
                if self._add("xml", texts):
                    continue
                texts = markup.schema_problems(name, contents.files[name], self._folder)
                if not self._add("schema", texts):
                    readable.append(name)
        copy = self._folder / "copy.fmu"
        external.write_copy(contents, readable, copy)
        self._add_run("fmpy", external.fmpy(copy, self._folder))
        if version != "2.0":
            self.skipped.append(f"VDMCheck2: it is for FMI 2.0, this is FMI {plain(version)}.")
            return
        self._add_run("vdmcheck2", external.vdmcheck2(copy, self._folder, self._vdmcheck))


def _model(contents: Contents) -> tuple[etree._Element | None, list[str]]:
    if _MODEL not in contents.names:
        elsewhere = next((n for n in contents.names if n.endswith(f"/{_MODEL}")), None)
        hint = f"; {quoted(elsewhere)} is in the wrong folder" if elsewhere else ""
        return None, [f"{_MODEL} is missing{hint}."]
    if _MODEL not in contents.files:
        return None, []
    root, texts = markup.parse(_MODEL, contents.files[_MODEL])
    if root is None:
        return None, texts
    if root.tag != "fmiModelDescription":
        tag = quoted(str(root.tag))
        return None, [*texts, f"{_MODEL}: its root is {tag}; it must be 'fmiModelDescription'."]
    version = root.get("fmiVersion", "")
    if version not in ("1.0", "2.0") and not version.startswith("3."):
        return None, [*texts, f"{_MODEL}: its fmiVersion is {quoted(version)}; expected '2.0'."]
    return root, texts
