"""Ablation: variants of the study, and laws that differ by one part."""

from collections.abc import Iterator, Sequence

from cosim.report.markup import Pictures, Section, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, number, row_of, title
from cosim.study.scores import MEASURED_START
from hesr_model.friction.registry import registry


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show the change of the error when one part is added."""
    del pictures
    test = results.tests[0]
    laws = results.comparisons[test].laws
    steps = [(a, b, part) for a, b, part in _steps() if a in laws and b in laws]
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
                    row_of(f"{title(a)} → {title(b)}", part, *_changes(laws[a].rmse, laws[b].rmse))
                    for a, b, part in steps
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


def _steps() -> Iterator[tuple[str, str, str]]:
    """Yield law, extended law and the part that it adds."""
    for name, law in registry().items():
        if law.adds is not None:
            yield law.adds[0], name, law.adds[1]
        yield name, name + MEASURED_START, "a measured start"


def _changes(before: Sequence[float], after: Sequence[float]) -> list[str]:
    changes = [100.0 * (b / a - 1.0) for a, b in zip(before, after, strict=True)]
    # Zero has no sign.
    return [f"{c:+.0f} %".replace("-", "−") if round(c) else "0 %" for c in changes]
