"""Tables as Markdown, for pages in a repository."""

from collections.abc import Sequence

from cosim.report.tables.table import ResultTable, TableCell
from hesr_model.audit.properties import MARKS


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
