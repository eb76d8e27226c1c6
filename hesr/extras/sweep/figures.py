"""Figures of a sweep."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cosim.report.figures.style import SERIES, SOFT, apply_style
from hesr_model.support.arrays import Array

_BIN_COUNT = 40
_FIGURE_WIDTH = 7.2  # [in]


def draw_distributions(names: Sequence[str], values: Array) -> Figure:
    """Draw a histogram of each output (runs, m); failed runs are NaN."""
    with apply_style():
        figure = Figure(figsize=(_FIGURE_WIDTH, 1.7 * len(names)), layout="constrained")
        axes = figure.subplots(len(names), squeeze=False)[:, 0]
        for axis, name, column in zip(axes, names, values.T, strict=True):
            finite = column[np.isfinite(column)]
            axis.hist(finite, bins=_BIN_COUNT, color=SERIES[0])
            for quantile in np.quantile(finite, (0.05, 0.5, 0.95)) if len(finite) else ():
                axis.axvline(quantile, color=SOFT, linewidth=1.0, dashes=(4.0, 2.0))
            axis.set(title=name, ylabel="runs")
    return figure


def draw_shares(inputs: Sequence[str], first: Array, total: Array, intervals: Array) -> Figure:
    """Draw first- and total-order sensitivities (d,) of an output, with intervals (2, d, 2)."""
    positions = np.arange(len(inputs), dtype=float)
    with apply_style():
        figure = Figure(figsize=(_FIGURE_WIDTH, 0.5 * len(inputs) + 0.9), layout="constrained")
        axis = figure.subplots()
        for k, (label, values) in enumerate((("first order", first), ("total", total))):
            bar_positions = positions + 0.36 * (k - 0.5)
            spread = np.abs(intervals[k].T - values)
            axis.barh(bar_positions, values, 0.34, color=SERIES[k], label=label)
            axis.errorbar(
                values, bar_positions, xerr=spread, fmt="none", ecolor=SOFT, elinewidth=1.0
            )
        axis.set_yticks(positions, inputs)
        axis.invert_yaxis()
        axis.set_xlabel("share of the variance")
        axis.legend(loc="lower right")
    return figure
