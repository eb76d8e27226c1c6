"""Tables of scores over draws."""

from collections.abc import Iterator

from cosim.report.tables.table import ResultTable, TableCell, joints, row_of, title
from cosim.study.seeds import Seeds


def over_draws(found: Seeds) -> Iterator[ResultTable]:
    """Yield errors and ratios of each test set over draws of noise, motions and friction."""
    draws = f"mean of {found.seeds} draws of noise, motions and true friction [95 % interval]"
    for test, scores in found.tests.items():
        for what, laws in (
            (f"RMSE of the predicted torque [N.m] on '{test}'", scores.rmse),
            (f"RMSE over that of {title(found.reference)} on '{test}'", scores.ratios),
        ):
            rows = []
            for law, spreads in laws.items():
                texts = [f"{s.mean:.3f} [{s.low:.3f}, {s.high:.3f}]" for s in spreads]
                pairs = zip(texts, spreads, strict=True)
                cells = [TableCell(text=text, value=s.mean) for text, s in pairs]
                rows.append(row_of(title(law), *cells))
            yield ResultTable(
                caption=f"{what}, {draws}", head=("law", *joints(len(found.joints))), rows=rows
            )
