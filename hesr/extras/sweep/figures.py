"""Figures of a sweep."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cosim.report.figures.style import SERIES, SOFT, styled
from hesr_model.support.arrays import Array

_BINS = 40
_WIDTH = 7.2  # [in]


def distributions(names: Sequence[str], values: Array) -> Figure:
    """Draw a histogram of each output (runs, m); failed runs are NaN."""
    with styled():
        figure = Figure(figsize=(_WIDTH, 1.7 * len(names)), layout="constrained")
        axes = figure.subplots(len(names), squeeze=False)[:, 0]
        for axis, name, column in zip(axes, names, values.T, strict=True):
            found = column[np.isfinite(column)]
            axis.hist(found, bins=_BINS, color=SERIES[0])
            for place in np.quantile(found, (0.05, 0.5, 0.95)) if len(found) else ():
                axis.axvline(place, color=SOFT, linewidth=1.0, dashes=(4.0, 2.0))
            axis.set(title=name, ylabel="runs")
    return figure


def shares(inputs: Sequence[str], first: Array, total: Array, intervals: Array) -> Figure:
    """Draw first- and total-order sensitivities (d,) of an output, with intervals (2, d, 2)."""
    places = np.arange(len(inputs), dtype=float)
    with styled():
        figure = Figure(figsize=(_WIDTH, 0.5 * len(inputs) + 0.9), layout="constrained")
        axis = figure.subplots()
        for k, (label, values) in enumerate((("first order", first), ("total", total))):
            at = places + 0.36 * (k - 0.5)
            spread = np.abs(intervals[k].T - values)
            axis.barh(at, values, 0.34, color=SERIES[k], label=label)
            axis.errorbar(values, at, xerr=spread, fmt="none", ecolor=SOFT, elinewidth=1.0)
        axis.set_yticks(places, inputs)
        axis.invert_yaxis()
        axis.set_xlabel("share of the variance")
        axis.legend(loc="lower right")
    return figure
