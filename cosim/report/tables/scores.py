"""Tables of prediction errors, bands, alternative plants and position errors."""

import math
from collections.abc import Mapping, Sequence
from operator import truediv
from statistics import geometric_mean

from cosim.report.tables.table import ResultTable, TableCell, decimals, fixed, joints, row_of, title
from cosim.study.position_errors import PositionErrors
from cosim.study.scores import ORACLE, REFERENCE, Comparison, Errors
from cosim.study.verdict import format_percent_above, separation
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import BandScore
from hesr_model.inference.comparison import CALIBRATION, ErrorRatio
from hesr_model.units import unit_of_joints

MEASURES = {
    "rmse": "over all rows",
    "rmse_moving": "while moving (|dq| > 0.02 {speed})",
    "rmse_reversal": "within 0.1 s of velocity reversals",
}
"""Measures of a test set, and their names."""


def errors(
    name: str,
    comparison: Comparison,
    measure: str = "rmse",
    inputs: Mapping[str, str] | None = None,
    sliding: Sequence[bool] = (),
) -> ResultTable:
    """Return one of `MEASURES` by law and joint, the lowest error first, and that without lag.

    Bold: significantly better than all others that users can run.
    """
    values = {law: getattr(of_law, measure) for law, of_law in comparison.laws.items()}
    places = [decimals(column) for column in zip(*values.values(), strict=True)]
    whole = measure == "rmse"
    ratios = comparison.ratios.laws if whole else {}
    alone = [of_joint[0] if len(of_joint) == 1 else "" for of_joint in comparison.leading]
    ideal = comparison.zero_phase if whole else {}
    best = alone if whole and len(values) > 1 and alone else [""] * len(comparison.joints)
    rows = []
    if whole:
        cells = [fixed(s, n) for s, n in zip(comparison.tau_std, places, strict=True)]
        cells += [fixed(None, 2)] * bool(ideal)
        rows.append(row_of("(std of friction)", *cells, quiet=True))

    def cell(law: str, k: int, value: float | None) -> TableCell:
        notes = ratio_notes(ratios[law][k]) if law in ratios else ()
        return fixed(value, places[k], best=law == best[k], notes=notes)

    ranked = sorted(values, key=lambda law: (law == ORACLE, comparison.size(law)))
    for label, laws in _by_inputs(ranked, inputs).items():
        if label is not None:
            rows.append(row_of(f"inputs {label}" if label else "for comparison"))
        rows += [
            row_of(
                title(law),
                *(cell(law, k, value) for k, value in enumerate(values[law])),
                *([_without_lag(values[law], ideal.get(law))] if ideal else []),
            )
            for law in laws
        ]
    unit, speed = (unit_of_joints(u, sliding) for u in ("N.m", "rad/s"))
    reference = title(comparison.ratios.reference)
    if comparison.ratios.fair:
        reference = "the strongest classic law of the same inputs or fewer"
    small = f"; small: ratio to {reference} with its 95\u00a0% interval" if ratios else ""
    if any(ratio.others for of_law in ratios.values() for ratio in of_law):
        small += " on these logs, then on other logs of the kind"
    if ideal:
        small += "; velocity behind a causal low pass; zero phase: mean ratio of RMSE without lag"
    words = MEASURES[measure].format(speed=speed)
    return ResultTable(
        caption=f"{name}: RMSE of the predicted torque [{unit}] {words}{small}"
        f"{_fitted(comparison.per_log)}",
        head=("law", *joints(len(comparison.joints)), *(["zero phase"] if ideal else [])),
        rows=rows,
    )


def separations(name: str, comparison: Comparison, laws: Sequence[str] = ()) -> ResultTable | None:
    """Return which laws a test does not separate from the best, and what would show; or None.

    `laws` are those recommended for each joint, if any.
    """
    if not comparison.detectable:
        return None
    rows = []
    shorts = joints(len(comparison.joints))
    for k, (short, one) in enumerate(zip(shorts, separation(comparison), strict=True)):
        shown = format_percent_above(*one.detectable) if one.detectable else "too short"
        names = ", ".join(map(title, one.tied)) or "none"
        own = [title(law) for law in laws[k : k + 1]]
        rows.append(row_of(short, *own, title(one.best), names, shown, f"{one.seconds:.0f} s"))
    return ResultTable(
        caption=f"{name}: laws that the test does not separate from the one with the lowest error",
        head=(
            *("joint", "recommended")[: 2 if laws else 1],
            *("lowest error", "not separated", "would show", "for 10 %"),
        ),
        rows=rows,
        numeric=False,
        note="Student's t over cosines of the squared errors and differences between logs, Holm "
        f"over the laws of a joint; p is multiplied by {CALIBRATION:.0f} (1 + 1.5/degrees of "
        "freedom), beyond 9 laws by more in proportion, since the nominal level was calibrated. "
        "The result holds for motions of this kind.",
    )


def left_out(
    models: Mapping[str, FrictionModel], sliding: Sequence[bool] = ()
) -> ResultTable | None:
    """Return the errors on training logs left out in turn, by law and joint; None if unknown."""
    known = {law: model for law, model in models.items() if model.left_out_rmse}
    if not known:
        return None
    columns = list(zip(*(model.left_out_rmse for model in known.values()), strict=True))
    places = list(map(decimals, columns))
    return ResultTable(
        caption=f"RMSE on training logs left out in turn [{unit_of_joints('N.m', sliding)}]"
        + ", of friction coordinates" * any(model.coupling for model in known.values()),
        head=("law", *joints(len(columns))),
        rows=[
            row_of(title(law), *map(fixed, model.left_out_rmse, places))
            for law, model in known.items()
        ],
    )


def bands(name: str, comparison: Comparison) -> ResultTable:
    """Return the share of test rows within each law's 95 % band.

    Notes: share of moving rows, share near reversals, width over that of an equal constant band.
    """

    def cell(band: BandScore) -> TableCell:
        shares = (band.held_moving, band.held_reversal)
        notes = ["–" if share is None else f"{100.0 * share:.0f}" for share in shares]
        width = "–" if band.width is None else f"× {band.width:.2f}"
        return fixed(100.0 * band.held, 1, notes=(*notes, width))

    ranked = sorted(comparison.bands, key=lambda law: (law == ORACLE, comparison.size(law)))
    return ResultTable(
        caption=f"{name}: rows within the 95\u00a0% band [%]; small: moving, near reversals, and "
        "width over that of a constant band of the same coverage",
        head=("law", *joints(len(comparison.joints))),
        rows=[row_of(title(law), *map(cell, comparison.bands[law])) for law in ranked],
    )


def other_truths(
    comparisons: Mapping[str, Comparison], others: Mapping[str, Errors], own: str = ""
) -> ResultTable:
    """Return errors over the reference's by plant of a twin; `own` is the run's, "" the MJCF's."""
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
        caption=f"Alternative plants of the twin: RMSE over that of {title(reference)}, geometric "
        "mean over joints and test sets",
        head=("law", *truths),
        rows=[
            row_of(
                title(law),
                *(fixed(m, 3, best=m == best) for m, best in zip(means[law], least, strict=True)),
            )
            for law in ranked
        ],
    )


def own_friction(truth: str) -> str:
    """Return a sentence on the family of a twin's true friction; "" is that of its MJCF."""
    if truth:
        return f"The friction of this simulated robot is '{truth}' of its plant."
    return (
        "The friction of this simulated robot is LuGre bristles in parallel, which favours LuGre."
    )


def leading(errors: Errors) -> str:
    """Return the law with the lowest geometric mean error."""
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


def position_errors(
    name: str, found: PositionErrors, comparison: Comparison, sliding: Sequence[bool] = ()
) -> ResultTable:
    """Return errors of laws by joint: torque for feed-forward, position for simulation."""
    laws = list(found.windows)
    errors: list[list[Sequence[float | None]]] = [[comparison.laws[law].rmse for law in laws]]
    errors += [[found.windows[law][k] for law in laws] for k in range(len(found.lengths))]
    heads = [f"{length:g} s" for length in found.lengths]
    if found.open_loop:
        errors.append([found.open_loop.get(law, (None,) * len(found.joints)) for law in laws])
        heads.append("open loop")
    rows = []
    for j, joint in enumerate(joints(len(found.joints))):
        columns = [
            [e and scale * e for e in (of_law[j] for of_law in column)]
            for column, scale in zip(errors, (1.0, *[1e3] * len(heads)), strict=True)
        ]
        least = [min((e for e in column if e is not None), default=None) for column in columns]
        places = [decimals(column) for column in columns]
        rows += [row_of(joint)] * (len(found.joints) > 1)
        rows += [
            row_of(
                title(law),
                *(fixed(e, p, best=e == b) for e, p, b in zip(row, places, least, strict=True)),
            )
            for law, *row in zip(laws, *columns, strict=True)
        ]
    torque = unit_of_joints("N.m", sliding)
    position = unit_of_joints("mrad", sliding)
    return ResultTable(
        caption=f"{name}: RMS error of the torque [{torque}], and of the position [{position}] "
        "simulated with measured torque, identified body and friction: over windows, and over "
        "whole logs in open loop",
        head=("law", "torque", *heads),
        rows=rows,
    )


def _without_lag(errors: Sequence[float], ideal: Sequence[float] | None) -> TableCell:
    if ideal is None or min(*errors, *ideal) <= 0.0:
        return fixed(None, 2)
    return fixed(geometric_mean(map(truediv, ideal, errors)), 2)


def _fitted(per_log: Sequence[str] | None) -> str:
    if per_log is None:
        return ""
    if not per_log:
        return "; blind: no parameter was fitted to these logs"
    return f"; not blind: {' and '.join(per_log)} of each log were fitted to it"


def ratio_notes(ratio: ErrorRatio) -> tuple[str, ...]:
    """Return a ratio, its interval, and that for other logs if known."""
    if ratio.low is None or ratio.high is None:
        return f"{ratio.value:.2f}", "too short"
    others = ["{:.2f}–{:.2f}".format(*ratio.others)] if ratio.others else []
    return f"{ratio.value:.2f}", f"{ratio.low:.2f}–{ratio.high:.2f}", *others


def _by_inputs(
    laws: Sequence[str], inputs: Mapping[str, str] | None
) -> dict[str | None, list[str]]:
    if inputs is None:
        return {None: list(laws)}
    classes: dict[str | None, list[str]] = {}
    for law in laws:
        classes.setdefault(inputs.get(law, ""), []).append(law)
    return dict(sorted(classes.items(), key=lambda c: (not c[0], str(c[0]).count(","))))
