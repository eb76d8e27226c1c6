"""Validation of FMUs and SSPs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
)
from hesr_model.errors import ArgumentError, HesrError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, path_of
from hesr_model.support.progress import Stages, counted, silent

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.report.tables.table import ResultTable
    from cosim.workflow.arguments import Names, Paths
    from fmu_src.check.run import Report
    from fmu_src.friction.convention import Convention
    from hesr_model.findings import Finding

KINDS = ("static", "references", "convention")  # kinds of HESR's own checks


@dataclass(frozen=True, kw_only=True, repr=False)
class FmuReport(Answer):
    """Result of `hesr.check`: a report for each file, in the order of the arguments."""

    format = "hesr-fmu-report-1"
    reports: Sequence[Report]
    conventions: Mapping[Path, Convention] = field(default_factory=dict)  # for that kind
    files: Sequence[Path] = ()

    @property
    def findings(self) -> Sequence[Finding]:  # type: ignore[override]  # derived from the reports
        """Findings of all files."""
        return [
            replace(finding, where=str(report.path))
            for report in self.reports
            for finding in report.problems
        ]

    def _lines(self, most: int | None = None) -> list[str]:
        lines = []
        for report in self.reports:
            lines.append(f"{report.path}: {report.verdict}")
            own = [f"  {line}" for line in finding_lines(report.problems)]
            lines += own[:most]
            if len(own) > len(own[:most]):
                lines.append(f"  {len(own) - len(own[:most])} more: --verbose lists them.")
            if report.coverage:
                lines.append(f"  platforms: {report.coverage}")
            lines += [f"  not run: {reason}" for reason in report.skipped]
        return lines

    def summary(self) -> str:
        """Return verdict, first findings and omitted validators of each file."""
        return shorten_lines(self._lines(most=max(2, 16 // len(self.reports))), self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return all findings, and the tables of the kind ``convention``."""
        from cosim.report.tables.laws import convention

        costs = [convention(path.name, found) for path, found in self.conventions.items()]
        return [*self._lines(), *costs]

    def result(self) -> Any:
        """Return the reports as JSON data."""
        from hesr_model.support.typed_files import to_json

        return [
            report.to_json()
            | ({"convention": to_json(c)} if (c := self.conventions.get(report.path)) else {})
            for report in self.reports
        ]


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
    """Validate FMUs and SSPs (schemas, FMPy, VDMCheck2, own rules).

    An error violates the standard or fails in a host, a warning may fail in some; advice concerns
    comfort. The static checks always run and execute no code of the FMU; the other kinds do.

    Parameters
    ----------
    fmus : path or sequence of paths
        FMUs of any tool, of FMI 1.0, 2.0 or 3.0; SSPs.
    kind : str or sequence of str, optional
        Further checks, repeatable: references (against the reference results that the file
        carries), hostile (odd and repeated steps, invalid calls), convention (error of each input
        convention).
    vdmcheck : path, optional
        Folder with VDMCheck2; by default .tools/vdmcheck2, if present.
    junit : path, optional
        JUnit file to write: a test case per file and rule, which fails for an error.
    sarif : path, optional
        SARIF file to write, for code hosts.
    trust : bool, optional
        Run these FMUs without a sandbox, now and later: faster, but with all your rights.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    FmuReport
        Findings per file, and the validators that were not run.

    Raises
    ------
    ArtifactError
        If a file does not exist or cannot be opened; damage inside is a finding.
    ConfigError
        If VDMCheck2 is missing in `vdmcheck`, or an SSP is given for another kind.

    Examples
    --------
    On the command line::

        $ hesr check Friction.fmu --vdmcheck .tools/vdmcheck2
        $ hesr check Friction.fmu --kind hostile --kind references
        $ hesr check System.ssp --fail-on warning --junit check.xml --sarif check.sarif

    >>> import hesr
    >>> hesr.check("Friction.fmu").passed
    True
    """
    from fmu_src.check.run import check as check_fmu
    from fmu_src.friction.convention import judge, measure
    from fmu_src.run.archive import opened

    paths = list_paths("fmus", fmus)
    require_items("fmus", paths)
    kinds = list_names("kind", kind)
    plugged = plugins.names("hesr.checks")
    for name in kinds:
        require_choice("kind", name, (*KINDS, *plugged))
    wanted = {"junit": junit, "sarif": sarif}
    writers = [(plugins.find("hesr.findings", k), file) for k, file in wanted.items() if file]
    systems = [path for path in paths if path.suffix.lower() == ".ssp"]
    if systems and set(kinds) - {"static", "references"}:
        raise ArgumentError(f"{systems[0]}: an SSP supports 'kind' static and references only.")
    for path in paths:
        if path not in systems:
            opened(path).close()  # refuse an unreadable file before checking others
            if "convention" in kinds:
                judge(path)
    remember_trust(paths, trust=trust)
    folder = None if vdmcheck is None else path_of(vdmcheck, "'vdmcheck'")
    reports = []
    for path in counted(paths, partial(progress, "checking"), lambda path: path.name):
        report = (
            plugins.find("hesr.systems", "ssp-check")(path, vdmcheck=folder)
            if path in systems
            else check_fmu(path, vdmcheck=folder, kinds=[name for name in plugged if name in kinds])
        )
        reports.append(_with_references(report) if "references" in kinds else report)
    conventions = {}
    for place, path in enumerate(paths if "convention" in kinds else ()):
        progress(f"measuring {path.name}", 0, 1)
        try:
            conventions[path] = measure(path)
        except HesrError as error:
            broken = reports[place]
            if not broken.problems:
                raise
            reports[place] = replace(broken, skipped=(*broken.skipped, f"Convention: {error}"))
    files = []
    for write, file in writers:
        files.append(path_of(file, "an output"))
        write(files[-1], reports)
    return FmuReport(reports=reports, conventions=conventions, files=files)


def _with_references(report: Report) -> Report:
    """Return a report extended by the comparison with the reference results in the file."""
    from fmu_src.check.rules import findings, with_rule
    from fmu_src.run.reference_results import verify

    system = report.path.suffix.lower() == ".ssp"
    run = plugins.find("hesr.systems", "ssp-references") if system else verify
    found = run(report.path)
    return replace(
        report,
        problems=(*findings(with_rule("references", found.problems)), *report.problems),
        skipped=(*report.skipped, *found.skipped),
    )
