"""Tables for the terminal."""

from collections.abc import Mapping

from rich.table import Table

from cosim.scoring import Comparison
from hesr_model.friction.estimator import registry

_TITLES = {
    "rmse": "RMSE of the predicted torque [N.m], all rows",
    "rmse_reversal": "RMSE [N.m] within 0.1 s of velocity reversals",
}


def comparison(name: str, scores: Comparison, measure: str) -> Table:
    """Return laws by joints of one measure on one test set; the best law of a joint is bold."""
    table = Table(title=f"{name}: {_TITLES[measure]}", title_justify="left")
    table.add_column("law")
    for k, _ in enumerate(scores.joints, start=1):
        table.add_column(f"J{k}", justify="right")
    values = {law: [getattr(s, measure) for s in row] for law, row in scores.laws.items()}
    if measure == "rmse":
        first = next(iter(scores.laws.values()))
        table.add_row("(std of friction)", *(_figure(s.tau_std) for s in first))
        table.add_section()
    best = [min((v for v in column if v is not None), default=None)
            for column in zip(*values.values(), strict=True)]  # fmt: skip
    for law, row in values.items():
        cells = [f"[bold]{_figure(v)}[/]" if v is not None and v == b else _figure(v)
                 for v, b in zip(row, best, strict=True)]  # fmt: skip
        table.add_row(title(law), *cells)
    return table


def laws() -> Table:
    """Return the registry."""
    table = Table()
    for column in ("name", "law", "equation"):
        table.add_column(column)
    for name, entry in registry().items():
        table.add_row(name, entry.title, entry.equation)
    return table


def title(law: str) -> str:
    """Return the title of a law, or the name itself where it is none of the registry."""
    known: Mapping[str, object] = registry()
    return registry()[law].title if law in known else law


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}" if value < 1.0 else f"{value:.3f}"
