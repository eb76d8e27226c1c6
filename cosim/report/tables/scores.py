"""Tables of how well laws predict torque."""

import math
from collections.abc import Mapping, Sequence

from cosim.report.tables.table import ResultTable, decimals, fixed, joints, named, row_of, title
from cosim.study.position_errors import PositionErrors
from cosim.study.scores import ORACLE, REFERENCE, Comparison, Errors, Ratio
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
    """Return laws by joints of one measure on one test set, the least error first.

    The best law of a joint stands out where it is better than all others beyond chance.

    What nobody can run is not among the best: the truth, and starts from measured torques.

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
    whole = measure == "rmse"
    ratios = scores.ratios.laws if whole else {}
    alone = [of_joint[0] if len(of_joint) == 1 else "" for of_joint in scores.leading]
    best = alone if whole and len(values) > 1 and alone else [""] * len(scores.joints)
    rows = []
    if whole:
        cells = [fixed(s, n) for s, n in zip(scores.tau_std, places, strict=True)]
        rows.append(row_of("(std of friction)", *cells, quiet=True))
    ranked = sorted(values, key=lambda law: _relative(scores, law))
    for label, laws in _by_inputs(ranked, inputs).items():
        if label is not None:
            rows.append(row_of(f"inputs {label}" if label else "for comparison"))
        rows += [
            row_of(
                named(law),
                *(
                    fixed(
                        value,
                        places[k],
                        best=law == best[k],
                        notes=_notes(ratios[law][k]) if law in ratios else (),
                    )
                    for k, value in enumerate(values[law])
                ),
            )
            for law in laws
        ]
    unit, speed = (unit_of_joints(u, sliding) for u in ("N.m", "rad/s"))
    words = MEASURES[measure].format(speed=speed)
    to = (
        "the strongest classic law of the same inputs or fewer"
        if scores.ratios.references
        else title(scores.ratios.reference)
    )
    small = f"; small: ratio to {to} with its 95\u00a0% interval"
    return ResultTable(
        caption=f"{name}: RMSE of the predicted torque [{unit}] {words}{small if ratios else ''}"
        f"{_sight(scores.per_log)}",
        head=("law", *joints(len(scores.joints))),
        rows=rows,
    )


def bands(name: str, scores: Comparison) -> ResultTable:
    """Return laws by joints: how many rows of a test set lie within each law's 95 % band.

    Below the share stand that of moving rows and that near reversals, and the band's width over
    that of a constant one which holds as many rows.
    """
    ranked = sorted(scores.bands, key=lambda law: _relative(scores, law))
    rows = [
        row_of(
            named(law),
            *(
                fixed(
                    100.0 * band.held,
                    1,
                    notes=(
                        *(
                            "–" if share is None else f"{100.0 * share:.0f}"
                            for share in (band.held_moving, band.held_reversal)
                        ),
                        "–" if band.width is None else f"× {band.width:.2f}",
                    ),
                )
                for band in scores.bands[law]
            ),
        )
        for law in ranked
    ]
    return ResultTable(
        caption=f"{name}: rows within the 95\u00a0% band [%]; small: moving, near reversals, and "
        "width over that of a constant band of the same coverage",
        head=("law", *joints(len(scores.joints))),
        rows=rows,
    )


def other_truths(
    comparisons: Mapping[str, Comparison], others: Mapping[str, Errors], own: str = ""
) -> ResultTable:
    """Return laws by truths of a twin: their error over the reference's, on all joints and tests.

    The column of the run itself is headed by its truth, by MJCF where that is the model file's.

    Parameters
    ----------
    comparisons : of the run itself, by test set.
    others : RMSE under each other truth, by test set and law.
    own : truth of the run; empty for the friction of the MJCF.
    """
    first = next(iter(others.values()))
    laws = list(dict.fromkeys(law for of_test in first.values() for law in of_test))
    scores = {test: comparisons[test].laws for test in first}
    here = {
        test: {law: of_test[law].rmse for law in laws if law in of_test}
        for test, of_test in scores.items()
    }
    truths: Mapping[str, Errors] = {own or "MJCF": here, **others}
    reference = REFERENCE if REFERENCE in laws else laws[0]
    means = {law: [_mean_ratio(of, law, reference) for of in truths.values()] for law in laws}
    ranked = sorted(
        means, key=lambda law: (law == ORACLE, sum(m or float("inf") for m in means[law]))
    )
    least = [
        min((m for law in laws if law != ORACLE and (m := means[law][k]) is not None), default=0.0)
        for k in range(len(truths))
    ]
    return ResultTable(
        caption=f"Other truths of the twin: RMSE over that of {title(reference)}, geometric mean "
        "over joints and test sets",
        head=("law", *truths),
        rows=[
            row_of(
                named(law),
                *(fixed(m, 3, best=m == best) for m, best in zip(means[law], least, strict=True)),
            )
            for law in ranked
        ],
    )


def leading(errors: Errors) -> str:
    """Return the law of the least error on all joints and tests, in geometric mean."""
    laws = [law for law in next(iter(errors.values())) if law != ORACLE]
    return min(laws, key=lambda law: _mean_ratio(errors, law, laws[0]) or math.inf)


def _mean_ratio(errors: Errors, law: str, reference: str) -> float | None:
    logs = [
        math.log(own / other)
        for row in errors.values()
        if law in row and reference in row
        for own, other in zip(row[law], row[reference], strict=True)
    ]
    return math.exp(math.fsum(logs) / len(logs)) if logs else None


def position_errors(name: str, found: PositionErrors, sliding: Sequence[bool] = ()) -> ResultTable:
    """Return laws as simulators: the error of the position of each joint over windows.

    Parameters
    ----------
    name : of the test set.
    found : of the laws.
    sliding : whether each joint slides; empty if all turn.
    """
    parts = [
        (f"windows of {length:g} s", {law: of_law[k] for law, of_law in found.windows.items()})
        for k, length in enumerate(found.lengths)
    ]
    if found.open_loop:
        parts.append(("whole logs, open loop", dict(found.open_loop)))
    rows = []
    for heading, errors in parts:
        scaled = {
            law: [None if e is None else 1e3 * e for e in of_law] for law, of_law in errors.items()
        }
        places = [decimals(column) for column in zip(*scaled.values(), strict=True)]
        rows.append(row_of(heading))
        rows += [
            row_of(named(law), *(fixed(e, n) for e, n in zip(row, places, strict=True)))
            for law, row in scaled.items()
        ]
    unit = unit_of_joints("mrad", sliding)
    return ResultTable(
        caption=f"{name}: RMS error of the simulated position [{unit}]: measured torque in, "
        "identified body and friction, position out",
        head=("law", *joints(len(found.joints))),
        rows=rows,
    )


def _sight(per_log: Sequence[str] | None) -> str:
    """Say whether figures are blind, in a study where some are not."""
    if per_log is None:
        return ""
    if not per_log:
        return "; blind: nothing of these logs was fitted"
    return f"; not blind: {' and '.join(per_log)} of each log were fitted to it"


def _relative(scores: Comparison, law: str) -> tuple[bool, float]:
    """Return what laws are sorted by: their errors over friction's size; the truth comes last."""
    pairs = zip(scores.laws[law].rmse, scores.tau_std, strict=True)
    return law == ORACLE, sum(error / max(size, 1e-300) for error, size in pairs)


def _notes(ratio: Ratio) -> tuple[str, str]:
    if ratio.low is None or ratio.high is None:
        return f"{ratio.value:.2f}", "too short"
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
