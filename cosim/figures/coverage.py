"""Picture of what logs hold: a row for each joint."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cosim.figures.chart import Line, legend, plot
from cosim.figures.style import SERIES, style_axis, styled

Array = NDArray[np.float64]

_ROW, _BINS = 1.55, 40


@dataclass(frozen=True, kw_only=True, eq=False)
class JointView:
    """What is shown of a joint.

    Attributes
    ----------
    name, unit
        Of the joint and its velocity.
    velocities
        Over time [s].
    friction
        Torque that the model leaves [N.m; N] over velocity; None without a model.
    covered
        (N,) velocities of all logs.
    """

    name: str
    unit: str
    velocities: tuple[Line, ...]
    friction: Line | None
    covered: Array


def joints(views: Sequence[JointView]) -> Figure:
    """Draw velocity over time, friction over velocity, and a histogram of each joint."""
    height = _ROW * len(views) + 0.75
    with styled():
        figure = Figure(figsize=(9.0, height))
        # Placed by hand, because finding a place for many axes takes longer than drawing them.
        axes = figure.subplots(
            len(views), 3, squeeze=False,
            gridspec_kw={"left": 0.06, "right": 0.995, "top": 1.0 - 0.5 / height,
                         "bottom": 0.3 / height, "wspace": 0.16, "hspace": 0.62},
        )  # fmt: skip
        for row, view in zip(axes, views, strict=True):
            for line in view.velocities:
                plot(row[0], line)
            if view.friction:
                plot(row[1], view.friction)
            row[2].hist(view.covered, bins=_BINS, color=SERIES[2])
            row[2].set_yticks([])
            titles = (f"{view.name}: {view.unit} over s", "torque less the model’s", "rows")
            for axis, title in zip(row, titles, strict=True):
                axis.set_title(title, fontsize=8.5)
                style_axis(axis)
            row[1].set_xlabel(view.unit, fontsize=8, labelpad=1)
            row[2].set_xlabel(view.unit, fontsize=8, labelpad=1)
        legend(figure, [line for view in views for line in view.velocities])
    return figure
