"""Page of a sweep."""

from pathlib import Path

from markupsafe import Markup

from cosim.report.markup import Pictures, Section, joined, paragraph, table, write_sections
from hesr.extras.sweep import tables
from hesr.extras.sweep.figures import distributions, shares
from hesr.extras.sweep.tables import SweepResult

_DESIGNS = {
    "grid": "a grid",
    "latin_hypercube": "a Latin hypercube",
    "monte_carlo": "random points",
    "sobol": "Saltelli's design of Sobol points",
}


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
        distributions(names, swept.table.outputs),
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
        figure = shares(swept.plan.study.names, one.first, one.total, one.intervals)
        caption = f"Shares of the variance of {one.output}."
        drawn = pictures.shown(f"shares-{k}", figure, caption, alt="Two bars for each input.")
        parts += [drawn, table(listed)]
    return joined(*parts)
