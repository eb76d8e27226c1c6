"""Small HTML tables for notebooks (``_repr_html_``)."""

from collections.abc import Iterable, Sequence

from markupsafe import Markup


def table(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return an HTML table with escaped cells; numbers get four digits."""
    lines = [Markup("<table><caption>{}</caption>").format(caption)]
    lines.append(_row("th", head))
    lines += [_row("td", row) for row in rows]
    return str(Markup("\n").join([*lines, Markup("</table>")]))


def _row(kind: str, cells: Iterable[object]) -> Markup:
    shown = (f"{cell:.4g}" if isinstance(cell, float) else cell for cell in cells)
    written = Markup("").join(Markup(f"<{kind}>{{}}</{kind}>").format(cell) for cell in shown)
    return Markup("<tr>{}</tr>").format(written)
