"""Passivity audit: whether a law brakes, and what it does at rest and outside of its training."""

from cosim.report.markup import (
    Cell,
    Pictures,
    Row,
    Section,
    Table,
    details,
    fixed,
    joined,
    number,
    paragraph,
    table,
)
from cosim.report.results import Results
from fmu_src.friction.datasheet import audit_rows, audits
from hesr_model.errors import SimulationError
from hesr_model.friction.audit import Audit
from hesr_model.friction.cycles import ENCODER

_ROUNDING = 1e-6  # [J]


def passive(found: Audit) -> bool:
    """Whether no closed cycle that was tried gives energy."""
    return found.generated < _ROUNDING


def audited(results: Results) -> dict[str, tuple[Audit, ...]]:
    """Return the audit of each law; one without a trained range has none."""
    found = {}
    for law, model in results.models.items():
        try:
            if model.trained:
                found[law] = audits(model, model.trained)
        except SimulationError:
            continue
    return found


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show the figures of the audit for every law."""
    del pictures
    found = audited(results)
    if not found:
        return None
    return Section(
        key="audit",
        title="Passivity audit",
        html=joined(
            paragraph(
                "Friction takes energy out of a motion; a law that was fitted to torque may do "
                "otherwise. Each law was tried on closed cycles of 0.05 to 2 Hz and, at rest, "
                f"under encoder noise of {1e6 * ENCODER:.0f} {results.unit('µrad')}. Laws that "
                "give energy are no friction of a simulated plant, whatever their RMSE."
            ),
            table(
                Table(
                    caption="Most energy that a law gives in a closed cycle [J], and the chatter "
                    "of "
                    f"its torque at rest [{results.unit('N.m')}]",
                    head=(
                        "law",
                        *(f"energy {short}" for short in results.joints),
                        *(f"chatter {short}" for short in results.joints),
                    ),
                    rows=[
                        Row(
                            head=results.title(law),
                            cells=[
                                *(
                                    Cell(text="none", value=0.0)
                                    if passive(a)
                                    else number(a.generated, 2)
                                    for a in of_law
                                ),
                                *(fixed(a.chatter, 2) for a in of_law),
                            ],
                        )
                        for law, of_law in found.items()
                    ],
                )
            ),
            details(
                "All figures of every law",
                *(
                    table(
                        Table(
                            caption=f"Audit of {results.title(law)}",
                            head=("", *results.joints),
                            rows=[
                                Row(head=label, cells=cells)
                                for label, cells in audit_rows(of_law, results.sliding).items()
                            ],
                        )
                    )
                    for law, of_law in found.items()
                ),
            ),
        ),
    )
