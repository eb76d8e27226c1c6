"""Tables for pandas, xarray and notebooks; libraries are imported on use."""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

from markupsafe import Markup

from hesr_model.errors import ConfigError
from hesr_model.support.arrays import Array


def pandas_frame(columns: Mapping[str, Any], index: str | None = None) -> Any:
    """Return columns (N,) as a `pandas.DataFrame`."""
    frame = _library("pandas").DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


def xarray_dataset(
    t: Array, signals: Mapping[str, tuple[Array, str]], joints: Sequence[str], **about: Any
) -> Any:
    """Return signals (N, n) with units as an `xarray.Dataset` over t [s] and joints."""
    return _library("xarray").Dataset(
        {name: (("t", "joint"), values, {"units": u}) for name, (values, u) in signals.items()},
        coords={"t": ("t", t, {"units": "s"}), "joint": list(joints)},
        attrs=about,
    )


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigError(f"{name} is not installed; pip install 'hesr[tables]'.") from error


def html_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return an HTML table with escaped cells; numbers get four digits."""
    lines = [Markup("<table><caption>{}</caption>").format(caption)]
    lines.append(_row("th", head))
    lines += [_row("td", row) for row in rows]
    return str(Markup("\n").join([*lines, Markup("</table>")]))


def _row(kind: str, cells: Iterable[object]) -> Markup:
    shown = (f"{cell:.4g}" if isinstance(cell, float) else cell for cell in cells)
    written = Markup("").join(Markup(f"<{kind}>{{}}</{kind}>").format(cell) for cell in shown)
    return Markup("<tr>{}</tr>").format(written)
