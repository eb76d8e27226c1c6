"""Tables as CSV, with all digits, and as Markdown, for pages in a repository."""

import csv
from collections.abc import Sequence
from io import StringIO

from markupsafe import Markup

from cosim.report.tables.table import ResultTable, TableCell
from hesr_model.audit.properties import MARKS


def csv_text(table: ResultTable) -> str:
    """Return a table as CSV; a missing number is empty, notes and row groups have columns."""
    grouped = any(not row.cells for row in table.rows)
    columns = zip(*(row.cells for row in table.rows if row.cells), strict=True)
    noted = [any(cell.notes for cell in column) for column in columns]
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = [table.head[0]]
    for name, has_notes in zip(table.head[1:], noted, strict=True):
        head += [name, f"{name}: note"] if has_notes else [name]
    writer.writerow(["group", *head] if grouped else head)
    group = ""
    for row in table.rows:
        if not row.cells:
            group = _plain(row.head)
            continue
        fields = [_plain(row.head)]
        for cell, has_notes in zip(row.cells, noted, strict=True):
            fields += [_value(cell), *(["; ".join(cell.notes)] if has_notes else [])]
        writer.writerow([group, *fields] if grouped else fields)
    return text.getvalue()


def _value(cell: TableCell) -> str:
    if cell.value is not None:
        return str(cell.value)
    if cell.marks:
        return "; ".join(f"{mark} {figure}".strip() for mark, figure in cell.marked)
    return "" if cell.text == "–" else _plain(cell.text)


def _plain(text: str | Markup) -> str:
    return text.striptags() if isinstance(text, Markup) else str(text)


def markdown(table: ResultTable) -> str:
    """Return a table with its caption; notes follow in brackets."""
    side = "---:" if table.numeric else "---"
    sides = [side if k and k not in table.words else "---" for k in range(len(table.head))]
    rows = [
        (f"**{row.head}**" if not row.cells else str(row.head), *map(_text, row.cells))
        for row in table.rows
    ]
    whole = [(*row, *[""] * (len(table.head) - len(row))) for row in rows]
    lines = [_line(row) for row in (table.head, sides, *whole)]
    shown = table.caption.replace("; small: ", "; in brackets: ")
    caption = [f"{shown}.", ""] if shown else []
    return "\n".join([*caption, *lines, *(["", table.note] if table.note else [])]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _text(cell: TableCell) -> str:
    if cell.marks:
        return "<br>".join(f"{line}{MARKS[mark]}" for mark, line in cell.marked)
    text = f"**{cell.text}**" if cell.best else cell.text
    return f"{text} ({', '.join(cell.notes)})" if cell.notes else text
