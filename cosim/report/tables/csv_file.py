"""Tables as CSV: all digits; notes and row groups in columns of their own."""

import csv
from io import StringIO

from markupsafe import Markup

from cosim.report.tables.table import ResultTable, TableCell


def csv_text(table: ResultTable) -> str:
    """Return a table as CSV; a missing number is empty."""
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
