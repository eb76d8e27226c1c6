"""Charts of lines over a common axis, for figures and zooming views."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Figure  # also for type hints of pages
from matplotlib.lines import Line2D
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from cosim.report.figures.style import INK, SOFT, Stroke, apply_style
from hesr_model.support.arrays import Array

_COLUMNS = 520
_ROWS = 4
"""Columns of extreme values of a line over the whole width, fewer in more rows."""
_NAMES_PER_ROW = 6  # names in a row of a legend
_RIGHT_MARGIN = 0.16  # right margin of a figure [in]


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Line of points (N,)."""

    name: str
    x: Array
    y: Array
    stroke: Stroke


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """Axes with lines; `marks` are labelled places on the horizontal axis."""

    title: str
    y: str
    lines: tuple[Line, ...]
    marks: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """Rows of panels [in] over a common axis; `window` is its part in the figure."""

    x: str
    rows: tuple[tuple[Panel, ...], ...]
    height: float = 1.7
    window: tuple[float, float] | None = None

    @property
    def lines(self) -> list[Line]:
        """Lines of all panels."""
        lines: list[Line] = []
        for row in self.rows:
            for panel in row:
                lines += panel.lines
        return lines


def _make_figure(size: tuple[float, float]) -> Figure:
    return Figure(figsize=size)


def show_figure(size: tuple[float, float]) -> Figure:
    """Return a figure of pyplot [in], which a notebook shows."""
    from matplotlib import pyplot  # slow to import

    return pyplot.figure(figsize=size)


def draw_chart(
    chart: Chart,
    width: float = 9.0,
    make_figure: Callable[[tuple[float, float]], Figure] = _make_figure,
) -> Figure:
    """Draw a chart, with one legend above all panels."""
    rows = len(chart.rows)
    columns = len(chart.rows[0])
    max_columns = min(_COLUMNS, _COLUMNS * _ROWS // rows)
    size = (width, chart.height * rows + 0.5)
    name_count = len({line.name for line in chart.lines})
    top_margin = 0.28
    if name_count > 1:  # there is a legend
        top_margin += 0.18 * ceil(name_count / _NAMES_PER_ROW)
    margins = (0.62, top_margin, 0.42)
    with apply_style():
        figure, axes = grid(size, rows, columns, margins, make_figure=make_figure, sharex=True)
        for row, panels in zip(axes, chart.rows, strict=True):
            for axis, panel in zip(row, panels, strict=True):
                _draw(axis, panel, chart.window, max_columns // columns)
        for axis in axes[-1]:
            axis.set_xlabel(chart.x)
        legend(figure, chart.lines)
    return figure


def grid(
    size: tuple[float, float],
    rows: int,
    columns: int,
    margins: tuple[float, float, float],
    gaps: tuple[float, float] = (0.66, 0.32),
    make_figure: Callable[[tuple[float, float]], Figure] = _make_figure,
    **subplot_options: Any,
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure and its axes (rows, columns), with options of `Figure.subplots`.

    Places follow from the figure's size, left, top and bottom margin, and gaps [in].
    """
    # Laying out axes by their texts takes as long as drawing them.
    width, height = size
    left_margin, top_margin, bottom_margin = margins
    horizontal_gap, vertical_gap = gaps
    axes_width = (width - left_margin - _RIGHT_MARGIN - (columns - 1) * horizontal_gap) / columns
    axes_height = (height - top_margin - bottom_margin - (rows - 1) * vertical_gap) / rows
    places = {
        "left": left_margin / width,
        "right": 1.0 - _RIGHT_MARGIN / width,
        "top": 1.0 - top_margin / height,
        "bottom": bottom_margin / height,
        "wspace": horizontal_gap / axes_width,
        "hspace": vertical_gap / axes_height,
    }
    figure = make_figure(size)
    return figure, figure.subplots(
        rows, columns, squeeze=False, gridspec_kw=places, **subplot_options
    )


def legend(figure: Figure, lines: Sequence[Line]) -> None:
    """Name all lines above a figure, each once."""
    strokes: dict[str, Stroke] = {}
    for line in lines:
        strokes.setdefault(line.name, line.stroke)
    if len(strokes) < 2:
        return
    figure.legend(
        list(map(proxy, strokes.values())),
        list(strokes),
        loc="outside upper left",
        ncols=min(len(strokes), _NAMES_PER_ROW),
        borderaxespad=0.0,
        handlelength=2.6,
        columnspacing=1.6,
    )


def proxy(stroke: Stroke) -> Line2D:
    """Return a line for a legend."""
    return Line2D(
        [], [], color=stroke.colour, linewidth=max(stroke.width, 1.6), linestyle=_dash(stroke)
    )


def plot(axis: Axes, line: Line, columns: int = _COLUMNS) -> None:
    """Draw a line, thinned to columns."""
    x, y = thin_line(line.x, line.y, columns)
    stroke = line.stroke
    axis.plot(x, y, color=stroke.colour, linewidth=stroke.width, linestyle=_dash(stroke))


def thin_line(x: Array, y: Array, columns: int) -> tuple[Array, Array]:
    """Keep the extreme values in each column of a long line (N,) with increasing x."""
    if len(x) <= 2 * columns or np.any(np.diff(x) < 0.0):
        return x, y
    edges = np.linspace(0, len(x), columns + 1).astype(int)
    extreme_rows = {0, len(x) - 1}
    for start, stop in pairwise(edges):
        extreme_rows |= {
            start + int(np.argmin(y[start:stop])),
            start + int(np.argmax(y[start:stop])),
        }
    rows = np.array(sorted(extreme_rows))
    return x[rows], y[rows]


def _draw(axis: Axes, panel: Panel, window: tuple[float, float] | None, columns: int) -> None:
    for line in panel.lines:
        rows = slice(None)
        if window:
            start, stop = np.searchsorted(line.x, window)
            rows = slice(int(start), int(stop) + 1)
        plot(axis, replace(line, x=line.x[rows], y=line.y[rows]), columns)
    for place, label in panel.marks:
        axis.axvline(place, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        axis.annotate(
            label,
            (place, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(4, -2),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=SOFT,
        )
    axis.set(title=panel.title, ylabel=panel.y)


def _dash(stroke: Stroke) -> LineStyleType:
    if not stroke.dash:
        return "solid"
    return (0, stroke.dash)
