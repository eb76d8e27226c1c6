"""Figures of the physics checks."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.report.figures.style import LINE, SERIES, SOFT, apply_style
from fmu_src.pages.datasheet import figure as format_number
from hesr_model.audit.properties import Plot

_WIDTH = 236.0  # of a figure [pt]
_HEIGHT = 148.0  # of a figure [pt]
_SIDE_MARGIN = 6.0  # of the axes [pt]
_END_MARGIN = 18.0  # of the axes [pt]
_AXES = (
    _SIDE_MARGIN / _WIDTH,
    _END_MARGIN / _HEIGHT,
    1.0 - 2.0 * _SIDE_MARGIN / _WIDTH,
    1.0 - 2.0 * _END_MARGIN / _HEIGHT,
)
_TEXT_SIZE = 9.5  # [pt]
_TEXT_GAP = 3.0  # between the axes and their texts [pt]
_DIGITS = 3


def draw_check(plot: Plot) -> Figure | None:
    """Draw the curves of a check; None if no curve has two points.

    A run draws hundreds of these figures. Ticks would take most of the time; the extremes are
    written in words instead.
    """
    curves = [curve for curve in plot.curves if len(curve.x) > 1]
    if not curves:
        return None
    with apply_style():
        figure = Figure(figsize=(_WIDTH / 72.0, _HEIGHT / 72.0))
        axes = figure.add_axes(_AXES)
        for curve, colour in zip(curves, SERIES, strict=False):
            axes.plot(curve.x, curve.y, color=colour, label=curve.label)
        _draw_frame(axes)
        _name_extremes(axes, plot)
        _name_curves(axes)
    return figure


def _draw_frame(axes: Axes) -> None:
    """Draw a frame and the zero lines in place of ticks and grid."""
    axes.set(xticks=[], yticks=[])
    axes.spines[["top", "right"]].set_visible(True)
    lowest, highest = axes.get_ylim()
    if lowest < 0.0 < highest:
        axes.axhline(0.0, color=LINE, linewidth=1.0, zorder=0.0)
    lowest, highest = axes.get_xlim()
    if lowest < 0.0 < highest:
        axes.axvline(0.0, color=LINE, linewidth=1.0, zorder=0.0)


def _name_extremes(axes: Axes, plot: Plot) -> None:
    """Write the names of both axes with the extremes of the curves."""
    bounds = axes.dataLim
    x, y = plot.labels
    first_x, last_x, lowest, highest = (
        format_number(value, _DIGITS) for value in (bounds.x0, bounds.x1, bounds.y0, bounds.y1)
    )
    _write(axes, (0.0, 1.0), "left", f"{y}, {lowest} to {highest}")
    _write(axes, (0.0, 0.0), "left", first_x)
    _write(axes, (0.5, 0.0), "center", x)
    _write(axes, (1.0, 0.0), "right", last_x)


def _name_curves(axes: Axes) -> None:
    """Write the names of the curves above the axes, each in its colour."""
    handles, names = axes.get_legend_handles_labels()
    if not names:
        return
    legend = axes.legend(
        handles,
        names,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(names),
        fontsize=_TEXT_SIZE,
        labelcolor="linecolor",
        borderaxespad=0.3,
        borderpad=0.0,
        columnspacing=0.7,
        handlelength=0.0,
        handletextpad=0.0,
    )
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set_visible(False)


def _write(axes: Axes, position: tuple[float, float], alignment: str, text: str) -> None:
    """Write a text above or below the axes at a place in shares of their size."""
    gap = -_TEXT_GAP
    vertical_alignment = "top"
    if position[1] > 0.0:  # above the axes
        gap = _TEXT_GAP
        vertical_alignment = "bottom"
    axes.annotate(
        text,
        position,
        xycoords="axes fraction",
        xytext=(0.0, gap),
        textcoords="offset points",
        ha=alignment,
        va=vertical_alignment,
        fontsize=_TEXT_SIZE,
        color=SOFT,
    )
