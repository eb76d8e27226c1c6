"""All checks of one untrusted FMU, in order of dependence."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from lxml import etree

from fmu_src.check import archive, binaries, external, rules, sources
from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription, read_description
from fmu_src.check.description_rules import RULES, RULES_2, RULES_3, TERMINALS, terminal_problems
from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.rules import Problem
from fmu_src.export.record import MEMBER
from hesr_model.errors import ArgumentError
from hesr_model.findings import SEVERITIES, Finding, sort_by_severity
from hesr_model.support import plugins
from hesr_model.support.files import scratch_folder
from hesr_model.support.text import count_noun, quote, sanitise

_MODEL = "modelDescription.xml"
_BUILD = "sources/buildDescription.xml"
_FILE_GROUPS = ("archive", "xml", "fmi", "xsd", "machine")
"""First words of the rules that are applied to each file."""
_DESCRIPTION_GROUPS = {
    *("kind", "token", "date", "experiment", "unit", "type", "category", "variable", "alias"),
    *("structure", "source", "binary"),
}
"""First words of the rules that need a description of FMI 2 or 3."""
_OTHER_XML = (TERMINALS, _BUILD)


@dataclass(frozen=True)
class Report:
    """Findings of all checks in one FMU, and reasons for validators that were not run.

    `platforms` are those that have a binary; for an SSP, those that all its FMUs share. None if
    the archive has no FMU. `record` says that an FMU or SSP of HESR is as it was exported.
    """

    path: Path
    problems: tuple[Finding, ...]
    skipped: tuple[str, ...]
    platforms: tuple[str, ...] | None = None
    record: str = ""
    rule_count: int = 0  # of the rules that were applied; 0 if unknown

    @property
    def coverage(self) -> str:
        """Platforms that have a binary, and operating systems that have none; "" if unknown."""
        if self.platforms is None:
            return ""
        if not self.platforms and self.path.suffix.lower() == ".ssp":
            return "none that all its FMUs share."
        if not self.platforms:
            return "none."
        coverage = ", ".join(self.platforms)
        missing = binaries.missing_systems(self.platforms)
        if missing:
            coverage += f"; no binary for tools on {' and '.join(missing)}"
        return f"{coverage}."

    @property
    def verdict(self) -> str:
        """One-line summary."""
        counts = Counter(finding.severity for finding in self.problems)
        count_texts = [
            _count_findings(counts[severity], severity)
            for severity in SEVERITIES
            if counts[severity]
        ]
        if count_texts:
            return f"{', '.join(count_texts)}."
        if self.rule_count:
            return f"passed, no finding of {self.rule_count} rules."
        return "passed, no finding."

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        from hesr_model.support.typed_files import to_json  # slow to import

        return {
            "fmu": str(self.path),
            "problems": [to_json(finding) for finding in self.problems],
            "skipped": list(self.skipped),
            "platforms": list(self.platforms or ()),
            "record": self.record,
        }


def _count_findings(count: int, severity: str) -> str:
    if severity == "advice":
        return f"{count} advice"
    return count_noun(count, severity)


def check(path: Path, *, vdmcheck: Path | None = None, kinds: Iterable[str] = ()) -> Report:
    """Check an FMU, also by the plug-ins `kinds`.

    Raises ArtifactError if the file is unreadable, ConfigError if VDMCheck2 is not in its folder.
    """
    if vdmcheck is not None and not (vdmcheck / external.JAR).is_file():
        raise ArgumentError(f"'vdmcheck' is '{vdmcheck}', which does not contain {external.JAR}.")
    with scratch_folder() as temporary:
        files = Path(temporary, "files")
        folder = Path(temporary, "work")
        files.mkdir()
        folder.mkdir()
        contents = archive.unpack(path, files)
        with ReaderProcess(folder, files, folder) as reader:
            check_run = _CheckRun(folder, reader, vdmcheck, kinds)
            check_run.check(contents)
    platforms = None
    if _MODEL in contents.names:
        platforms = binaries.platforms(contents)
    return Report(
        path=path,
        problems=tuple(sort_by_severity(check_run.problems)),
        skipped=tuple(check_run.skipped),
        platforms=platforms,
        record=check_run.record,
        rule_count=check_run.count_rules(),
    )


class _CheckRun:
    """Findings and skipped validators of the checks of one FMU."""

    def __init__(
        self, folder: Path, reader: ReaderProcess, vdmcheck: Path | None, kinds: Iterable[str]
    ) -> None:
        self._folder = folder
        self._reader = reader
        self._vdmcheck = vdmcheck
        self._kinds = kinds
        self.problems: list[Finding] = []
        self.skipped: list[str] = []
        self.record = ""
        self._groups: set[str] = set()  # of rules, beyond those of all files

    def _add(self, problems: Iterable[Problem]) -> bool:
        """Add findings; return whether one is an error."""
        findings = rules.findings(problems)
        self.problems += findings
        return any(finding.severity == "error" for finding in findings)

    def _add_run(self, outcome: tuple[list[Problem], list[str]]) -> None:
        self._add(outcome[0])
        self.skipped += outcome[1]

    def check(self, contents: Contents) -> None:
        damaged = self._add(contents.problems)
        if not contents.names and contents.problems:
            self.skipped.append("All other checks: not run; the archive could not be read.")
            return
        root, texts = _model(contents)
        if root is not None and root.get("fmiVersion") == "1.0":
            text = f"{_MODEL}: FMI 1.0 is not checked; ask its tool for FMI 2.0 or 3.0."
            self._add([("fmi-version", text)])
            return
        changes = list(archive.compare_with_record(contents))
        self._add(changes)
        if MEMBER in contents.files and not changes:
            self.record = archive.UNCHANGED
        self._add(sources.machine_paths(contents))
        self.skipped += sources.find_skipped_libraries(contents)
        broken = self._add(texts)
        if root is None:
            self.skipped.append(f"All other checks: {_MODEL} could not be read.")
            return
        version = str(root.get("fmiVersion", ""))
        invalid = self._add(archive.schema_problems(_MODEL, contents.files[_MODEL], self._reader))
        model_description = read_description(root, _read_build(contents))
        self._check_rules(model_description, contents)
        if damaged or broken or invalid:
            self.skipped.append(
                "FMPy and VDMCheck2: not run; the archive, its XML or the schema is wrong."
            )
        else:
            self._run_validators(contents, model_description, version)
        for kind in self._kinds:
            check_kind = plugins.find("hesr.checks", kind)
            self._add_run(check_kind(model_description, contents, self._folder))

    def count_rules(self) -> int:
        """Return the number of rules that were applied."""
        groups = {*_FILE_GROUPS, *self._kinds, *self._groups}
        return sum(name.partition("-")[0] in groups for name in rules.RULES)

    def _check_rules(self, model_description: ParsedDescription, contents: Contents) -> None:
        self._groups |= _DESCRIPTION_GROUPS
        rules_of_version = {2: RULES_2, 3: RULES_3}[model_description.fmi]
        applied_rules = (*RULES, *rules_of_version)
        self._add(chain.from_iterable(rule(model_description) for rule in applied_rules))
        if TERMINALS in contents.files:
            connected, _ = archive.parse(TERMINALS, contents.files[TERMINALS])
            if connected is not None:
                self._groups.add("terminal")
                self._add(terminal_problems(connected, model_description, contents))
        self._add(sources.problems(model_description, contents))
        self._add(binaries.problems(model_description, contents, self._reader))
        self.skipped += binaries.describe_unknown_platforms(model_description, contents)

    def _run_validators(
        self, contents: Contents, model_description: ParsedDescription, version: str
    ) -> None:
        readable = [_MODEL]
        for name in _OTHER_XML:
            if name in contents.files:
                texts = archive.parse(name, contents.files[name])[1]
                if self._add(texts):
                    continue
                texts = archive.schema_problems(name, contents.files[name], self._reader)
                if not self._add(texts):
                    readable.append(name)
        copy = self._folder / "copy.fmu"
        external.write_copy(contents, readable, copy)
        self._add_run(external.fmpy(copy, self._reader, model_description.fmi))
        self._groups.add("fmpy")
        if version != "2.0":
            self.skipped.append(f"VDMCheck2: it is for FMI 2.0, this is FMI {sanitise(version)}.")
            return
        if self._vdmcheck is not None:
            self._groups.add("vdmcheck2")
        count = len(model_description.variables)
        self._add_run(external.vdmcheck2(copy, self._folder, self._vdmcheck, count))


def _read_build(contents: Contents) -> etree._Element | None:
    if _BUILD not in contents.files:
        return None
    return archive.parse(_BUILD, contents.files[_BUILD])[0]


def _model(contents: Contents) -> tuple[etree._Element | None, list[Problem]]:
    if _MODEL not in contents.names:
        hint = ""
        for name in contents.names:
            if name.endswith(f"/{_MODEL}"):
                hint = f"; {quote(name)} is in the wrong folder"
                break
        return None, [("xml-unreadable", f"{_MODEL} is missing{hint}.")]
    if _MODEL not in contents.files:
        return None, []
    root, texts = archive.parse(_MODEL, contents.files[_MODEL])
    if root is None:
        return None, texts
    if root.tag != "fmiModelDescription":
        tag = quote(str(root.tag))
        text = f"{_MODEL}: its root is {tag}; it must be 'fmiModelDescription'."
        return None, [*texts, ("xml-unreadable", text)]
    version = root.get("fmiVersion", "")
    if version not in ("1.0", "2.0") and not version.startswith("3."):
        text = f"{_MODEL}: its fmiVersion is {quote(version)}; expected '2.0'."
        return None, [*texts, ("fmi-version", text)]
    return root, texts
