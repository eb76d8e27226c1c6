"""Tables of how well laws predict torque."""

from collections.abc import Mapping, Sequence

from cosim.scoring import ORACLE, Comparison, Ratio
from cosim.tables.table import ResultTable, TableRow, decimals, fixed, joints, named, title
from hesr_model.units import unit_of_joints

MEASURES = {
    "rmse": "over all rows",
    "rmse_moving": "while moving (|dq| > 0.02 {speed})",
    "rmse_reversal": "within 0.1 s of velocity reversals",
}
"""What is shown of each test set."""


def errors(
    name: str,
    scores: Comparison,
    measure: str = "rmse",
    inputs: Mapping[str, str] | None = None,
    sliding: Sequence[bool] = (),
) -> ResultTable:
    """Return laws by joints of one measure on one test set; the best law of a joint stands out.

    Parameters
    ----------
    name : of the test set.
    scores : of the laws.
    measure : one of `MEASURES`; with the first one stands the ratio to the reference.
    inputs : inputs of each law; where given, laws of equal inputs stand together.
    sliding : whether each joint slides; empty if all turn.
    """
    values = {law: getattr(of_law, measure) for law, of_law in scores.laws.items()}
    columns = list(zip(*values.values(), strict=True))
    places = [decimals(column) for column in columns]
    own = [values[law] for law in values if law != ORACLE] or list(values.values())
    best = [min((v for v in of_joint if v is not None), default=None)
            for of_joint in zip(*own, strict=True)]  # fmt: skip
    whole = measure == "rmse"
    ratios = scores.ratios.laws if whole else {}
    rows = []
    if whole:
        cells = [fixed(s, n) for s, n in zip(scores.tau_std, places, strict=True)]
        rows.append(TableRow(head="(std of friction)", quiet=True, cells=cells))
    for label, laws in _by_inputs(list(values), inputs).items():
        if label is not None:
            rows.append(TableRow(head=f"inputs {label}" if label else "for comparison"))
        rows += [
            TableRow(
                head=named(law),
                cells=[
                    fixed(
                        value,
                        places[k],
                        best=value is not None and value == best[k] and law != ORACLE,
                        notes=_notes(ratios[law][k]) if law in ratios else (),
                    )
                    for k, value in enumerate(values[law])
                ],
            )
            for law in laws
        ]
    unit, speed = (unit_of_joints(u, sliding) for u in ("N.m", "rad/s"))
    words = MEASURES[measure].format(speed=speed)
    small = f"; small: ratio to {title(scores.ratios.reference)} with its 95\u00a0% interval"
    return ResultTable(
        caption=f"{name}: RMSE of the predicted torque [{unit}] {words}{small if ratios else ''}",
        head=("law", *joints(len(scores.joints))),
        rows=rows,
    )


def _notes(ratio: Ratio) -> tuple[str, str]:
    return f"{ratio.value:.2f}", f"{ratio.low:.2f}–{ratio.high:.2f}"


def _by_inputs(
    laws: Sequence[str], inputs: Mapping[str, str] | None
) -> dict[str | None, list[str]]:
    """Return the laws in classes of equal inputs, the fewest inputs first."""
    if inputs is None:
        return {None: list(laws)}
    classes: dict[str | None, list[str]] = {}
    for law in laws:
        classes.setdefault(inputs.get(law, ""), []).append(law)
    # What has no inputs of its own, as the true friction, stands last.
    return dict(sorted(classes.items(), key=lambda c: (not c[0], str(c[0]).count(","))))
