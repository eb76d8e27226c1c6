"""Tables of results: columns, rows, format of numbers, and their text as CSV and Markdown."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import StringIO
from math import floor, log10

from markupsafe import Markup

from cosim.loop.closed_loop import StandIn
from cosim.study.scores import MEASURED_START
from hesr_model.audit.properties import MARKS
from hesr_model.fitting.estimator import registry


@dataclass(frozen=True, kw_only=True)
class TableCell:
    """Cell of a table: text in lines, value with all digits, small notes, and a mark per line."""

    text: str
    value: float | None = None
    best: bool = False
    notes: tuple[str, ...] = ()
    marks: tuple[str, ...] = ()

    @property
    def side_note(self) -> str:
        """Notes in one line."""
        further_notes = [f"({note})" for note in self.notes[1:]]
        return " ".join([*self.notes[:1], *further_notes])

    @property
    def marked(self) -> list[tuple[str, str]]:
        """Marks with their lines; only one if no joint has a result."""
        pairs = list(zip(self.marks, self.text.split("\n"), strict=True))
        has_no_result = len(set(self.marks)) == 1 and self.marks[0] in ("not applicable", "not run")
        if has_no_result:
            return pairs[:1]
        return pairs


@dataclass(frozen=True, kw_only=True)
class TableRow:
    """Row of a table; without cells it is a heading of the rows below."""

    head: str | Markup
    cells: Sequence[TableCell] = ()
    quiet: bool = False


def make_row(head: str | Markup, *cells: TableCell | str | Markup, quiet: bool = False) -> TableRow:
    """Return a row."""
    row_cells = [cell if isinstance(cell, TableCell) else TableCell(text=cell) for cell in cells]
    return TableRow(head=head, cells=row_cells, quiet=quiet)


@dataclass(frozen=True, kw_only=True)
class ResultTable:
    """A table; `words` are columns, from 1, aligned to the left in a numeric table.

    `section` is the title of its section on the page of a result, by default the caption.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[TableRow]
    numeric: bool = True
    words: Sequence[int] = ()
    note: str = ""
    section: str = ""

    @property
    def noted(self) -> bool:
        """Whether some cells have notes."""
        return any(_have_notes(row.cells) for row in self.rows)

    @property
    def width(self) -> int:
        """Number of columns, including those of notes."""
        if self.noted:
            return 2 * len(self.head) - 1
        return len(self.head)


def _have_notes(cells: Iterable[TableCell]) -> bool:
    return any(cell.notes for cell in cells)


def joints(count: int) -> tuple[str, ...]:
    """Return short names of joints."""
    return tuple(f"J{k}" for k in range(1, count + 1))


def join_law_titles(laws: Sequence[str]) -> str:
    """Return the titles of laws with the short names of their joints; one law of all alone."""
    joints_by_title: dict[str, list[str]] = {}
    for law_name, name in zip(laws, joints(len(laws)), strict=True):
        joints_by_title.setdefault(title(law_name), []).append(name)
    if len(joints_by_title) == 1:
        return next(iter(joints_by_title))
    return "; ".join(
        f"{law_name} on {', '.join(joint_names)}"
        for law_name, joint_names in joints_by_title.items()
    )


def title(law_name: str) -> str:
    """Return the title of a law; a variant keeps its name."""
    if law_name in set(StandIn):
        return StandIn(law_name).words
    laws = registry()
    name = law_name.removesuffix(MEASURED_START)
    if name not in laws:
        return law_name
    return laws[name].title + law_name[len(name) :]


def number(value: float | None, digits: int = 3, *, notes: tuple[str, ...] = ()) -> TableCell:
    """Return the cell of a number with significant digits."""
    if value is None or value != value:
        return TableCell(text="–")
    return TableCell(text=format_significant(value, digits), value=value, notes=notes)


def fixed_cell(
    value: float | None, decimals: int, *, best: bool = False, notes: tuple[str, ...] = ()
) -> TableCell:
    """Return the cell of a number with fixed decimals."""
    if value is None or value != value:
        return TableCell(text="–")
    text = f"{value:.{decimals}f}".replace("-", "−")
    return TableCell(text=text, value=value, best=best, notes=notes)


def decimals(values: Iterable[float | None], digits: int = 3) -> int:
    """Return the decimals that show the smallest number."""
    # NaN is not equal to itself; 0 has no first digit.
    sizes = [abs(v) for v in values if v is not None and v == v and v != 0.0]
    if not sizes:
        return 0
    return max(0, digits - 1 - floor(log10(min(sizes))))


def format_significant(value: float, digits: int = 3) -> str:
    """Return a number with significant digits, including trailing zeros."""
    text = f"{value:#.{digits}g}"
    if "e" in text and 1e-4 <= abs(value) < 1e6:
        text = f"{value:.0f}"
    elif "e" in text:
        text = f"{value:.{digits - 1}e}"
    return text.rstrip(".").replace("-", "−")


def csv_text(table: ResultTable) -> str:
    """Return a table as CSV; a missing number is empty, notes and row groups have columns."""
    has_groups = any(not row.cells for row in table.rows)
    columns = zip(*(row.cells for row in table.rows if row.cells), strict=True)
    columns_have_notes = list(map(_have_notes, columns))
    head = [table.head[0]]
    for name, has_notes in zip(table.head[1:], columns_have_notes, strict=True):
        head.append(name)
        if has_notes:
            head.append(f"{name}: note")
    lines = [head]
    group = ""
    groups = ["group"]
    for row in table.rows:
        if not row.cells:
            group = _to_plain_text(row.head)
            continue
        fields = [_to_plain_text(row.head)]
        for cell, has_notes in zip(row.cells, columns_have_notes, strict=True):
            fields.append(_value(cell))
            if has_notes:
                fields.append("; ".join(cell.notes))
        lines.append(fields)
        groups.append(group)
    if has_groups:
        lines = [[name, *fields] for name, fields in zip(groups, lines, strict=True)]
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def _value(cell: TableCell) -> str:
    if cell.value is not None:
        return str(cell.value)
    if cell.marks:
        return "; ".join(f"{mark} {figure}".strip() for mark, figure in cell.marked)
    if cell.text == "–":
        return ""
    return _to_plain_text(cell.text)


def _to_plain_text(text: str | Markup) -> str:
    if isinstance(text, Markup):
        return text.striptags()
    return str(text)


def markdown(table: ResultTable) -> str:
    """Return a table with its caption; notes follow in brackets."""
    lines = []
    if table.caption:
        caption = table.caption.replace("; small: ", "; in brackets: ")
        lines += [f"{caption}.", ""]
    alignments = [_align(table, k) for k in range(len(table.head))]
    lines += [_join_cells(table.head), _join_cells(alignments)]
    for row in table.rows:
        head = str(row.head) if row.cells else f"**{row.head}**"
        texts = [head, *map(_text, row.cells)]
        missing_count = len(table.head) - len(texts)
        lines.append(_join_cells([*texts, *[""] * missing_count]))
    if table.note:
        lines += ["", table.note]
    return "\n".join(lines) + "\n"


def _align(table: ResultTable, column: int) -> str:
    """Return the mark of Markdown that aligns a column: numbers to the right."""
    if table.numeric and column > 0 and column not in table.words:
        return "---:"
    return "---"


def _join_cells(texts: Sequence[str]) -> str:
    """Return a line of a table of Markdown."""
    escaped_texts = [text.replace("|", r"\|") for text in texts]
    return f"| {' | '.join(escaped_texts)} |"


def _text(cell: TableCell) -> str:
    """Return a cell as Markdown."""
    if cell.marks:
        return "<br>".join(f"{line}{MARKS[mark]}" for mark, line in cell.marked)
    text = cell.text
    if cell.best:
        text = f"**{text}**"
    if cell.notes:
        text += f" ({', '.join(cell.notes)})"
    return text
