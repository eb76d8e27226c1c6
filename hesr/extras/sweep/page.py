"""Page of a sweep."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from cosim.report.figures.style import SERIES, SOFT, styled
from cosim.report.markup import Pictures, Section, joined, paragraph, table, write_sections
from hesr.extras.sweep import tables
from hesr.extras.sweep.tables import SweepResult
from hesr_model.support.arrays import Array

_DESIGNS = {
    "grid": "a grid",
    "latin_hypercube": "a Latin hypercube",
    "monte_carlo": "random points",
    "sobol": "Saltelli's design of Sobol points",
}

_BINS = 40
_WIDTH = 7.2  # of figures [in]


def write_page(swept: SweepResult, path: Path) -> None:
    """Write the page, with commands for the sweep file."""
    pictures = Pictures(folder=path.parent)  # figures are embedded
    order = paragraph("Largest magnitude first, failed runs before all others.")
    worst = (tables.worst(swept, k) for k in range(len(swept.plan.study.outputs)))
    sections = [
        Section(key="outputs", title="Outputs", html=_outputs(swept, pictures)),
        Section(key="worst", title="Worst runs", html=joined(order, *map(table, worst))),
    ]
    if swept.sensitivities:
        html = _sensitivities(swept, pictures)
        sections.append(Section(key="sensitivities", title="Sensitivities", html=html))
    plan = swept.plan
    text = (
        f"{len(plan.values)} runs of {plan.task.spec.stop:g} s, {_DESIGNS[plan.study.design]} over "
        f"{len(plan.study.names)} inputs, seed {plan.study.seed}. The Parquet "
        "data set runs/ has inputs and outputs of each run."
    )
    write_sections(
        path,
        title=f"HESR sweep: {plan.study.name}",
        heading=f"Sweep ‘{plan.study.name}’",
        summary=paragraph(text),
        sections=sections,
    )


def _outputs(swept: SweepResult, pictures: Pictures) -> Markup:
    names = [output.name for output in swept.plan.study.outputs]
    drawn = pictures.shown(
        "distributions",
        _distributions(names, swept.table.outputs),
        "Distribution of each output over the runs; dashed: 5, 50 and 95 % quantiles.",
        alt="A histogram of each output.",
    )
    return joined(drawn, table(tables.outputs(swept)))


def _sensitivities(swept: SweepResult, pictures: Pictures) -> Markup:
    parts = [
        paragraph(
            "First order: share of an input alone; total: with all of its interactions. Shares of "
            "correlated inputs are those of their independent normal numbers."
        )
    ]
    found = zip(swept.sensitivities, tables.sensitivities(swept), strict=True)
    for k, (one, listed) in enumerate(found):
        figure = _shares(swept.plan.study.names, one.first, one.total, one.intervals)
        caption = f"Shares of the variance of {one.output}."
        drawn = pictures.shown(f"shares-{k}", figure, caption, alt="Two bars for each input.")
        parts += [drawn, table(listed)]
    return joined(*parts)


def _distributions(names: Sequence[str], values: Array) -> Figure:
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


def _shares(inputs: Sequence[str], first: Array, total: Array, intervals: Array) -> Figure:
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
