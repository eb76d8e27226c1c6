"""Page of a report: its sections in order, from saved results."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from cosim.report.figures.zoom import library
from cosim.report.markup import Pictures, Section, render, table, write_sections
from cosim.report.results import Results
from cosim.report.sections import inputs, laws, loop, physics, prediction
from cosim.report.sections.summary import summary
from fmu_src.pages.datasheet import ModelAudit
from hesr_model.support import parallel
from hesr_model.support.progress import Stages, counted, silent

REPORT, FIGURES = "report.html", "figures"


@dataclass(frozen=True)
class Chapter:
    """A section of the page; its template is ``sections/KEY.html.j2``.

    Attributes
    ----------
    key : identifier in links, and name of the template.
    title : heading.
    values : function of the results that returns the values of the template; None without data.
    """

    key: str
    title: str
    values: Callable[[Results, Pictures], dict[str, Any] | None]


CHAPTERS = (
    Chapter("data", "Robot and data checks", inputs.data),
    Chapter("body", "Rigid body", inputs.body),
    Chapter("hysteresis", "Hysteresis state", laws.hysteresis),
    Chapter("equations", "Equations", laws.equations),
    Chapter("prediction", "Prediction on unseen motions", prediction.prediction),
    Chapter("chirp", "Chirp: beyond the trained frequencies", prediction.chirp),
    Chapter("loops", "Friction loops", prediction.loops),
    Chapter("audit", "Passivity audit", physics.audit),
    Chapter("properties", "Physics checks", physics.properties),
    Chapter("ablation", "Ablation", laws.ablation),
    Chapter("tracking", "Tracking in closed loop", loop.tracking),
    Chapter("robustness", "Robustness", loop.robustness),
    Chapter("live", "Interactive law", laws.live),
    Chapter("provenance", "Provenance", inputs.provenance),
)
_SUMMARY = Chapter("summary", "Summary", summary)


def write_report(
    folder: Path,
    output: Path | None = None,
    *,
    audits: Mapping[str, ModelAudit] | None = None,
    progress: Stages = silent,
) -> Path:
    """Write the report of a run and return its path.

    Parameters
    ----------
    folder : results of `hesr run`; the figures are also written there as PDF and PNG.
    output : the page to write; by default report.html in the folder.
    audits : audits of the laws, if already known.
    progress : receives the stage, its state and its size.

    Raises
    ------
    ArtifactError, LogError
        If the folder has no results, a file of it is missing or damaged, or the page cannot be
        written.
    """
    results = replace(Results.read(folder), audited=audits)
    path = output or folder / REPORT
    jobs = [partial(_section, chapter, results, folder / FIGURES) for chapter in CHAPTERS]
    sections: list[Section] = []
    zooms: dict[str, str] = {}
    # Starting processes costs more than they save.
    with parallel.results_of(jobs, None if parallel.shared() else 1) as made:
        head, _ = _section(_SUMMARY, results, folder / FIGURES)
        for _ in counted(jobs, partial(progress, "writing the report")):
            section, more = next(made)
            sections += [section] if section else []
            zooms |= more
    assert head is not None
    write_sections(
        path,
        title=f"HESR report: {results.run.study}",
        heading=f"Friction of {results.run.robot}: report of the study ‘{results.run.study}’",
        summary=head.html,
        sections=sections,
        zooms=zooms,
        library=library() if zooms else "",
    )
    return path


def _section(
    chapter: Chapter, results: Results, figures: Path
) -> tuple[Section | None, dict[str, str]]:
    """Return a section, if it has data, and the data of its zooming views."""
    pictures = Pictures(folder=figures)
    values = chapter.values(results, pictures)
    if values is None:
        return None, {}
    template = f"sections/{chapter.key}.html.j2"
    html = render(template, table=table, unit=results.unit, **values)
    return Section(key=chapter.key, title=chapter.title, html=html), pictures.zooms
