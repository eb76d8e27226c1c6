"""Passivity audit: whether a law brakes, and what it does at rest and outside of its training."""

from cosim.report.markup import Pictures, Section, details, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.laws import audit
from cosim.report.tables.table import ResultTable, TableCell, fixed, number, row_of, title
from fmu_src.pages.datasheet import certified
from hesr_model.audit.audit import Audit
from hesr_model.audit.cycles import ENCODER

_ROUNDING = 1e-6  # [J]


def passive(found: Audit) -> bool:
    """Whether no closed cycle that was tried gives energy."""
    return found.generated < _ROUNDING


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show the figures of the audit for every law."""
    del pictures
    found = results.audits
    if not found:
        return None
    energy = ResultTable(
        caption="Most energy that a law gives in a closed cycle [J], and the chatter of its torque "
        f"at rest [{results.unit('N.m')}]",
        head=(
            "law",
            *(f"energy {short}" for short in results.joints),
            *(f"chatter {short}" for short in results.joints),
        ),
        rows=[
            row_of(
                title(law),
                *(
                    TableCell(text="none", value=0.0) if passive(a) else number(a.generated, 2)
                    for a in of_law.audits
                ),
                *(fixed(a.chatter, 2) for a in of_law.audits),
            )
            for law, of_law in found.items()
        ],
    )
    proofs = ResultTable(
        caption="Passivity of each law and joint",
        head=("law", "joint", "certificate"),
        rows=[
            row_of(title(law), joint, certified(c, slides=slides))
            for law, of_law in found.items()
            for joint, c, slides in zip(
                results.joints, of_law.certificates, results.models[law].slides, strict=True
            )
        ],
        numeric=False,
    )
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
            table(energy),
            details("Certificates: proven, refuted by a cycle, or open", table(proofs)),
            details(
                "All figures of every law",
                *(table(audit(law, found[law].audits, results.sliding)) for law in found),
            ),
        ),
    )
