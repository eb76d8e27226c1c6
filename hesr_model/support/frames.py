"""Tables for pandas, xarray and notebooks; libraries are imported on use."""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

from markupsafe import Markup

from hesr_model.errors import ConfigError
from hesr_model.support.extras import install_command


def pandas_frame(columns: Mapping[str, Any], index: str | None = None) -> Any:
    """Return columns (N,) as a `pandas.DataFrame`."""
    frame = import_library("pandas").DataFrame(dict(columns))
    if index is None:
        return frame
    return frame.set_index(index)


def import_library(name: str) -> Any:
    """Import pandas or xarray; raise ConfigError if it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigError(f"{name} is not installed; {install_command('tables')}.") from error


def html_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return an HTML table with escaped cells; numbers get four digits."""
    lines = [Markup("<table><caption>{}</caption>").format(caption)]
    lines.append(_format_row("th", head))
    lines += [_format_row("td", row) for row in rows]
    return str(Markup("\n").join([*lines, Markup("</table>")]))


def _format_row(kind: str, cells: Iterable[object]) -> Markup:
    html_cells = Markup("")
    for cell in cells:
        text = f"{cell:.4g}" if isinstance(cell, float) else cell
        html_cells += Markup(f"<{kind}>{{}}</{kind}>").format(text)
    return Markup("<tr>{}</tr>").format(html_cells)
