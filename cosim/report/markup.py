"""Parts of the page: sections, tables, figures and numbers."""

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

_FOLDERS = (
    Path(__file__).parent / "templates",
    TEMPLATES,  # the style of an FMU's pages is ours as well
)

_NUMBER = "\ue000"
"""Where the number of a figure comes, a character of private use: sections may be made anywhere."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the page: what links call it, its heading, its HTML."""

    key: str
    title: str
    html: Markup


@dataclass
class Pictures:
    """Draws figures of a page, and writes them as PDF and PNG; the page numbers them.

    Attributes
    ----------
    folder : in which they are written.
    zooms : data of the views that zoom, by key of the figure.
    """

    folder: Path
    zooms: dict[str, str] = field(default_factory=dict)

    def figure(self, key: str, picture: "Figure", caption: str, *, alt: str) -> Markup:
        """Return a figure.

        Parameters
        ----------
        key : name of its files, and of the figure in links.
        picture : as drawn.
        caption : what is to be seen.
        alt : what it shows, for readers who cannot see it.
        """
        from cosim.report.figures.style import write

        write(picture, self.folder / key)
        return self.shown(key, picture, caption, alt=alt)

    def shown(self, key: str, picture: "Figure", caption: str, *, alt: str) -> Markup:
        """Return a figure that stands in the page only."""
        from cosim.report.figures.style import svg

        return self.drawing(key, Markup(svg(picture, key)), caption, alt=alt)

    def chart(self, key: str, chart: "Chart", caption: str, *, alt: str) -> Markup:
        """Return a figure of lines, which can be zoomed."""
        from cosim.report.figures.chart import drawn

        self.zooms[key] = zoom_data(chart)
        return self.figure(key, drawn(chart), caption, alt=alt)

    def drawing(self, key: str, svg: Markup, caption: str, *, alt: str) -> Markup:
        """Return a figure that is SVG already."""
        return render(
            "figure.html.j2", key=key, svg=svg, caption=caption, alt=alt, number=_NUMBER,
            zoom=key in self.zooms,
        )  # fmt: skip


def render(template: str, **values: Any) -> Markup:
    """Return HTML from a template; what it is given is escaped, but for markup."""
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


def heading(text: str) -> Markup:
    """Return a heading within a section."""
    return Markup("<h3>{}</h3>").format(text)


def listing(items: Iterable[str | Markup]) -> Markup:
    """Return items one below the other."""
    return Markup("<ul>{}</ul>").format(
        Markup("").join(Markup("<li>{}</li>").format(item) for item in items)
    )


def details(summary: str, *parts: Markup) -> Markup:
    """Return what is folded away."""
    return Markup("<details><summary>{}</summary>{}</details>").format(
        summary, Markup("").join(parts)
    )


def joined(*parts: Markup) -> Markup:
    """Return parts one after the other."""
    return Markup("\n").join(parts)
