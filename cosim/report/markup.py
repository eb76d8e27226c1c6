"""Pages of sections; HTML of tables, figures and text."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from cosim.report.figures.zoom import can_zoom, unpack_text, zoom_data
from cosim.report.tables.table import ResultTable, csv_text
from fmu_src.pages.html import TEMPLATES, render_template
from hesr_model.audit.properties import MARKS
from hesr_model.support.files import written_whole

if TYPE_CHECKING:
    from cosim.report.figures.chart import Chart, Figure

# Pages share the style of the pages in FMUs.
_FOLDERS = (Path(__file__).parent / "templates", TEMPLATES)

_NUMBER = "\ue000"  # placeholder of a figure's number; sections may be made in any order

TABLES = "tables"  # folder of CSV files next to the page


@dataclass(frozen=True, kw_only=True)
class Section:
    """Section of a page; `key` is its name in links."""

    key: str
    title: str
    html: Markup
    folded: bool = False


@dataclass(frozen=True, kw_only=True)
class ResultFigure:
    """Figure of a result; `section` is the title of its section, `alt` describes the drawing."""

    section: str
    key: str
    drawing: "Figure"
    caption: str
    alt: str
    small: bool = False


@dataclass
class Pictures:
    """Figures of a page, also written as PDF and PNG; data of zooming views by key."""

    folder: Path
    brief: bool = False  # neither files nor zooming views
    zooms: dict[str, str] = field(default_factory=dict)

    def figure(
        self, key: str, picture: "Figure | None", *, file: "Figure | None" = None, **texts: Any
    ) -> Markup:
        """Write a figure, or `file` instead, and return its HTML; see `drawing`."""
        from cosim.report.figures.style import write

        if picture is None:
            return Markup()
        if not self.brief:
            write(file or picture, self.folder / key)
        return self.embed_figure(key, picture, **texts)

    def embed_figure(self, key: str, picture: "Figure", caption: str = "", **texts: Any) -> Markup:
        """Return the HTML of a figure; see `drawing`."""
        from cosim.report.figures.style import svg

        return self.drawing(key, Markup(svg(picture, key)), caption, **texts)

    def chart(self, key: str, chart: "Chart | None", **texts: Any) -> Markup:
        """Write a chart and return its HTML with a zooming view; see `drawing`."""
        from cosim.report.figures.chart import draw_chart

        if chart is None:
            return Markup()
        if can_zoom() and not self.brief:
            self.zooms[key] = zoom_data(chart)
        return self.figure(key, draw_chart(chart), **texts)

    def drawing(
        self,
        key: str,
        svg: Markup,
        caption: str = "",
        *,
        alt: str,
        small: bool = False,
        caller: Callable[[], str] = str,
    ) -> Markup:
        """Return the HTML of a figure in SVG; a template's call block is its caption."""
        texts: dict[str, Any] = {"caption": caption or caller().strip(), "alt": alt}
        texts |= {"number": _NUMBER, "small": small, "zoom": key in self.zooms}
        return render("figure.html.j2", key=key, svg=svg, **texts)


@dataclass
class Tables:
    """Tables of a page, all written as CSV; caption and note by file name."""

    folder: Path
    place: Callable[[Path], Path] = lambda path: path  # of temporary files
    written: dict[str, tuple[str, str]] = field(default_factory=dict)

    def csv(self, table: ResultTable, name: str) -> str:
        """Write a table as CSV only."""
        file = f"{name}.csv"
        with written_whole(self.place(self.folder / file)) as temporary:
            temporary.write_text(csv_text(table), encoding="utf-8")
        self.written[file] = table.caption, table.note
        return ""

    def table(self, result_table: ResultTable, name: str, *, brief: bool = False) -> Markup:
        """Write a table as CSV and return its HTML."""
        self.csv(result_table, name)
        return table(result_table, brief=brief)


def render(template: str, *, folder: Path | None = None, **values: Any) -> Markup:
    """Return HTML from a template, also in `folder`; values except markup are escaped."""
    return Markup(render_template(template, (*filter(None, [folder]), *_FOLDERS), **values))


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
    """Write a self-contained page of sections."""
    from cosim.report.figures.style import VARIABLES

    page = render(
        "report.html.j2",
        title=title,
        heading=heading,
        sections=[Section(key="summary", title="Summary", html=summary), *sections],
        zooms=zooms or {},
        library=library,
        injected=[unpack_text(library)] if library else [],
        palette=VARIABLES,
    )
    numbers = count(1)
    numbered_page = re.sub(_NUMBER, lambda _: str(next(numbers)), page)
    with written_whole(path) as temporary:
        temporary.write_text(numbered_page, encoding="utf-8")


def table(table: ResultTable, *, brief: bool = False) -> Markup:
    """Return a table with a button that copies it; `brief` ones are printed."""
    return render("table.html.j2", table=table, symbols=MARKS, brief=brief)


def paragraph(text: str | Markup, *, note: bool = False) -> Markup:
    """Return a paragraph."""
    return Markup('<p class="note">{}</p>' if note else "<p>{}</p>").format(text)


def join_parts(*parts: Markup) -> Markup:
    """Return parts one after the other."""
    return Markup("\n").join(parts)
