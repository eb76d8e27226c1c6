"""The page: its sections in order, with their script and style."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from cosim.report.markup import Pictures, Section, write_sections
from cosim.report.results import Results
from cosim.report.sections import (
    ablation,
    audit,
    battery,
    body,
    data,
    equations,
    hysteresis,
    live,
    loops,
    prediction,
    provenance,
    robustness,
    tracking,
)
from cosim.report.sections.summary import summary
from cosim.report.zoom import library
from fmu_src.pages.datasheet import ModelAudit
from hesr_model.support import parallel
from hesr_model.support.progress import Stages, counted, silent

REPORT, FIGURES = "report.html", "figures"

SECTIONS: tuple[Callable[[Results, Pictures], Section | None], ...] = (
    data.section,
    body.section,
    hysteresis.section,
    equations.section,
    prediction.section,
    prediction.bands,
    loops.section,
    audit.section,
    battery.section,
    ablation.section,
    tracking.section,
    robustness.section,
    live.section,
    provenance.section,
)
"""In the order of the page; one that has no data gives none."""


def write_report(
    folder: Path,
    output: Path | None = None,
    *,
    audits: Mapping[str, ModelAudit] | None = None,
    progress: Stages = silent,
) -> Path:
    """Write the report of a run.

    Parameters
    ----------
    folder : results of `hesr run`; the figures are written there as PDF and PNG, too.
    output : the page to write; report.html in the folder where not given.
    audits : of the laws, where they have been made already.
    progress : told what is being done, how much of it is done, and how much there is.

    Returns
    -------
    The page that was written.

    Raises
    ------
    ArtifactError, LogError
        If the folder holds no results, naming the file that is missing or damaged, or if the page
        cannot be written.
    """
    results = replace(Results.read(folder), audited=audits)
    path = output or folder / REPORT
    jobs = [partial(_made, section, results, folder / FIGURES) for section in SECTIONS]
    sections: list[Section] = []
    pictures = Pictures(folder=folder / FIGURES)
    # Processes that would have to be started for it cost more than they save.
    with parallel.results_of(jobs, None if parallel.shared() else 1) as made:
        head = summary(results, pictures)
        for _ in counted(jobs, partial(progress, "writing the report")):
            section, more = next(made)
            sections += [section] if section else []
            pictures.zooms |= more
    write_sections(
        path,
        title=f"HESR report: {results.run.study}",
        heading=f"Friction of {results.run.robot}: report of the study ‘{results.run.study}’",
        summary=head,
        sections=sections,
        zooms=pictures.zooms,
        library=library() if pictures.zooms else "",
    )
    return path


def _made(
    section: Callable[[Results, Pictures], Section | None], results: Results, figures: Path
) -> tuple[Section | None, dict[str, str]]:
    """Return a section, if it has data, and the data of its views that zoom."""
    pictures = Pictures(folder=figures)
    return section(results, pictures), pictures.zooms
