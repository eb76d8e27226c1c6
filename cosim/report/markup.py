"""Parts of the page: sections, tables, figures and numbers."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from cosim.report.zoom import zoom_data
from fmu_src.html import TEMPLATES, rendered

if TYPE_CHECKING:
    from cosim.figures.chart import Chart, Figure

_FOLDERS = (
    Path(__file__).parent / "templates",
    TEMPLATES,  # the style of an FMU's pages is ours as well
)


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the page: what links call it, its heading, its HTML."""

    key: str
    title: str
    html: Markup


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A cell of a table.

    Attributes
    ----------
    text : what is shown.
    value : the number behind it with all digits, for the CSV.
    best : whether it stands out.
    beside : shown small in a column behind it.
    """

    text: str
    value: float | None = None
    best: bool = False
    beside: str = ""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table: its head and its cells; a heading over the rows below has no cells."""

    head: str | Markup
    cells: Sequence[Cell | str | Markup] = ()
    quiet: bool = False


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table.

    Attributes
    ----------
    caption : what it shows.
    head : names of the columns, that of the rows' heads first.
    rows : of the body.
    numeric : whether cells stand to the right, as numbers do.
    words : places of the columns, from 1, whose cells are words and stand to the left even so.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Row]
    numeric: bool = True
    words: Sequence[int] = ()

    @property
    def noted(self) -> bool:
        """Whether some cells have something beside their text."""
        return any(getattr(cell, "beside", "") for row in self.rows for cell in row.cells)

    @property
    def width(self) -> int:
        """Number of columns: what is beside a number has one of its own."""
        return 2 * len(self.head) - 1 if self.noted else len(self.head)


@dataclass
class Pictures:
    """Draws the figures of a page, numbers them, and writes them as PDF and PNG.

    Attributes
    ----------
    folder : in which they are written.
    zooms : data of the views that zoom, by key of the figure.
    """

    folder: Path
    zooms: dict[str, str] = field(default_factory=dict)
    _count: int = 0

    def figure(self, key: str, picture: "Figure", caption: str, *, alt: str) -> Markup:
        """Return a figure.

        Parameters
        ----------
        key : name of its files, and of the figure in links.
        picture : as drawn.
        caption : what is to be seen.
        alt : what it shows, for readers who cannot see it.
        """
        from cosim.figures.style import svg, write

        write(picture, self.folder / key)
        return self.drawing(key, Markup(svg(picture, key)), caption, alt=alt)

    def chart(self, key: str, chart: "Chart", caption: str, *, alt: str) -> Markup:
        """Return a figure of lines, which can be zoomed."""
        from cosim.figures.chart import drawn

        self.zooms[key] = zoom_data(chart)
        return self.figure(key, drawn(chart), caption, alt=alt)

    def drawing(self, key: str, svg: Markup, caption: str, *, alt: str) -> Markup:
        """Return a figure that is SVG already."""
        self._count += 1
        return render(
            "figure.html.j2", key=key, svg=svg, caption=caption, alt=alt, number=self._count,
            zoom=key in self.zooms,
        )  # fmt: skip


def render(template: str, **values: Any) -> Markup:
    """Return HTML from a template; what it is given is escaped, but for markup."""
    return Markup(rendered(template, _FOLDERS, **values))


def table(what: Table) -> Markup:
    """Return a table with a button that copies it."""
    return render("table.html.j2", table=what)


def paragraph(text: str | Markup, *, note: bool = False) -> Markup:
    """Return a paragraph."""
    return Markup('<p class="note">{}</p>' if note else "<p>{}</p>").format(text)


def heading(text: str) -> Markup:
    """Return a heading within a section."""
    return Markup("<h3>{}</h3>").format(text)


def details(summary: str, *parts: Markup) -> Markup:
    """Return what is folded away."""
    return Markup("<details><summary>{}</summary>{}</details>").format(
        summary, Markup("").join(parts)
    )


def joined(*parts: Markup) -> Markup:
    """Return parts one after the other."""
    return Markup("\n").join(parts)


def number(value: float | None, digits: int = 3, *, best: bool = False, beside: str = "") -> Cell:
    """Return the cell of a number, rounded to so many significant digits."""
    if value is None or value != value:
        return Cell(text="–")
    return Cell(text=rounded(value, digits), value=value, best=best, beside=beside)


def fixed(value: float | None, decimals: int, *, best: bool = False, beside: str = "") -> Cell:
    """Return the cell of a number with so many decimals, so that a column is aligned."""
    if value is None or value != value:
        return Cell(text="–")
    text = f"{value:.{decimals}f}".replace("-", "−")
    return Cell(text=text, value=value, best=best, beside=beside)


def decimals(values: Iterable[float | None], digits: int = 3) -> int:
    """Return how many decimals show the least of some numbers with so many digits."""
    sizes = [abs(v) for v in values if v is not None and v == v and v != 0.0]
    return max(0, digits - 1 - floor(log10(min(sizes)))) if sizes else 0


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, zeros at its end kept."""
    text = f"{value:#.{digits}g}"
    if "e" in text:
        text = f"{value:.{digits - 1}e}" if not 1e-4 <= abs(value) < 1e6 else f"{value:.0f}"
    return text.rstrip(".").replace("-", "−")


def by_inputs(laws: Sequence[str], inputs: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the laws in classes of equal inputs, the fewest inputs first."""
    classes: dict[str, list[str]] = {}
    for law in laws:
        classes.setdefault(inputs.get(law, ""), []).append(law)
    # What has no inputs of its own, as the true friction, stands last.
    return dict(sorted(classes.items(), key=lambda c: (not c[0], c[0].count(","))))
