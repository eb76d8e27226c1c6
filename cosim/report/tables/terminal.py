"""Tables in a terminal; columns that do not fit follow in further blocks."""

from collections.abc import Iterator, Sequence
from itertools import chain

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table
from rich.text import Text

from cosim.report.tables.table import ResultTable, TableCell
from hesr_model.audit.properties import MARKS

_COLOURS = {"pass": "green", "fail": "red"}


def show(*contents: "ResultTable | str") -> None:
    """Print tables and text."""
    console = Console()
    for table_or_text in contents:
        if isinstance(table_or_text, ResultTable):
            console.print(TerminalTable(table_or_text))
        else:
            console.print(table_or_text)


class TerminalTable:
    """A table for rich that never truncates figures."""

    def __init__(self, table: ResultTable) -> None:
        self._table = table
        self._heads = []
        self._cells = []
        for row in table.rows:
            self._heads.append(Text(str(row.head), style="" if row.cells else "italic"))
            self._cells.append(list(map(_text, row.cells)))

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Yield the caption, a table for each block of columns, and the note."""
        if self._table.caption:
            yield Text(self._table.caption, style="bold")
        for widths in self._blocks(options.max_width):
            yield self._block(widths)
        note = ""
        if self._table.note:
            note = f"{self._table.note}\n"
        yield Text(note)

    def _blocks(self, max_width: int) -> Iterator[dict[int, int | None]]:
        head = self._table.head
        if not self._table.numeric:
            yield dict.fromkeys(range(len(head)))  # sentences may be folded
            return
        first_width = _width([Text(head[0]), *self._heads])
        widths = {}
        for k, name in enumerate(head[1:], start=1):
            texts = [*(row[k - 1] for row in self._cells if row), *map(Text, name.split())]
            widths[k] = min(max_width // 2, _width(texts))
        if first_width + sum(widths.values()) + len(widths) > max_width:
            first_width = min(first_width, max_width // 2, max_width - 1 - max(widths.values()))
        block: dict[int, int | None] = {0: first_width}
        used_width = first_width
        for k, width in widths.items():
            if len(block) > 1 and used_width + 1 + width > max_width:
                yield block
                block = {0: first_width}
                used_width = first_width
            block[k] = width
            used_width += 1 + width
        yield block

    def _block(self, widths: dict[int, int | None]) -> Table:
        rich_table = Table(box=box.SIMPLE_HEAD, padding=(0, 0), pad_edge=False, show_edge=False)
        for k, width in widths.items():
            is_right_aligned = k > 0 and self._table.numeric and k not in self._table.words
            rich_table.add_column(
                Text(self._table.head[k]),
                justify="right" if is_right_aligned else "left",
                overflow="fold",
                width=width,
                no_wrap=k == 0 and width is None,
            )
        for head, cells in zip(self._heads, self._cells, strict=True):
            rich_table.add_row(head, *(cells[k - 1] for k in widths if k) if cells else ())
        return rich_table


def _width(texts: Sequence[Text]) -> int:
    lines = chain.from_iterable(text.plain.split("\n") for text in texts)
    return max(map(cell_len, lines), default=0)


def _text(cell: TableCell) -> Text:
    lines = [Text(cell.text, style="bold" if cell.best else "")]
    if cell.marks:
        lines = [
            Text(line).append(MARKS[mark], _COLOURS.get(mark, ""))
            for mark, line in zip(cell.marks, cell.text.split("\n"), strict=True)
        ]
    return Text("\n").join([*lines, *(Text(note, style="dim") for note in cell.notes)])
