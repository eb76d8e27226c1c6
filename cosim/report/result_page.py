"""Page of a result: heading, summary, findings, and its figures and tables by section."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from cosim.report.markup import (
    Pictures,
    Section,
    join_parts,
    paragraph,
    render,
    table,
    write_sections,
)
from cosim.report.tables.table import ResultTable

if TYPE_CHECKING:
    from cosim.workflow.answer import Answer


def write_answer(answer: "Answer", path: Path, more: Sequence[Section] = ()) -> None:
    """Write the page of a result as one self-contained file, with `more` sections at its end."""
    heading = answer.heading()
    sections = []
    if answer.findings:
        findings = render("findings.html.j2", findings=answer.findings)
        sections.append(Section(key="findings", title="Findings", html=findings))
    sections += [*_compose_sections(answer, Pictures(folder=path.parent)), *more]
    write_sections(
        path,
        title=f"HESR: {heading}",
        heading=heading,
        summary=_compose_summary(answer),
        sections=sections,
    )


def _compose_summary(answer: "Answer") -> Markup:
    """Return the introduction and the lines of the summary."""
    introduction = answer.introduction()
    texts = [introduction] if introduction else []
    texts += answer.summary().splitlines()
    return join_parts(*map(paragraph, texts))


def _compose_sections(answer: "Answer", pictures: Pictures) -> list[Section]:
    """Return the sections in the order of their tables; figures precede the tables of theirs."""
    drawings: dict[str, list[Markup]] = {}
    for figure in answer.figures():
        texts = {"alt": figure.alt, "small": figure.small}
        drawing = pictures.embed_figure(figure.key, figure.drawing, figure.caption, **texts)
        drawings.setdefault(figure.section, []).append(drawing)
    items = answer.tables()
    html_by_section: dict[str, list[Markup]] = {}
    for title, item in zip(_name_sections(items), items, strict=True):
        section_html = html_by_section.setdefault(title, [])
        if isinstance(item, ResultTable):
            section_html += drawings.pop(title, [])
        section_html.append(_show_item(item))
    html_by_section |= drawings  # sections without tables
    return [
        Section(key=_link_name(title), title=title, html=join_parts(*html))
        for title, html in html_by_section.items()
    ]


def _name_sections(items: Sequence[ResultTable | str]) -> list[str]:
    """Return the section of each table and sentence; a sentence belongs to the next table."""
    titles: list[str] = []
    title = "Remarks"  # of sentences without any table
    for item in reversed(items):
        if isinstance(item, ResultTable):
            title = item.section or item.caption
        titles.append(title)
    return titles[::-1]


def _show_item(item: ResultTable | str) -> Markup:
    """Return a sentence, or a table with its note; an empty table is "None."."""
    if isinstance(item, str):
        return paragraph(item)
    if not item.rows:
        return paragraph("None.")
    if not item.note:
        return table(item)
    return join_parts(table(item), paragraph(item.note, note=True))


def _link_name(title: str) -> str:
    """Return a title as the name of a link."""
    return re.sub(r"\W+", "-", title.lower()).strip("-")
