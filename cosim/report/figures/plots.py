"""Hysteresis state, friction loops, and ratios with intervals."""

from collections.abc import Mapping, Sequence
from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator, ScalarFormatter
from numpy.typing import NDArray

from cosim.report.figures.chart import Panel, grid, plot, proxy
from cosim.report.figures.style import INK, SERIES, SOFT, apply_style
from hesr_model.inference.comparison import ErrorRatio
from hesr_model.support.arrays import Array

_MARKERS = ("o", "s", "^", "D", "v", "P")
_FINE = tuple(0.05 * k for k in range(10, 41))
_COARSE = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
_MAX_FINE_RANGE = 1.7  # width of the range above which ticks are coarse
_LETTER = 0.075  # width of a letter of a law's name [in]
_LOOP_COLUMNS = 5
_MAX_SPEED_SHARE = 0.25  # range of loops over the maximum speed; laws differ little beyond it
_MAX_MEASURED_POINTS = 700  # maximum number of measured points of a loop


def sheets(panels: Sequence[tuple[str, Panel]]) -> Figure:
    """Draw panels of closed lines over named axes next to each other, with a legend below each."""
    with apply_style():
        figure, axes = grid((9.0, 2.95), 1, len(panels), (0.66, 0.26, 0.84))
        for axis, (x, panel) in zip(axes[0], panels, strict=True):
            for line in panel.lines:
                plot(axis, line)
            axis.set(title=panel.title, xlabel=x, ylabel=panel.y)
            handles = [proxy(line.stroke) for line in panel.lines]
            axis.legend(
                handles,
                [line.name for line in panel.lines],
                ncols=min(3, len(handles)),
                loc="upper center",
                bbox_to_anchor=(0.5, -0.2),
                handlelength=2.0,
                columnspacing=1.0,
                fontsize=8,
            )
    return figure


def loops(
    measured: tuple[Array, Array],
    laws: Mapping[str, tuple[Array, Array]],
    *,
    x: str,
    y: str,
    points: int | None = None,
) -> Figure:
    """Draw torque [N.m] over velocity [rad/s] (N,) near reversals by law, thinned to `points`."""
    columns = min(_LOOP_COLUMNS, len(laws))
    rows = ceil(len(laws) / columns)
    with apply_style():
        height = 1.75 * rows + 0.55
        margins = (0.63, 0.25, 0.5)
        gaps = (0.11, 0.26)
        figure, axes = grid((9.0, height), rows, columns, margins, gaps, sharex=True, sharey=True)
        fastest = float(np.max(np.abs(measured[0])))
        reach = _MAX_SPEED_SHARE * fastest
        is_near = np.abs(measured[0]) <= reach
        if not is_near.any():  # no reversal: all rows
            reach = fastest
            is_near = ~is_near
        count = int(np.count_nonzero(is_near))
        measured_step = max(1, count // (points or _MAX_MEASURED_POINTS))
        law_step = max(1, count // (points or count + 1))
        lowest, highest = np.quantile(measured[1][is_near], (0.002, 0.998))
        margin = 0.15 * (highest - lowest)
        for axis, (title, (dq, tau)) in zip(axes.flat, laws.items(), strict=False):
            axis.plot(
                *_select_near_rows(is_near, *measured, measured_step),
                color=SOFT,
                linewidth=0.6,
                alpha=0.7,
            )
            axis.plot(
                *_select_near_rows(is_near, dq, tau, law_step), color=SERIES[0], linewidth=1.2
            )
            axis.set_title(title, fontsize=8.5)
            axis.set(xlim=(-reach, reach), ylim=(lowest - margin, highest + margin))
        for axis in axes.flat[len(laws) :]:
            axis.set_visible(False)
        figure.supxlabel(x, fontsize=9, y=0.04 / height, va="bottom")
        figure.supylabel(y, fontsize=9, x=0.004, ha="left")
    return figure


def ratios(laws: Mapping[str, Sequence[ErrorRatio]], joints: Sequence[str], *, x: str) -> Figure:
    """Draw a dot with its interval for each law and joint, on a logarithmic axis."""
    with apply_style():
        left_margin = 0.2 + _LETTER * max(map(len, laws))
        figure, [[axis]] = grid((9.0, 0.34 * len(laws) + 1.1), 1, 1, (left_margin, 0.24, 0.44))
        offsets = np.zeros(1)
        if len(joints) > 1:
            offsets = np.linspace(-0.27, 0.27, len(joints))
        for k, (joint, offset) in enumerate(zip(joints, offsets, strict=True)):
            joint_ratios = [row[k] for row in laws.values()]
            values = np.array([ratio.value for ratio in joint_ratios])
            intervals = np.array(list(map(_find_interval, joint_ratios)))
            low, high = intervals.T
            axis.errorbar(
                values,
                np.arange(len(joint_ratios)) + offset,
                xerr=np.maximum(np.array([values - low, high - values]), 0.0),
                fmt=_MARKERS[k % len(_MARKERS)],
                color=SERIES[k % len(SERIES)],
                markersize=4.0,
                elinewidth=1.0,
                label=joint,
            )
        axis.axvline(1.0, color=INK, linewidth=0.9)
        _ratio_axis(axis)
        axis.set_yticks(range(len(laws)), laws, color=INK, fontsize=8.5)
        axis.tick_params(axis="y", labelcolor=INK)
        axis.grid(visible=False, axis="y")
        axis.set(xlabel=x, ylim=(len(laws) - 0.5, -0.5))
        figure.legend(
            loc="outside upper left", ncols=len(joints), borderaxespad=0.0, handletextpad=0.3
        )
    return figure


def _find_interval(ratio: ErrorRatio) -> tuple[float, float]:
    """Return the ends of a ratio's interval; a test that is too short has none to draw."""
    low = ratio.value if ratio.low is None else ratio.low
    high = ratio.value if ratio.high is None else ratio.high
    return low, high


def _ratio_axis(axis: Axes) -> None:
    axis.set_xscale("log")
    low, high = axis.get_xlim()
    steps = _FINE if high / low < _MAX_FINE_RANGE else _COARSE
    axis.set_xticks([t for t in steps if low <= t <= high])
    axis.xaxis.set_major_formatter(ScalarFormatter())
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_formatter(NullFormatter())


def _select_near_rows(
    is_near: NDArray[np.bool_], x: Array, y: Array, step: int = 1
) -> tuple[Array, Array]:
    is_shown = is_near.copy()
    is_shown[:-1] |= is_near[1:]
    is_shown[1:] |= is_near[:-1]
    rows = np.flatnonzero(is_shown | np.roll(is_shown, 1))[::step]
    return x[rows], np.where(is_shown, y, np.nan)[rows]
