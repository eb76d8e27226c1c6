"""What each part of a law is worth: variants of the study, and laws that differ by one thing."""

from collections.abc import Sequence

from cosim.report.markup import Pictures, Section, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, number, row_of, title

_STEPS = (
    ("parfam_v", "parfam_h", "hysteresis state"),
    ("lugre", "lugre_load", "load"),
    ("lugre_load", "lugre_load_ripple", "motor ripple"),
    ("dahl", "dahl_load", "load"),
    ("lugre_load_ripple", "lugre_load_ripple + start", "a measured start"),
    ("parfam_h", "parfam_hx", "memory in position, load and ripple"),
    ("parfam_hx", "parfam_hx + start", "a measured start"),
    ("parfam_s", "parfam_s + start", "a measured start"),
)


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show by how much the error falls when one thing is added."""
    del pictures
    test = results.tests[0]
    laws = results.comparisons[test].laws
    steps = [(a, b, what) for a, b, what in _STEPS if a in laws and b in laws]
    variants = [name for name in results.run.variants if name in laws]
    if not steps and not variants:
        return None
    tables = []
    if variants:
        whole = results.run.variants[variants[-1]]
        ladder = [*variants, *([whole] if whole in laws else [])]
        tables.append(
            ResultTable(
                caption=f"{test}: RMSE [{results.unit('N.m')}] of the variants, each with one part "
                "more than that above it",
                head=("variant", *results.joints),
                rows=[row_of(title(law), *(number(e) for e in laws[law].rmse)) for law in ladder],
            )
        )
    if steps:
        tables.append(
            ResultTable(
                caption=f"{test}: change of the RMSE when one thing is added; less is better",
                words=(1,),
                head=("from, to", "adds", *results.joints),
                rows=[
                    row_of(f"{title(a)} → {title(b)}", what, *_changes(laws[a].rmse, laws[b].rmse))
                    for a, b, what in steps
                ],
            )
        )
    return Section(
        key="ablation",
        title="Ablation",
        html=joined(
            paragraph(
                "Which part of a law pays on this robot. A part that costs is shown as well: with "
                "more inputs a law can also learn what is not there."
            ),
            *map(table, tables),
        ),
    )


def _changes(before: Sequence[float], after: Sequence[float]) -> list[str]:
    changes = [100.0 * (b / a - 1.0) for a, b in zip(before, after, strict=True)]
    # Zero has no sign.
    return [f"{c:+.0f} %".replace("-", "−") if round(c) else "0 %" for c in changes]
