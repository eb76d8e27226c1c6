"""Tables of scores over draws of noise, motions and true friction."""

from collections.abc import Iterator

from cosim.report.tables.table import ResultTable, TableCell, joints, named, row_of, title
from cosim.study.seeds import Seeds, Spread


def over_draws(found: Seeds) -> Iterator[ResultTable]:
    """Yield the errors and the ratios of each test set."""
    head = ("law", *joints(len(found.joints)))
    draws = f"mean of {found.seeds} draws of noise, motions and true friction [95 % interval]"
    for test, scores in found.tests.items():
        for what, rows in (
            (f"RMSE of the predicted torque [N.m] on '{test}'", scores.rmse),
            (f"RMSE over that of {title(found.reference)} on '{test}'", scores.ratios),
        ):
            yield ResultTable(
                caption=f"{what}, {draws}",
                head=head,
                rows=[
                    row_of(named(law), *(_cell(s) for s in spreads))
                    for law, spreads in rows.items()
                ],
            )


def _cell(spread: Spread) -> TableCell:
    return TableCell(
        text=f"{spread.mean:.3f} [{spread.low:.3f}, {spread.high:.3f}]", value=spread.mean
    )
