"""Picture of what logs hold: a row for each joint."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.report.figures.chart import Line, legend, plot
from cosim.report.figures.style import SERIES, style_axis, styled
from hesr_model.support.arrays import Array

_ROW, _BINS = 1.55, 40
_LEAST = 1e-9
"""Of a range that is more than rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointView:
    """What is shown of a joint.

    Attributes
    ----------
    name, unit : of the joint and its velocity.
    velocities : over time [s].
    friction : torque that the model leaves [N.m; N] over velocity; None without a model.
    covered : (N,) velocities of all logs.
    loads : (N,) gravity torques [N.m; N] of all logs; None without a model.
    """

    name: str
    unit: str
    velocities: tuple[Line, ...]
    friction: Line | None
    covered: Array
    loads: Array | None


def joints(views: Sequence[JointView]) -> Figure:
    """Draw velocity over time, friction over it, and histograms of velocity and load by joint."""
    height = _ROW * len(views) + 0.75
    with styled():
        figure = Figure(figsize=(9.0, height))
        # Placed by hand, because finding a place for many axes takes longer than drawing them.
        axes = figure.subplots(
            len(views), 4, squeeze=False,
            gridspec_kw={"left": 0.06, "right": 0.995, "top": 1.0 - 0.5 / height,
                         "bottom": 0.3 / height, "wspace": 0.16, "hspace": 0.62,
                         "width_ratios": [1.0, 1.0, 0.6, 0.6]},
        )  # fmt: skip
        for row, view in zip(axes, views, strict=True):
            for line in view.velocities:
                plot(row[0], line)
            if view.friction:
                plot(row[1], view.friction)
            else:
                _say(row[1], "no model")
            for axis, values in ((row[2], view.covered), (row[3], view.loads)):
                axis.set_yticks([])
                if values is None or np.ptp(values) < _LEAST:
                    _say(axis, "no model" if values is None else "none")
                else:
                    axis.hist(values, bins=_BINS, color=SERIES[2])
            titles = (
                f"{view.name}: {view.unit} over s", "torque less the model’s", "rows by velocity",
                "rows by gravity",
            )  # fmt: skip
            for axis, title in zip(row, titles, strict=True):
                axis.set_title(title, fontsize=8.5)
                style_axis(axis)
            row[1].set_xlabel(view.unit, fontsize=8, labelpad=1)
            row[2].set_xlabel(view.unit, fontsize=8, labelpad=1)
            row[3].set_xlabel("N" if view.unit == "m/s" else "N.m", fontsize=8, labelpad=1)
        legend(figure, [line for view in views for line in view.velocities])
    return figure


def _say(axis: Axes, why: str) -> None:
    """Say why a panel has nothing to draw."""
    axis.set_xticks([])
    axis.set_yticks([])
    axis.text(0.5, 0.5, why, ha="center", fontsize=8, transform=axis.transAxes)
