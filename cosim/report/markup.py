"""Pages of sections, and the HTML of tables, figures and text in them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from cosim.report.figures.zoom import zoom_data
from cosim.report.tables.table import ResultTable
from fmu_src.pages.html import TEMPLATES, rendered
from hesr_model.audit.properties import MARKS
from hesr_model.support.files import written_whole

if TYPE_CHECKING:
    from cosim.report.figures.chart import Chart, Figure

# Pages share the style of the pages in FMUs.
_FOLDERS = (Path(__file__).parent / "templates", TEMPLATES)

_NUMBER = "\ue000"
"""Placeholder of a figure's number, because sections may be made in any order."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of a page: key in links, heading, HTML."""

    key: str
    title: str
    html: Markup


@dataclass
class Pictures:
    """Figures of a page, also written as PDF and PNG.

    Attributes
    ----------
    folder : folder of the files.
    zooms : data of the zooming views, by key of the figure.
    """

    folder: Path
    zooms: dict[str, str] = field(default_factory=dict)

    def figure(self, key: str, picture: "Figure", caption: str, *, alt: str) -> Markup:
        """Write a figure and return its HTML.

        Parameters
        ----------
        key : name of the files, and of the figure in links.
        picture : the figure.
        caption : text below the figure.
        alt : description for readers who cannot see it.
        """
        from cosim.report.figures.style import write

        write(picture, self.folder / key)
        return self.shown(key, picture, caption, alt=alt)

    def shown(self, key: str, picture: "Figure", caption: str, *, alt: str) -> Markup:
        """Return the HTML of a figure without writing files."""
        from cosim.report.figures.style import svg

        return self.drawing(key, Markup(svg(picture, key)), caption, alt=alt)

    def chart(self, key: str, chart: "Chart", caption: str, *, alt: str) -> Markup:
        """Write a chart with a zooming view and return its HTML."""
        from cosim.report.figures.chart import drawn

        self.zooms[key] = zoom_data(chart)
        return self.figure(key, drawn(chart), caption, alt=alt)

    def drawing(self, key: str, svg: Markup, caption: str, *, alt: str) -> Markup:
        """Return the HTML of a figure in SVG."""
        zoom = key in self.zooms
        texts = {"caption": caption, "alt": alt, "number": _NUMBER}
        return render("figure.html.j2", key=key, svg=svg, zoom=zoom, **texts)


def render(template: str, **values: Any) -> Markup:
    """Return HTML from a template; all values except markup are escaped."""
    return Markup(rendered(template, _FOLDERS, **values))


def write_sections(
    path: Path,
    *,
    title: str,
    heading: str,
    summary: Markup,
    sections: Sequence[Section],
    zooms: Mapping[str, Any] | None = None,
    library: str = "",
) -> None:
    """Write a self-contained page of sections.

    Raises
    ------
    ArtifactError
        If it cannot be written.
    """
    from cosim.report.figures.style import VARIABLES

    page = render(
        "report.html.j2",
        title=title,
        heading=heading,
        summary=summary,
        sections=sections,
        zooms=zooms or {},
        library=library,
        palette=VARIABLES,
    )
    numbers = count(1)
    numbered = re.sub(_NUMBER, lambda _: str(next(numbers)), page)
    with written_whole(path) as temporary:
        temporary.write_text(numbered, encoding="utf-8")


def table(what: ResultTable) -> Markup:
    """Return a table with a button that copies it."""
    return render("table.html.j2", table=what, symbols=MARKS)


def paragraph(text: str | Markup, *, note: bool = False) -> Markup:
    """Return a paragraph."""
    return Markup('<p class="note">{}</p>' if note else "<p>{}</p>").format(text)


def listing(items: Iterable[str | Markup]) -> Markup:
    """Return a list of items."""
    return Markup("<ul>{}</ul>").format(joined(*(Markup("<li>{}</li>").format(i) for i in items)))


def details(summary: str, *parts: Markup) -> Markup:
    """Return folded parts with a summary."""
    return Markup("<details><summary>{}</summary>{}</details>").format(summary, joined(*parts))


def joined(*parts: Markup) -> Markup:
    """Return parts one after the other."""
    return Markup("\n").join(parts)
