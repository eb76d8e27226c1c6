"""Zooming views of charts by Bokeh, if installed; its library is part of the page."""

import base64
import json
import zlib
from importlib.util import find_spec
from math import ceil, isfinite, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hesr_model.support.arrays import Array

if TYPE_CHECKING:
    from cosim.report.figures.chart import Chart, Line, Panel

_PIXELS = 105  # pixels per inch of a row's height
_MAX_VALUES = 50_000  # maximum number of values of a chart; more are thinned
_DIGITS = 5  # digits of the largest value of a line; more hardly compress
_LEVEL = 6  # of compression


def can_zoom() -> bool:
    """Return whether Bokeh is installed."""
    return find_spec("bokeh") is not None


def zoom_data(chart: "Chart") -> str:
    """Return the data of a chart, packed as text; the page makes Bokeh's models of it."""
    step = sum(len(line.y) for line in chart.lines) // _MAX_VALUES + 1
    times = {id(line.x): line.x for line in chart.lines}
    numbers = {key: k for k, key in enumerate(times)}

    def describe_line(line: "Line") -> dict[str, Any]:
        return {
            "name": line.name,
            "time": numbers[id(line.x)],
            "y": _round_values(line.y[::step]),
            "colour": line.stroke.colour,
            "width": max(line.stroke.width, 1.2),
            "dash": [max(round(length), 1) for length in line.stroke.dash],
        }

    def describe_panel(panel: "Panel") -> dict[str, Any]:
        panel_lines = list(map(describe_line, panel.lines))
        marks = [place for place, _ in panel.marks]
        return {"title": panel.title, "y": panel.y, "lines": panel_lines, "marks": marks}

    data = {
        "x": chart.x,
        "height": round(_PIXELS * chart.height),
        "times": [_round_values(x[::step]) for x in times.values()],
        "rows": [list(map(describe_panel, row)) for row in chart.rows],
        "names": {
            chart_line.name: {"colour": chart_line.stroke.colour, "dash": chart_line.stroke.dash}
            for chart_line in chart.lines
        },
    }
    return pack_text(json.dumps(data, separators=(",", ":")))


def library() -> str:
    """Return Bokeh's script, packed as text."""
    folder = Path(getattr(find_spec("bokeh"), "origin", "")).parent
    script = folder / "server" / "static" / "js" / "bokeh.min.js"
    return pack_text(script.read_text(encoding="utf-8"))


def pack_text(text: str) -> str:
    """Return text compressed (zlib) and in base64."""
    return base64.b64encode(zlib.compress(text.encode(), _LEVEL)).decode()


def unpack_text(text: str) -> str:
    """Return the text that was packed."""
    return zlib.decompress(base64.b64decode(text)).decode()


def _round_values(values: Array) -> list[float | None]:
    size = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0)) or 1.0
    rounded = np.round(values, _DIGITS - ceil(log10(size))).tolist()
    return [value if isfinite(value) else None for value in rounded]  # JSON has no others
