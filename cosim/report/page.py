"""Report of a run: a first layer, then folded sections, from saved results."""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from cosim.report.figures.zoom import can_zoom, library
from cosim.report.markup import TABLES, Pictures, Section, Tables, render, write_sections
from cosim.report.results import Results
from cosim.report.sections import inputs, laws, prediction
from cosim.report.sections.summary import summary
from cosim.report.tables.table import ResultTable, make_row
from cosim.study.results import record_files
from hesr_model.support import parallel, plugins
from hesr_model.support.extras import install_command
from hesr_model.support.progress import Stages, report_progress, silent
from hesr_model.support.result_folder import folder_updated_whole

REPORT = "report.html"
FIGURES = "figures"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Chapter:
    """Part of a section: `values` for template ``sections/KEY.html.j2``, None without data."""

    key: str
    title: str
    values: Callable[[Results], dict[str, Any] | None]
    folder: Path | None = None  # templates of a plug-in (group hesr.chapters)


@dataclass(frozen=True)
class RenderedChapter:
    """HTML of a chapter, its zooming views and CSV files."""

    chapter: Chapter
    html: Markup
    zooms: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, tuple[str, str]] = field(default_factory=dict)


SECTIONS = {
    ("prediction", "Prediction"): (
        Chapter("errors", "", prediction.errors_of_tests),
        Chapter("chirp", "Chirp beyond the trained frequencies", prediction.chirp),
        Chapter("loops", "Friction loops", prediction.loops),
    ),
    ("loop", "Closed loop"): (
        Chapter("tracking", "", prediction.tracking),
        Chapter("robustness", "Robustness", prediction.robustness),
        Chapter("following", "Following error of this robot", prediction.following),
    ),
    ("physics", "Physics checks"): (
        Chapter("properties", "", laws.properties),
        Chapter("audit", "Passivity audit", laws.audit),
    ),
    ("data", "Data checks"): (
        Chapter("logs", "", inputs.data),
        Chapter("body", "Rigid body", inputs.body),
    ),
    ("laws", "Laws"): (
        Chapter("equations", "", laws.equations),
        Chapter("hysteresis", "Hysteresis state", laws.hysteresis),
        Chapter("ablation", "Ablation", laws.ablation),
        Chapter("live", "Interactive law", laws.live),
    ),
    ("settings", "Settings"): (Chapter("provenance", "", inputs.provenance),),
}
"""Chapters of each section by key and title; the first may have no title."""
_SUMMARY = Chapter("summary", "Summary", summary)


def write_report(folder: Path, output: Path | None = None, *, progress: Stages = silent) -> Path:
    """Write the page, by default report.html in `folder`, figures and tables; return its path.

    A killed process leaves all files of the folder as they were, or all new ones.
    """
    results = Results.read(folder)
    path = output or folder / REPORT
    with folder_updated_whole(folder) as temporary:
        inside = temporary / REPORT if output is None else path
        compose_report(results, temporary, inside, path.parent, progress=progress)
        record_files(temporary, folder)
    return path


def compose_report(
    results: Results,
    folder: Path,
    page: Path,
    page_folder: Path,
    *,
    brief: bool = False,
    progress: Stages = silent,
) -> None:
    """Write the page of results, read in `page_folder`, and figures and tables to a folder.

    A `brief` page has neither files of figures nor zooming views.
    """
    chapters_by_section = _arrange_chapters()
    home = _relative_link(page_folder.resolve(), results.folder.resolve())
    chapters = list(chain.from_iterable(chapters_by_section.values()))
    render_chapter = partial(
        _render_chapter, results=results, folder=folder, home=home, brief=brief
    )
    rendered_chapters = _render_chapters(chapters, render_chapter, brief=brief, progress=progress)
    if not can_zoom() and not brief:
        _log.warning("figures of the report do not zoom: %s.", install_command("report"))
    sections = []
    for (key, title), group in chapters_by_section.items():
        section_chapters = [rendered for rendered in rendered_chapters if rendered.chapter in group]
        if section_chapters:
            sections.append(_section(key, title, section_chapters, home))
    _write_index(folder, rendered_chapters)
    zooms: dict[str, str] = {}
    for rendered in rendered_chapters:
        zooms |= rendered.zooms
    write_sections(
        page,
        title=f"HESR report: {results.run.study}",
        heading=f"Friction of {results.run.robot}: report of the study ‘{results.run.study}’",
        summary=rendered_chapters[0].html,
        sections=sections,
        zooms=zooms,
        library=library() if zooms else "",
    )


def _render_chapters(
    chapters: Sequence[Chapter],
    render_chapter: Callable[[Chapter], RenderedChapter | None],
    *,
    brief: bool,
    progress: Stages,
) -> list[RenderedChapter]:
    """Render the summary, then the other chapters, without those that have no data."""
    workers: int | None = 1  # starting processes for one page costs more
    if parallel.is_sharing() and not brief:
        workers = None
    jobs = [partial(render_chapter, chapter) for chapter in chapters]
    names = [chapter.title or chapter.key for chapter in chapters]
    with parallel.results_of(jobs, workers, names=names) as chapter_results:
        # This process draws the summary while others draw the chapters.
        rendered_chapters = [render_chapter(_SUMMARY)]
        steps = report_progress(jobs, partial(progress, "writing the report"))
        rendered_chapters += [next(chapter_results) for _ in steps]
    return [rendered for rendered in rendered_chapters if rendered is not None]


def _write_index(folder: Path, rendered_chapters: Sequence[RenderedChapter]) -> None:
    """Write the list of all tables with their captions and notes."""
    rows = []
    for rendered in rendered_chapters:
        rows += [make_row(file, *texts) for file, texts in rendered.tables.items()]
    index = ResultTable(caption="", head=("file", "caption", "note"), rows=rows)
    Tables(folder / TABLES).csv(index, "index")


def _arrange_chapters() -> dict[tuple[str, str], tuple[Chapter, ...]]:
    """Return the chapters of each section; sections of plug-ins precede the last one."""
    *first_sections, last_section = SECTIONS.items()
    plugin_sections = []
    for plugin in plugins.load("hesr.chapters").values():
        chapter: Chapter = plugin.load()
        section_chapters = (replace(chapter, title=""),)
        plugin_sections.append(((chapter.key, chapter.title), section_chapters))
    return dict([*first_sections, *plugin_sections, last_section])


def _relative_link(page_folder: Path, folder: Path) -> str:
    try:
        link = quote(Path(os.path.relpath(folder, page_folder)).as_posix())
    except ValueError:  # two drives of Windows
        link = folder.as_uri()
    return "" if link == "." else f"{link}/"


def _render_chapter(
    chapter: Chapter, *, results: Results, folder: Path, home: str, brief: bool
) -> RenderedChapter | None:
    """Render a chapter and write its figures and tables; None without data."""
    pictures = Pictures(folder / FIGURES, brief)
    tables = Tables(folder / TABLES)
    values = chapter.values(results)
    if values is None:
        return None
    values |= {
        "home": home,
        "brief": brief,
        "unit": results.unit,
        "table": tables.table,
        "csv": tables.csv,
    }
    values |= {"figure": pictures.figure, "chart": pictures.chart, "drawing": pictures.drawing}
    html = render(f"sections/{chapter.key}.html.j2", folder=chapter.folder, **values)
    return RenderedChapter(chapter, html, pictures.zooms, tables.written)


def _section(
    key: str, title: str, rendered_chapters: Sequence[RenderedChapter], home: str
) -> Section:
    files = {}
    for rendered in rendered_chapters:
        for file, (caption, _) in rendered.tables.items():
            files[f"{TABLES}/{file}"] = caption
    html = render("section.html.j2", chapters=rendered_chapters, files=files, home=home)
    return Section(key=key, title=title, html=html, folded=True)
