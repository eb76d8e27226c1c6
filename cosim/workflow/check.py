"""Validation of FMUs and SSPs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from cosim.workflow.answer import Answer, finding_lines, shorten_lines
from cosim.workflow.arguments import (
    list_names,
    list_paths,
    remember_trust,
    require_choice,
    require_items,
    to_optional_path,
)
from hesr_model.errors import ArgumentError, ArtifactError, HesrError
from hesr_model.findings import log_findings
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, require_writable, to_path
from hesr_model.support.progress import Interrupted, Stages, publish_draft, report_progress, silent

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.report.tables.table import ResultTable
    from cosim.workflow.arguments import Names, Paths
    from fmu_src.check.run import Report
    from fmu_src.friction.convention import Convention
    from hesr_model.findings import Finding

_Writer = tuple[Callable[..., None], "Path"]  # of findings, with its file

_DRAFT_PAUSE = 9.0  # between drafts of findings, in times of writing one: a tenth of all time
_MAX_LOGGED = 3  # findings of a file that are printed before all files are checked
_VDMCHECK_HINT = (
    "VDMCheck2 was not run: unpack a release of github.com/INTO-CPS-Association/FMI-VDM-Model, and "
    "give its folder by --vdmcheck."
)
KINDS = ("static", "references", "convention")  # kinds of HESR's own checks


@dataclass(frozen=True, kw_only=True, repr=False)
class FmuReport(Answer):
    """Result of `hesr.check`.

    Attributes
    ----------
    reports : a report for each file, in the order of the arguments.
    conventions : errors of the input conventions by file, for the kind ``convention``.
    files : written files.
    """

    format = "hesr-fmu-report-1"
    reports: Sequence[Report]
    conventions: Mapping[Path, Convention] = field(default_factory=dict)
    files: Sequence[Path] = ()

    @property
    def findings(self) -> Sequence[Finding]:  # type: ignore[override]  # derived from the reports
        """Findings of all files."""
        findings: list[Finding] = []
        for report in self.reports:
            findings += _add_place(report.problems, report.path)
        return findings

    def _lines(self, limit: int | None = None) -> list[str]:
        from fmu_src.check.external import NO_VDMCHECK

        lines = []
        for report in self.reports:
            lines.append(f"{report.path}: {report.verdict}")
            problems = [f"  {line}" for line in finding_lines(report.problems)]
            lines += problems[:limit]
            hidden_count = len(problems) - len(problems[:limit])
            if hidden_count:
                lines.append(f"  {hidden_count} more: --verbose lists them.")
            if report.coverage:
                lines.append(f"  platforms: {report.coverage}")
            if report.record:
                lines.append(f"  record: {report.record}")
            lines += [f"  not run: {reason}" for reason in report.skipped if reason != NO_VDMCHECK]
        return lines

    def summary(self) -> str:
        """Return verdict, first findings and omitted validators of each file."""
        return shorten_lines(self._lines(limit=max(2, 16 // len(self.reports))), self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return all findings, and the tables of the kind ``convention``."""
        from cosim.report.tables.laws import convention
        from fmu_src.check.external import NO_VDMCHECK

        costs = [convention(path.name, cost) for path, cost in self.conventions.items()]
        tables: list[ResultTable | str] = [*self._lines(), *costs]
        if any(NO_VDMCHECK in report.skipped for report in self.reports):
            tables.append(_VDMCHECK_HINT)
        return tables

    def result(self) -> Any:
        """Return the reports as JSON data."""
        from hesr_model.support.typed_files import to_json

        reports = []
        for report in self.reports:
            data = report.to_json()
            if report.path in self.conventions:
                data["convention"] = to_json(self.conventions[report.path])
            reports.append(data)
        return reports


def check(
    fmus: Paths,
    *,
    kind: Names = ("static",),
    vdmcheck: PathArg | None = None,
    junit: PathArg | None = None,
    sarif: PathArg | None = None,
    trust: bool = False,
    progress: Stages = silent,
) -> FmuReport:
    r"""Validate FMUs and SSPs (schemas, FMPy, VDMCheck2, own rules).

    An error violates the standard or fails in a host, a warning may fail in
    some; advice concerns comfort. The static checks always run and execute no
    code of the FMU; the other kinds do.

    Parameters
    ----------
    fmus : path or sequence of paths
        FMUs of any tool, of FMI 2.0 or 3.0; SSPs.
    kind : str or sequence of str, optional
        Further checks: references (against the reference results that the file
        carries), hostile (odd and repeated steps, invalid calls), convention
        (error of each input convention), sandbox (what foreign code can do on
        this machine, whatever the file).
    vdmcheck : path, optional
        Folder with VDMCheck2, which is not run without it.
    junit : path, optional
        JUnit file to write: a test case per file and rule, which fails for an
        error.
    sarif : path, optional
        SARIF file to write, for code hosts.
    trust : bool, optional
        Run these FMUs without a sandbox, now and later: faster, but with all
        your rights.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    FmuReport
        Findings per file, and the validators that were not run.

    Raises
    ------
    ArtifactError
        If a file does not exist or cannot be opened; damage inside is a
        finding.
    ConfigError
        If VDMCheck2 is missing in `vdmcheck`, or an SSP is given for another
        kind.

    Examples
    --------
    On the command line::

        $ hesr check Friction.fmu --vdmcheck .tools/vdmcheck2
        $ hesr check Friction.fmu --kind hostile --kind references
        $ hesr check System.ssp --fail-on warning --junit check.xml \
          --sarif check.sarif

    >>> import hesr
    >>> hesr.check("Friction.fmu").passed
    True
    """
    paths = list_paths("fmus", fmus)
    require_items("fmus", paths)
    kinds = list_names("kind", kind)
    for name in kinds:
        require_choice("kind", name, (*KINDS, *plugins.names("hesr.checks")))
    writers = _find_writers({"junit": junit, "sarif": sarif})
    _require_supported(paths, kinds)
    remember_trust(paths, trust=trust)
    vdmcheck_folder = to_optional_path("vdmcheck", vdmcheck)
    reports: list[Report] = []
    draft_files = _DraftFiles(writers)
    try:
        for path in report_progress(paths, partial(progress, "checking"), lambda path: path.name):
            report = _check_file(path, kinds, vdmcheck_folder, is_single=len(paths) == 1)
            reports.append(report)
            if len(paths) > 1:
                _log_first_findings(report)
                draft_files.write(reports)
    except KeyboardInterrupt as interrupt:
        hint = f"{len(reports)} of {len(paths)} files were checked"
        answer = _write_findings(reports, writers)
        raise Interrupted(hint, interrupt, answer) from interrupt
    conventions: dict[Path, Convention] = {}
    if "convention" in kinds:
        for number, report in enumerate(reports):
            progress(f"measuring {report.path.name}", 0, 1)
            reports[number], convention = _measure_convention(report)
            if convention is not None:
                conventions[report.path] = convention
    return _write_findings(reports, writers, conventions)


def _write_findings(
    reports: Sequence[Report],
    writers: Iterable[_Writer],
    conventions: Mapping[Path, Convention] | None = None,
) -> FmuReport:
    """Write all files of findings, and return the answer that names them."""
    files = []
    for write, file in writers:
        write(file, reports)
        files.append(file)
    return FmuReport(reports=reports, conventions=conventions or {}, files=files)


def _add_place(findings: Iterable[Finding], path: Path) -> list[Finding]:
    """Return findings with the file that they are about."""
    return [replace(finding, where=str(path)) for finding in findings]


def _measure_convention(report: Report) -> tuple[Report, Convention | None]:
    """Return the errors of the input conventions of an FMU; None if it does not run."""
    from fmu_src.friction.convention import measure

    try:
        return report, measure(report.path)
    except HesrError as error:
        if not report.problems:
            raise
        # The problems explain why the FMU does not run.
        skipped = (*report.skipped, f"Convention: {error}")
        return replace(report, skipped=skipped), None


class _DraftFiles:
    """Files of the findings so far, which are complete whenever the run is killed."""

    def __init__(self, writers: Iterable[_Writer]) -> None:
        self._writers = list(writers)
        self._next_time = time.monotonic()
        self._is_first = True

    def write(self, reports: Sequence[Report]) -> None:
        """Write the reports unless the last time is too recent; the files grow with each report."""
        begin = time.monotonic()
        if begin < self._next_time:
            return
        publish_draft(_write_findings(tuple(reports), self._writers))
        end = time.monotonic()
        if not self._is_first:  # the first time also loads modules
            self._next_time = end + _DRAFT_PAUSE * (end - begin)
        self._is_first = False


def _find_writers(files: Mapping[str, PathArg | None]) -> list[_Writer]:
    """Return the writers of findings with their files, of formats that have a file."""
    writers = []
    for name, file in files.items():
        if file:
            write = plugins.find("hesr.findings", name)
            path = to_path(file, f"'{name}'")
            require_writable(path)
            writers.append((write, path))
    return writers


def _is_system(path: Path) -> bool:
    return path.suffix.lower() == ".ssp"


def _require_supported(paths: Sequence[Path], kinds: Sequence[str]) -> None:
    """Refuse an unreadable file, or one that a kind does not support, before checking others."""
    from fmu_src.run.archive import open_file

    systems = [path for path in paths if _is_system(path)]
    fmus = [path for path in paths if not _is_system(path)]
    if systems and set(kinds) - {"static", "references"}:
        raise ArgumentError(f"{systems[0]}: an SSP supports 'kind' static and references only.")
    if fmus and len(paths) == 1:
        open_file(fmus[0]).close()
    if "convention" in kinds:
        from fmu_src.friction.convention import judge  # slow to import

        for path in fmus:
            judge(path)


def _log_first_findings(report: Report) -> None:
    """Log what the user should know before all files are checked."""
    findings = [finding for finding in report.problems if finding.severity != "advice"]
    log_findings(_add_place(findings[:_MAX_LOGGED], report.path))


def _check_file(
    path: Path, kinds: Sequence[str], vdmcheck: Path | None, *, is_single: bool
) -> Report:
    """Run the static checks of an FMU or SSP, those of plug-ins, and the comparison.

    One of several files that cannot be opened does not end the others.
    """
    from fmu_src.check.run import Report
    from hesr_model.findings import Finding

    try:
        return _run_checks(path, kinds, vdmcheck)
    except ArtifactError as error:
        if is_single:
            raise
        reason = str(error).removeprefix(f"{path}: ")
        problem = Finding(check="file-missing", where="", found=reason)
        return Report(path=path, problems=(problem,), skipped=())


def _run_checks(path: Path, kinds: Sequence[str], vdmcheck: Path | None) -> Report:
    from fmu_src.check.run import check as check_fmu

    if _is_system(path):
        report: Report = plugins.find("hesr.systems", "ssp-check")(path, vdmcheck=vdmcheck)
    else:
        checks = [name for name in plugins.names("hesr.checks") if name in kinds]
        report = check_fmu(path, vdmcheck=vdmcheck, kinds=checks)
    if "references" in kinds:
        return _add_references(report)
    return report


def _add_references(report: Report) -> Report:
    """Return a report extended by the comparison with the reference results in the file."""
    from fmu_src.check.rules import findings, label_problems
    from fmu_src.run.reference_results import verify

    if _is_system(report.path):
        verify = plugins.find("hesr.systems", "ssp-references")
    comparison = verify(report.path)
    return replace(
        report,
        problems=(*findings(label_problems("references", comparison.problems)), *report.problems),
        skipped=(*report.skipped, *comparison.skipped),
    )
