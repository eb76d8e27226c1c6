"""Recorded drawings of the report: lines, axes, texts and legends of figures of known data.

After an intended change run `pytest tests/cosim/report/test_figures.py --regen-all` and review it.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.legend import Legend
from matplotlib.patches import Rectangle
from pytest_regressions.file_regression import FileRegressionFixture

from cosim.report.figures.chart import Chart, Line, Panel, draw_chart, thin_line
from cosim.report.figures.motions import JointView, joints, write_excitation
from cosim.report.figures.plots import loops, ratios, sheets
from cosim.report.figures.style import (
    _RC,
    DESIRED,
    MEASURED,
    Stroke,
    _inner,
    _shorten_paths,
    apply_style,
    strokes,
    svg,
    write_svg,
)
from cosim.report.figures.zoom import unpack_text, zoom_data
from hesr_model.inference.comparison import ErrorRatio as Ratio
from hesr_model.motions.excitation import Excitation
from hesr_model.motions.limits import Limits
from hesr_model.motions.trajectories import Fourier

T = np.linspace(0.0, 4.0, 801)
DQ, TAU = np.sin(3.0 * T), 5.0 * np.sign(np.cos(2.9 * T)) + T
DASHED = Stroke(colour="#0069a8", dash=(5.0, 1.5))
LONG = Line(name="long", x=T, y=TAU, stroke=DASHED)
SHORT = Line(name="short", x=T[::100], y=DQ[::100], stroke=MEASURED)


def shown(value: object) -> str:
    """Numbers with four digits; of arrays their size, ends, extremes and sum."""
    if isinstance(value, np.ndarray):
        if value.size <= 4:
            return " ".join(shown(float(x)) for x in value.ravel())
        flat = value.ravel()
        known = (flat[0], flat[-1], np.nanmin(flat), np.nanmax(flat), np.nansum(flat))
        gaps = np.count_nonzero(np.isnan(flat))
        return f"{flat.size} of {' '.join(map(shown, map(float, known)))}, {gaps} gaps"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) > 1e-9 else "0"
    if isinstance(value, list | tuple):
        return " ".join(map(shown, value))
    return str(value)


def of_legend(legend: Legend) -> Iterator[str]:
    texts = [text.get_text() for text in legend.get_texts()]
    sizes = [text.get_fontsize() for text in legend.get_texts()]
    gaps = (legend.handlelength, legend.columnspacing, legend.borderaxespad, legend.handletextpad)
    yield f"legend {shown(texts)} size {shown(sizes)} columns {legend._ncols} gaps {shown(gaps)}"
    box = legend.get_bbox_to_anchor()
    yield (
        f"  box {shown(legend.axes.transAxes.inverted().transform(box.min))}" if legend.axes else ""
    )
    for line in legend.get_lines():
        yield f"  {line.get_color()} {line.get_linewidth():g} {line.get_linestyle()}"


def of_axes(axes: Axes) -> Iterator[str]:
    if not axes.get_visible():
        yield "axes hidden"
        return
    yield f"axes {axes.get_title(loc='left')!r} size {shown(axes._left_title.get_fontsize())}"
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        label, ticks = axis.label, [tick.get_text() for tick in axis.get_ticklabels()]
        lined = [line.get_visible() for line in axis.get_gridlines()][:1]
        yield (
            f"  {name} {label.get_text()!r} size {shown(label.get_fontsize())} pad "
            f"{shown(axis.labelpad)} {axis.get_scale()} {shown(axis.get_view_interval())} "
            f"ticks {shown(np.array(axis.get_ticklocs()))} {shown(ticks)} "
            f"{shown([line.get_markersize() for line in axis.get_ticklines()][:1])} grid {lined}"
        )
    for line in axes.lines:
        x, y = (np.asarray(values, dtype=float) for values in line.get_data())
        look = (to_hex(line.get_color()), line.get_linewidth(), line.get_linestyle())
        mark = (line.get_marker(), line.get_markersize(), line.get_alpha())
        yield f"  line {shown(look)} {shown(mark)}\n    x {shown(x)}\n    y {shown(y)}"
    for bars in axes.collections:
        yield f"  bars {shown(np.array([p.vertices for p in bars.get_paths()]))} {bars.get_lw()}"
    boxes = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    if boxes:
        sizes = [[box.get_x(), box.get_width(), box.get_height()] for box in boxes]
        yield f"  {len(boxes)} boxes {shown(np.array(sizes))}"
    for text in axes.texts:
        place = shown(np.array(text.get_position(), dtype=float))
        yield f"  text {text.get_text()!r} at {place} size {shown(text.get_fontsize())}"
    if axes.get_legend():
        yield from of_legend(axes.get_legend())


def drawing(figure: Figure) -> Iterator[str]:
    """Describe a figure in lines, before its layout, which depends on fonts."""
    yield f"figure {shown(figure.get_size_inches())}"
    for text in (figure._supxlabel, figure._supylabel):
        if text is not None:
            size = shown(text.get_fontsize())
            yield f"label {text.get_text()!r} at {shown(np.array(text.get_position()))} size {size}"
    for axes in figure.axes:
        if figure.get_layout_engine() is None:
            yield f"at {shown(np.array(axes.get_position().bounds))}"
        yield from of_axes(axes)
    for legend in figure.legends:
        yield from of_legend(legend)


@pytest.fixture
def recorded(file_regression: FileRegressionFixture):
    def check(*figures: Figure) -> None:
        lines = [line for figure in figures for line in drawing(figure) if line]
        file_regression.check("\n".join(lines) + "\n", encoding="utf-8")

    return check


def test_loops_of_friction(recorded) -> None:
    laws = {f"law {k}": (DQ, TAU + k) for k in range(7)}
    recorded(loops((DQ, TAU), dict([*laws.items()][:2]), x="velocity", y="torque", points=50))
    many = loops((DQ, TAU), laws, x="velocity", y="torque", points=50)
    titles = {axes.get_title(loc="left") for axes in many.axes if axes.get_visible()}
    assert titles >= set(laws)


def test_ratios_with_intervals(recorded) -> None:
    narrow = {
        "a": [
            Ratio(value=1.1, low=0.9, high=1.2),
            Ratio(value=0.95, low=None, high=None),
        ],
        "b": [
            Ratio(value=0.8, low=0.75, high=0.85),
            Ratio(value=1.0, low=0.9, high=None),
        ],
    }
    wide = {"a": [Ratio(value=2.0 * k + 0.3, low=0.2 * k + 0.1, high=9.0) for k in range(7)]}
    names = [f"J{k}" for k in range(7)]
    recorded(ratios(narrow, ["J1", "J2"], x="ratio"))
    (axes,) = ratios(wide, names, x="ratio").axes
    shown_ratios = [float(line.get_xdata()[0]) for line in axes.lines[: len(names)]]
    assert shown_ratios == [ratio.value for ratio in wide["a"]]
    low, high = axes.get_xlim()
    assert low < wide["a"][0].low
    assert high > wide["a"][-1].value


def test_sheets_of_closed_lines() -> None:
    lines = (LONG, SHORT, Line(name="third", x=DQ, y=TAU, stroke=DESIRED), SHORT)
    panels = [("x", Panel(title=f"s{k}", y="y", lines=lines[: 2 * k + 1])) for k in range(2)]
    figure = sheets([*panels, ("x", Panel(title="all", y="y", lines=lines))])
    visible = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in visible] == ["s0", "s1", "all"]
    assert [len(axes.lines) for axes in visible] == [1, 3, 4]
    np.testing.assert_array_equal(visible[2].lines[2].get_xdata(), DQ)


def test_joints_of_logs() -> None:
    view = JointView(
        name="j1", unit="rad/s", velocities=(LONG, SHORT), friction=SHORT, covered=DQ, loads=TAU
    )
    still = JointView(
        name="j2", unit="m/s", velocities=(SHORT,), friction=None, covered=0.0 * T, loads=None
    )
    figure = joints([view, still])
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]
    assert any("j1" in title for title in titles)
    assert any("j2" in title for title in titles)
    drawn_lines = [line for axes in figure.axes for line in axes.lines]
    assert any(np.array_equal(line.get_ydata(), LONG.y) for line in drawn_lines)


@pytest.mark.parametrize("count", [1, 3])
def test_pictures_of_designed_motions(
    count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The written picture; a joint has a row of its own."""
    ones = np.ones(count)
    motion = Fourier(
        offset=0.1 * ones, a=np.outer(ones, [0.5, -0.5]), b=np.outer(ones, [0.4, -0.2]), period=4.0
    )
    limits = Limits(
        lower=-2.0 * ones, upper=3.0 * ones, velocity=4.0 * ones, acceleration=ones, torque=ones
    )
    design = Excitation(
        motion=motion, condition=9.0, sample_rate=50.0, limits=limits, peak_torque=ones
    )
    written: list[Figure] = []
    save = Figure.savefig

    def savefig(figure: Figure, *arguments: object, **options: object) -> None:
        written.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    write_excitation(tmp_path / "motion.png", design, [f"j{k}" for k in range(count)])
    (figure,) = written
    height, width, _ = imread(tmp_path / "motion.png").shape
    assert (width, height) == (1080, 216 * count)
    positions = [line.get_ydata() for axes in figure.axes for line in axes.lines]
    start = motion.sample(np.zeros(1))[0][0, 0]
    assert any(values[0] == pytest.approx(start) for values in positions)


def test_charts_of_panels(recorded) -> None:
    panel = Panel(title="t", y="y", lines=(LONG, SHORT), marks=((1.0, "here"),))
    rows = ((panel, panel), (panel, panel))
    recorded(draw_chart(Chart(x="t [s]", rows=rows, window=(1.0, 2.0))))
    many = ((Panel(title="t", y="y", lines=(LONG,)),),) * 6
    assert draw_chart(Chart(x="t [s]", rows=many, height=1.0), width=5.0).get_figwidth() == 5.0


def test_thinning_keeps_the_extremes_of_columns() -> None:
    y = np.zeros(1000)
    y[[123, 777]] = 5.0, -5.0
    x = np.arange(1000.0)
    some_x, some_y = thin_line(x, y, 10)
    assert {0.0, 123.0, 777.0, 999.0} <= set(some_x)
    assert len(some_x) <= 22
    assert list(some_y[np.isin(some_x, [123.0, 777.0])]) == [5.0, -5.0]
    assert thin_line(x, y, 500)[0] is x
    assert len(thin_line(x, y, 499)[0]) < 1000
    assert thin_line(-x, y, 10)[1] is y


def test_styles_of_laws_are_distinct() -> None:
    found = strokes([f"law {k}" for k in range(6)])
    assert len({(one.colour, one.dash) for one in found.values()}) == 6
    assert strokes([*found, "next"])["next"] == found["law 0"]
    with apply_style():
        assert {key: rcParams[key] for key in _RC} == _RC


# --- SVG --------------------------------------------------------------------------------------


def test_paths_are_written_as_steps_of_tenths() -> None:
    path = '<path d="M 10.04 20 L 11.26 20.5 L 11.2 9 C 1 2 3 4 5.53 6 L 5.5 6.24 z"/>'
    assert _shorten_paths(path) == '<path d="M 10 20l 1.3 .5-.1-11.5C 1 2 3 4 5.5 6l 0 .2z"/>'


def test_a_drawing_takes_colours_and_names_of_the_page() -> None:
    drawn_by_matplotlib = (
        '<?xml?><svg width="9"><metadata>who</metadata><g id="used"/><g id="unused"/>'
        '<use xlink:href="#used"/><g clip-path="url(#used)"/>'
        "<text style=\"font: 9px 'DejaVu Sans', 'Arial'; fill: #1d2430\">a</text>"
        "<text style=\"font: bold 8.5px 'DejaVu Sans'; fill: #0069a8\">b</text></svg>"
    )
    assert _inner(drawn_by_matplotlib, "k") == (
        '<g id="k-used"/><g/><use xlink:href="#k-used"/><g clip-path="url(#k-used)"/>'
        '<text style="font-size: 9px; fill: var(--ink)">a</text>'
        '<text style="font-weight: 600; font-size: 8.5px; fill: var(--c1)">b</text></svg>'
    )


def test_figures_of_a_page_have_sizes_in_points(tmp_path) -> None:
    figure = draw_chart(Chart(x="t", rows=((Panel(title="t", y="y", lines=(SHORT,)),),)))
    text = svg(figure, "key")
    assert 'viewBox="0 0 648 158.4" aria-hidden="true">' in text
    assert svg(figure, "key") == text
    assert "var(--soft)" in text
    assert 'id="key-' in text
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_svg(figure, tmp_path / name / "figure.svg")
    written = [(tmp_path / name / "figure.svg").read_bytes() for name in ("a", "b")]
    assert written[0] == written[1]
    assert b"#ffffff" in written[0]


# --- views that zoom --------------------------------------------------------------------------


def view(*panels: Panel, height: float = 1.7) -> dict[str, Any]:
    """Data of the view of a chart with one column; tests of the browser open views."""
    chart = Chart(x="t [s]", rows=[(panel,) for panel in panels], height=height)
    return json.loads(unpack_text(zoom_data(chart)))


def test_a_view_has_size_marks_and_style() -> None:
    marks = ((1.0, "a"), (2.0, "b"))
    data = view(Panel(title="title", y="torque", lines=(LONG,), marks=marks))
    assert (data["x"], data["height"]) == ("t [s]", 178)
    (((panel,),),) = (data["rows"],)
    assert (panel["title"], panel["y"], panel["marks"]) == ("title", "torque", [1.0, 2.0])


def test_lines_of_a_view_share_times_and_are_rounded() -> None:
    broken = np.where(T[5] < T, 2.0 * TAU, np.nan)
    broken[3] = np.inf
    other = Line(name="other", x=T, y=broken, stroke=Stroke(colour="red", width=2.0))
    data = view(Panel(title="t", y="y", lines=(LONG, other, SHORT)))
    times, short = data["times"]
    np.testing.assert_allclose(times, T, atol=1e-5 * T[-1])
    np.testing.assert_allclose(short, T[::100], atol=1e-5 * T[-1])
    first, second, third = data["rows"][0][0]["lines"]
    assert (first["time"], second["time"], third["time"]) == (0, 0, 1)
    np.testing.assert_allclose(first["y"], TAU, atol=1e-5 * np.max(np.abs(TAU)))
    assert max(len(repr(value)) for value in first["y"]) <= 8
    assert second["y"][:6] == [None] * 6
    np.testing.assert_allclose(second["y"][6:], broken[6:], atol=1e-5 * np.max(np.abs(broken[6:])))
    assert (first["width"], first["dash"]) == (1.2, [5, 2])
    assert (second["width"], second["dash"], second["colour"]) == (2.0, [], "red")


def test_long_charts_are_thinned_for_a_view() -> None:
    def item(points: int, rows_of_plots: int) -> dict:
        x = np.linspace(0.0, 1.0, points)
        line = Line(name="a", x=x, y=x, stroke=DASHED)
        rows = ((Panel(title="t", y="y", lines=(line, LONG)),),) * rows_of_plots
        text = zoom_data(Chart(x="t [s]", rows=rows))
        return json.loads(unpack_text(text))

    data = item(24_000, rows_of_plots=2)
    assert data["names"] == {
        name: {"colour": "#0069a8", "dash": [5.0, 1.5]} for name in ("a", "long")
    }
    assert len(data["rows"]) == 2
    assert len(data["times"]) == 2

    def longest(item: object) -> int:
        if isinstance(item, dict):
            return max(map(longest, item.values()), default=0)
        return max([len(item), *map(longest, item)]) if isinstance(item, list) else 0

    assert longest(data) == 24_000
    # 50,002 values
    assert longest(item(24_200, rows_of_plots=2)) == 12_100
    assert longest(item(24_200, rows_of_plots=1)) == 24_200
