"""Tables of prediction errors, bands, alternative plants and position errors."""

import math
from collections.abc import Mapping, Sequence
from operator import truediv
from statistics import geometric_mean

from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    TableRow,
    decimals,
    fixed_cell,
    joints,
    make_row,
    title,
)
from cosim.study.position_errors import PositionErrors
from cosim.study.scores import ORACLE, REFERENCE, Comparison, Errors, Ratios, find_unseparated
from cosim.study.verdict import format_excess_percent
from hesr_model.audit.properties import EXPECTATIONS, FEED_FORWARD, Properties
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import BandScore
from hesr_model.inference.choice import PLAIN, JointChoice, LawChoice
from hesr_model.inference.comparison import CALIBRATION, ErrorRatio
from hesr_model.units import unit_of_joints

MEASURES = {
    "rmse": "over all rows",
    "rmse_moving": "while moving",
    "rmse_reversal": "within 0.1 s of velocity reversals",
}
"""Measures of a test set, and their names."""
NOT_JUDGED = "\u2013"
_FEW_LOGS = 4  # logs below which intervals for other logs are wide


def errors(
    name: str,
    comparison: Comparison,
    measure: str = "rmse",
    inputs: Mapping[str, str] | None = None,
    sliding: Sequence[bool] = (),
    left_out: Mapping[str, str] | None = None,
) -> ResultTable:
    """Return one of `MEASURES` by law and joint, the lowest error first, and that without lag.

    Bold: significantly better than all others that users can run. Laws that were left out come
    last, with their reasons.
    """
    values = {law_name: getattr(scores, measure) for law_name, scores in comparison.laws.items()}
    places = [decimals(column) for column in zip(*values.values(), strict=True)]
    covers_all_rows = measure == "rmse"
    ratios = comparison.ratios.laws if covers_all_rows else {}
    zero_phase = comparison.zero_phase if covers_all_rows else {}
    rows = []
    best = [""] * len(comparison.joints)
    if covers_all_rows:
        cells = [fixed_cell(*pair) for pair in zip(comparison.tau_std, places, strict=True)]
        if zero_phase:
            cells.append(fixed_cell(None, 2))
        rows.append(make_row("(std of friction)", *cells, quiet=True))
        if len(values) > 1 and comparison.leading:
            best = [_find_clear_leader(leaders) for leaders in comparison.leading]

    def make_law_row(law_name: str) -> TableRow:
        notes = [ratio_notes(ratio) for ratio in ratios.get(law_name, ())]
        cells = [
            fixed_cell(
                value,
                places[k],
                best=law_name == best[k],
                notes=notes[k] if notes else (),
            )
            for k, value in enumerate(values[law_name])
        ]
        if zero_phase:
            cells.append(_zero_phase_cell(values[law_name], zero_phase.get(law_name)))
        return make_row(title(law_name), *cells)

    ranked = sorted(values, key=lambda law_name: (law_name == ORACLE, comparison.size(law_name)))
    for label, laws in _group_by_inputs(ranked, inputs).items():
        if label is not None:
            rows.append(make_row(f"inputs {label}" if label else "for comparison"))
        rows += [make_law_row(law_name) for law_name in laws]
    for law_name, reason in (left_out or {}).items():
        rows.append(make_row(f"{title(law_name)} was left out: {reason}"))
    unit = unit_of_joints("N.m", sliding)
    small = _describe_ratios(comparison.ratios) if ratios else ""
    if zero_phase:
        small += "; velocity behind a causal low pass; zero phase: mean ratio of RMSE without lag"
    head = ["law", *joints(len(comparison.joints))]
    if zero_phase:
        head.append("zero phase")
    return ResultTable(
        caption=f"{name}: RMSE of the predicted torque [{unit}] {MEASURES[measure]}{small}"
        f"{_describe_nuisances(comparison.per_log)}",
        head=tuple(head),
        rows=rows,
    )


def _find_clear_leader(leaders: Sequence[str]) -> str:
    """Return the leading law if no other one ties with it, else an empty name."""
    return leaders[0] if len(leaders) == 1 else ""


def _describe_ratios(ratios: Ratios) -> str:
    """Return the legend of the small figures in a table of errors."""
    reference = title(ratios.reference)
    if ratios.fair:
        reference = "the strongest classic law of the same inputs or fewer"
    is_for_others = any(ratio.on_other_logs for row in ratios.laws.values() for ratio in row)
    scope = "other logs of the kind" if is_for_others else "this log"
    return (
        f"; small: ratio to {reference} with its 95\u00a0% interval on {scope}, for each ratio "
        "alone; bold: after Holm over the laws of a joint"
    )


def recommendation(choice: LawChoice, properties: Properties | None) -> ResultTable:
    """Return the law of each joint, its error on left-out rows, and whether it is safe.

    `properties` are the physics checks of the recommended laws, None if they were not run.
    """
    rows = []
    for j, (name, joint_choice) in enumerate(
        zip(joints(len(choice.joints)), choice.joints, strict=True)
    ):
        rows.append(
            make_row(
                name,
                title(joint_choice.law_name),
                _format_ratio(joint_choice),
                _format_percent(joint_choice.unexplained),
                "proven" if joint_choice.proven else "not proven",
                _describe_feed_forward(properties, j),
            )
        )
    return ResultTable(
        caption="Recommended laws, judged on rows that neither they nor the body were fitted to",
        head=(
            "joint",
            "law",
            f"error over that of {title(PLAIN)}",
            "unexplained",
            "passivity",
            "feed-forward",
        ),
        rows=rows,
        numeric=False,
        note="With 95 % intervals. Unexplained: error over the standard deviation of the friction. "
        "Feed-forward is safe if the law starts in motion, is quiet at rest and generates no "
        "energy in a cycle.",
    )


def _format_ratio(joint_choice: JointChoice) -> str:
    if joint_choice.ratio is None or joint_choice.low is None or joint_choice.high is None:
        return NOT_JUDGED
    return f"{joint_choice.ratio:.2f} ({joint_choice.low:.2f} to {joint_choice.high:.2f})"


def _format_percent(share: float | None) -> str:
    return NOT_JUDGED if share is None else f"{100.0 * share:.0f} %"


def _describe_feed_forward(properties: Properties | None, j: int) -> str:
    """Return whether a joint's law passes the checks that feed-forward needs."""
    if properties is None:
        return "not checked"
    results = properties.joints[j].findings
    failed = [EXPECTATIONS[key].title for key in FEED_FORWARD if results[key].verdict == "fail"]
    return f"fails: {', '.join(failed)}" if failed else "safe"


def separations(name: str, comparison: Comparison, laws: Sequence[str] = ()) -> ResultTable | None:
    """Return which laws a test does not separate from others, and what would show; or None.

    `laws` are those recommended for each joint; without them it is the law with the lowest error.
    """
    if not comparison.detectable:
        return None
    rows = []
    for j, short in enumerate(joints(len(comparison.joints))):
        best = comparison.leading[j][0]
        law_name = laws[j] if laws else best
        unseparated = find_unseparated(comparison, law_name, j)
        cells = [title(law_name)]
        if laws:
            better = unseparated.better if unseparated else ()
            cells += [title(best), ", ".join(map(title, better)) or "none"]
        if unseparated is None:  # results of earlier versions
            cells += ["unknown"] * 3
        else:
            detectable_text = "too short"
            if unseparated.detectable:
                detectable_text = format_excess_percent(*unseparated.detectable)
            cells += [
                ", ".join(map(title, unseparated.laws)) or "none",
                detectable_text,
                f"{unseparated.seconds:.0f} s",
            ]
        rows.append(make_row(short, *cells))
    judged = "recommended law" if laws else "law with the lowest error"
    head = ("recommended", "lowest error", "better") if laws else ("lowest error",)
    return ResultTable(
        caption=f"{name}: laws that the test does not separate from the {judged}",
        head=("joint", *head, "not separated", "would show", "for 10 %"),
        rows=rows,
        numeric=False,
        note=_describe_test(comparison.log_count),
    )


def _describe_test(log_count: int) -> str:
    """Return how a test of so many logs separates laws, and the logs to which that applies."""
    holm = "Holm over the laws of a joint"
    if log_count > 1:
        few = ""
        if log_count < _FEW_LOGS:
            few = f" {log_count} logs are few: only large differences show."
        return (
            f"Student's t over differences between {log_count} logs, {holm} and over all pairs of "
            "laws, since the logs choose the best. The result holds for other logs of this kind."
            f"{few}"
        )
    return (
        f"Student's t over cosines of the squared errors, {holm}; p is multiplied by "
        f"{CALIBRATION:.0f} (1 + 1.5/degrees of freedom), beyond 9 laws by more in proportion, "
        "since the nominal level was calibrated. The result holds on this log only."
    )


def cross_validation(
    models: Mapping[str, FrictionModel], sliding: Sequence[bool] = ()
) -> ResultTable | None:
    """Return the errors on training logs left out in turn, by law and joint; None if unknown."""
    validated_models = {
        law_name: model for law_name, model in models.items() if model.left_out_rmse
    }
    if not validated_models:
        return None
    columns = list(zip(*(model.left_out_rmse for model in validated_models.values()), strict=True))
    places = list(map(decimals, columns))
    return ResultTable(
        caption=f"RMSE on training logs left out in turn [{unit_of_joints('N.m', sliding)}]"
        + ", of friction coordinates" * any(model.coupling for model in validated_models.values()),
        head=("law", *joints(len(columns))),
        rows=[
            make_row(title(law_name), *map(fixed_cell, model.left_out_rmse, places))
            for law_name, model in validated_models.items()
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
        return fixed_cell(100.0 * band.held, 1, notes=(*notes, width))

    ranked = sorted(
        comparison.bands, key=lambda law_name: (law_name == ORACLE, comparison.size(law_name))
    )
    return ResultTable(
        caption=f"{name}: rows within the 95\u00a0% band [%]; small: moving, near reversals, and "
        "width over that of a constant band of the same coverage",
        head=("law", *joints(len(comparison.joints))),
        rows=[
            make_row(title(law_name), *map(cell, comparison.bands[law_name])) for law_name in ranked
        ],
    )


def compare_truths(
    comparisons: Mapping[str, Comparison],
    errors_by_truth: Mapping[str, Errors],
    run_truth: str = "",
) -> ResultTable:
    """Return errors over the reference's by plant of a twin; `run_truth` is that of the run."""
    first_errors = next(iter(errors_by_truth.values()))
    laws = list(dict.fromkeys(law_name for errors in first_errors.values() for law_name in errors))
    scores = {test: comparisons[test].laws for test in first_errors}
    run_errors = {
        test: {law_name: law_scores[law_name].rmse for law_name in laws if law_name in law_scores}
        for test, law_scores in scores.items()
    }
    truths: Mapping[str, Errors] = {run_truth or "MJCF": run_errors, **errors_by_truth}
    reference = REFERENCE if REFERENCE in laws else laws[0]
    means = {
        law_name: [
            _mean_ratio(truth_errors, law_name, reference) for truth_errors in truths.values()
        ]
        for law_name in laws
    }
    ranked = sorted(
        means,
        key=lambda law_name: (
            law_name == ORACLE,
            sum(mean_ratio or float("inf") for mean_ratio in means[law_name]),
        ),
    )
    lowest = [
        min(
            (
                mean_ratio
                for law_name in laws
                if law_name != ORACLE and (mean_ratio := means[law_name][k]) is not None
            ),
            default=0.0,
        )
        for k in range(len(truths))
    ]
    return ResultTable(
        caption=f"Alternative plants of the twin: RMSE over that of {title(reference)}, geometric "
        "mean over joints and test sets",
        head=("law", *truths),
        rows=[
            make_row(
                title(law_name),
                *(
                    fixed_cell(mean_ratio, 3, best=mean_ratio == best)
                    for mean_ratio, best in zip(means[law_name], lowest, strict=True)
                ),
            )
            for law_name in ranked
        ],
    )


def describe_true_friction(truth: str) -> str:
    """Return a sentence on the family of a twin's true friction; "" is that of its MJCF."""
    if truth:
        return f"The friction of this simulated robot is '{truth}' of its plant."
    return (
        "The friction of this simulated robot is LuGre bristles in parallel, which favours LuGre."
    )


def find_leader(errors: Errors) -> str:
    """Return the law with the lowest geometric mean error."""
    laws = [law_name for law_name in next(iter(errors.values())) if law_name != ORACLE]
    return min(laws, key=lambda law_name: _mean_ratio(errors, law_name, laws[0]) or math.inf)


def _mean_ratio(errors: Errors, law_name: str, reference: str) -> float | None:
    log_ratios = [
        math.log(law_error / reference_error)
        for row in errors.values()
        if law_name in row and reference in row
        for law_error, reference_error in zip(row[law_name], row[reference], strict=True)
    ]
    return math.exp(math.fsum(log_ratios) / len(log_ratios)) if log_ratios else None


def position_errors(
    name: str,
    simulated_errors: PositionErrors,
    comparison: Comparison,
    sliding: Sequence[bool] = (),
) -> ResultTable:
    """Return errors of laws by joint: torque for feed-forward, position for simulation."""
    laws = list(simulated_errors.windows)
    errors: list[list[Sequence[float | None]]] = [
        [comparison.laws[law_name].rmse for law_name in laws]
    ]
    errors += [
        [simulated_errors.windows[law_name][k] for law_name in laws]
        for k in range(len(simulated_errors.lengths))
    ]
    heads = [f"{length:g} s" for length in simulated_errors.lengths]
    if simulated_errors.open_loop:
        errors.append(
            [
                simulated_errors.open_loop.get(law_name, (None,) * len(simulated_errors.joints))
                for law_name in laws
            ]
        )
        heads.append("open loop")
    rows = []
    for j, joint in enumerate(joints(len(simulated_errors.joints))):
        columns = [
            [error and scale * error for error in (law_errors[j] for law_errors in column)]
            for column, scale in zip(errors, (1.0, *[1e3] * len(heads)), strict=True)
        ]
        lowest = [
            min((error for error in column if error is not None), default=None)
            for column in columns
        ]
        places = [decimals(column) for column in columns]
        rows += [make_row(joint)] * (len(simulated_errors.joints) > 1)
        rows += [
            make_row(
                title(law_name),
                *(
                    fixed_cell(error, decimal_count, best=error == best)
                    for error, decimal_count, best in zip(row, places, lowest, strict=True)
                ),
            )
            for law_name, *row in zip(laws, *columns, strict=True)
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


def _zero_phase_cell(errors: Sequence[float], zero_phase: Sequence[float] | None) -> TableCell:
    if zero_phase is None or min(*errors, *zero_phase) <= 0.0:
        return fixed_cell(None, 2)
    return fixed_cell(geometric_mean(map(truediv, zero_phase, errors)), 2)


def _describe_nuisances(per_log: Sequence[str] | None) -> str:
    if per_log is None:
        return ""
    if not per_log:
        return "; blind: no parameter was fitted to these logs"
    return f"; not blind: {' and '.join(per_log)} of each log were fitted to it"


def ratio_notes(ratio: ErrorRatio) -> tuple[str, ...]:
    """Return a ratio and its interval."""
    if ratio.low is None or ratio.high is None:
        return f"{ratio.value:.2f}", "too short"
    return f"{ratio.value:.2f}", f"{ratio.low:.2f}–{ratio.high:.2f}"


def _group_by_inputs(
    laws: Sequence[str], inputs: Mapping[str, str] | None
) -> dict[str | None, list[str]]:
    if inputs is None:
        return {None: list(laws)}
    classes: dict[str | None, list[str]] = {}
    for law_name in laws:
        classes.setdefault(inputs.get(law_name, ""), []).append(law_name)
    return dict(sorted(classes.items(), key=lambda c: (not c[0], str(c[0]).count(","))))
