"""What the closed loop bears when the arm is not what was identified."""

from cosim.report.markup import (
    Cell,
    Pictures,
    Row,
    Section,
    Table,
    details,
    joined,
    number,
    paragraph,
    table,
)
from cosim.report.results import Results
from cosim.report.sections.tracking import mrad, named, scheme_name


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show what the loop bears when the arm changes."""
    del pictures
    if results.loop is None:
        return None
    factors = [
        Row(
            head=f"{results.title(one.law)}: {scheme_name(one.scheme)}",
            cells=[Cell(text="none up to 3") if one.factor is None else number(one.factor, 2)],
        )
        for one in results.loop.overcompensation
    ]
    sweeps = _sweeps(results)
    return Section(
        key="robustness",
        title="Robustness",
        html=joined(
            paragraph(
                "The same loop when the arm is not what was identified: payloads, warm and cold "
                "friction, latency, wrong servo gains, more noise. A run that left the joint "
                "limits "
                "is ‘stopped’."
            ),
            details("The paper’s scheme", *map(table, sweeps[:1])),
            *map(table, sweeps[1:]),
            table(
                Table(
                    caption="Factor on the friction torque from which the arm at rest begins to "
                    "cycle",
                    head=("law and scheme", "factor"),
                    rows=factors,
                )
            ),
        ),
    )


def _sweeps(results: Results) -> list[Table]:
    if results.loop is None:
        return []
    parted = [(row.scheme.split(": ", 1), row) for row in results.loop.sweeps]
    tables = []
    for scheme in dict.fromkeys(of for (of, _), _ in parted):
        cells = {(change, row.law): row.mean.max() for (of, change), row in parted if of == scheme}
        laws = list(dict.fromkeys(law for _, law in cells))
        tables.append(
            Table(
                caption=f"{scheme_name(scheme)}: RMSE of the worst joint [mrad] under changes",
                head=("change", *(named(results, law) for law in laws)),
                rows=[
                    Row(head=change, cells=[mrad(cells[change, law], 2) for law in laws])
                    for change in dict.fromkeys(change for change, _ in cells)
                ],
            )
        )
    return tables
