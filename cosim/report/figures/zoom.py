"""Zooming views of charts by Bokeh, if installed; its library is part of the page."""

import base64
import json
import re
import zlib
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cosim.report.figures.chart import Chart, Line, Panel

_MODEL = re.compile(r'"p\d{4,}"')
_PIXELS = 105  # pixels per inch of a row's height
_MOST_VALUES = 50_000  # maximum number of values of a chart; more are thinned
_ROUNDING = np.uint32(0xFFFFE000)  # kept bits of a value; others hardly compress


def can_zoom() -> bool:
    """Return whether Bokeh is installed."""
    return find_spec("bokeh") is not None


def zoom_data(chart: "Chart") -> str:
    """Return the data of a chart for Bokeh, packed as text."""
    from bokeh.embed import json_item
    from bokeh.layouts import gridplot

    values = sum(len(line.y) for row in chart.rows for p in row for line in p.lines)
    every, sources = values // _MOST_VALUES + 1, dict[int, Any]()
    plots = [[_plot(panel, chart.height) for panel in row] for row in chart.rows]
    names: dict[str, Any] = {}
    for row, of_row in zip(plots, chart.rows, strict=True):
        for plot, panel in zip(row, of_row, strict=True):
            plot.x_range = plots[0][0].x_range
            for line in panel.lines:
                _draw(plot, line, sources, every)
                style = {"colour": line.stroke.colour, "dash": line.stroke.dash}
                names.setdefault(line.name, style)
    for plot in plots[-1]:
        plot.xaxis.axis_label = chart.x
    grid = gridplot(
        plots, toolbar_location="above", sizing_mode="stretch_width", toolbar_options={"logo": None}
    )
    data = {"item": json_item(grid), "names": names}
    return packed(_renumbered(json.dumps(data, separators=(",", ":"))))


def _renumbered(text: str) -> str:
    numbers: dict[str, str] = {}
    return _MODEL.sub(lambda m: numbers.setdefault(m[0], f'"p{len(numbers) + 1}"'), text)


def library() -> str:
    """Return Bokeh's script, packed as text."""
    from bokeh.resources import Resources

    inline = Resources(mode="inline", components=["bokeh"])
    # Its last line writes to the console.
    return packed("\n".join(js for js in inline.js_raw if not js.startswith("Bokeh.set_log_level")))


def packed(text: str) -> str:
    """Return text compressed (zlib) and in base64."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def unpacked(text: str) -> str:
    """Return the text that was packed."""
    return zlib.decompress(base64.b64decode(text)).decode()


def _draw(plot: Any, line: "Line", sources: dict[int, Any], every: int) -> None:
    from bokeh.models import ColumnDataSource

    if id(line.x) not in sources:
        sources[id(line.x)] = ColumnDataSource({"x": line.x[::every].astype(np.float32)})
    source = sources[id(line.x)]
    name = f"y{len(source.data)}"
    y = line.y[::every].astype(np.float32).view(np.uint32) & _ROUNDING
    source.add(y.view(np.float32), name)
    plot.line(
        "x",
        name,
        source=source,
        name=line.name,
        color=line.stroke.colour,
        width=max(line.stroke.width, 1.2),
        line_dash=[max(round(length), 1) for length in line.stroke.dash] or "solid",
    )


def _plot(panel: "Panel", inches: float) -> Any:
    from bokeh.models.annotations.geometry import Span
    from bokeh.models.annotations.labels import Title
    from bokeh.plotting import figure

    from cosim.report.figures.style import INK, LINE, SOFT

    plot = figure(
        height=round(_PIXELS * inches),
        y_axis_label=panel.y,
        title=Title(text=panel.title, text_color=INK, text_font_size="13px"),
        tools="box_zoom,pan,xwheel_zoom,reset,save",
        active_drag="box_zoom",
        active_scroll=None,
        background_fill_alpha=0,
        border_fill_alpha=0,
        outline_line_color=None,
        min_border_left=52,
    )
    for place, _ in panel.marks:
        mark = Span(location=place, dimension="height", line_color=INK, line_dash="dashed")
        plot.add_layout(mark)
    for one in (*plot.xaxis, *plot.yaxis):
        one.axis_label_text_color = INK
        one.axis_label_text_font_style = "normal"
        one.axis_label_text_font_size = "12px"
        one.major_label_text_color = SOFT
        one.axis_line_color = one.major_tick_line_color = one.minor_tick_line_color = LINE
    plot.grid.grid_line_color = LINE
    return plot
