"""Tables of prediction errors, bands, alternative plants and position errors."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from operator import truediv
from statistics import geometric_mean
from typing import NamedTuple

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
from cosim.study.scores import (
    ORACLE,
    REFERENCE,
    Comparison,
    Errors,
    Ratios,
    Unseparated,
    find_unseparated,
)
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


class _JointColumn(NamedTuple):
    """Format of the errors of one joint.

    Attributes
    ----------
    places : decimals.
    leader : law that is better than all others, or "".
    """

    places: int
    leader: str


class _PositionColumn(NamedTuple):
    """Column of `position_errors`.

    Attributes
    ----------
    head : its head.
    scale : shown units in one unit of the errors.
    errors : errors of each law by joint; None if the simulation diverges.
    """

    head: str
    scale: float
    errors: Mapping[str, Sequence[float | None]]


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
    covers_all_rows = measure == "rmse"
    columns = _format_joints(comparison, values, marks_leaders=covers_all_rows)
    ratios: Mapping[str, Sequence[ErrorRatio]] = {}
    zero_phase: Mapping[str, Sequence[float]] = {}
    rows = []
    if covers_all_rows:
        ratios = comparison.ratios.laws
        zero_phase = comparison.zero_phase
        rows.append(_make_std_row(comparison, columns))

    def make_law_row(law_name: str) -> TableRow:
        cells = _error_cells(law_name, values[law_name], columns, ratios.get(law_name, ()))
        if zero_phase:
            cells.append(_zero_phase_cell(values[law_name], zero_phase.get(law_name)))
        return make_row(title(law_name), *cells)

    ranked = _rank_laws(values, comparison)
    for label, laws in _group_by_inputs(ranked, inputs).items():
        if label is not None:
            rows.append(make_row(f"inputs {label}" if label else "for comparison"))
        rows += [make_law_row(law_name) for law_name in laws]
    for law_name, reason in (left_out or {}).items():
        rows.append(make_row(f"{title(law_name)} was left out: {reason}"))
    unit = unit_of_joints("N.m", sliding)
    head = ["law", *joints(len(comparison.joints))]
    small = ""
    if ratios:
        small = _describe_ratios(comparison.ratios)
    if zero_phase:
        small += "; velocity behind a causal low pass; zero phase: mean ratio of RMSE without lag"
        head.append("zero phase")
    return ResultTable(
        caption=f"{name}: RMSE of the predicted torque [{unit}] {MEASURES[measure]}{small}"
        f"{_describe_nuisances(comparison.per_log)}",
        head=tuple(head),
        rows=rows,
    )


def _format_joints(
    comparison: Comparison,
    values: Mapping[str, Sequence[float | None]],
    *,
    marks_leaders: bool,
) -> list[_JointColumn]:
    """Return the format of each joint's values by law."""
    leaders = [""] * len(comparison.joints)
    if marks_leaders and len(values) > 1 and comparison.leading:
        leaders = [_find_clear_leader(tied) for tied in comparison.leading]
    value_columns = zip(*values.values(), strict=True)
    return [
        _JointColumn(decimals(joint_values), leader)
        for joint_values, leader in zip(value_columns, leaders, strict=True)
    ]


def _find_clear_leader(leaders: Sequence[str]) -> str:
    """Return the leading law if no other one ties with it, else an empty name."""
    return leaders[0] if len(leaders) == 1 else ""


def _make_std_row(comparison: Comparison, columns: Sequence[_JointColumn]) -> TableRow:
    """Return the row of the standard deviation of each joint's friction."""
    cells = []
    for std, column in zip(comparison.tau_std, columns, strict=True):
        cells.append(fixed_cell(std, column.places))
    if comparison.zero_phase:
        cells.append(fixed_cell(None, 2))
    return make_row("(std of friction)", *cells, quiet=True)


def _error_cells(
    law_name: str,
    values: Sequence[float | None],
    columns: Sequence[_JointColumn],
    ratios: Sequence[ErrorRatio],
) -> list[TableCell]:
    """Return the cells of a law's errors by joint, with its ratios to references if known."""
    cells = []
    for j, (value, column) in enumerate(zip(values, columns, strict=True)):
        notes = ratio_notes(ratios[j]) if ratios else ()
        cells.append(fixed_cell(value, column.places, best=law_name == column.leader, notes=notes))
    return cells


def _rank_laws(laws: Iterable[str], comparison: Comparison) -> list[str]:
    """Sort laws by their unexplained share of friction; the oracle comes last."""
    return sorted(laws, key=lambda law_name: (law_name == ORACLE, comparison.size(law_name)))


def _describe_ratios(ratios: Ratios) -> str:
    """Return the legend of the small figures in a table of errors."""
    reference = title(ratios.reference)
    if ratios.fair:
        reference = "the strongest classic law of the same inputs or fewer"
    scope = describe_scope(chain.from_iterable(ratios.laws.values()))
    return (
        f"; small: ratio to {reference} with its 95\u00a0% interval on {scope}, for each ratio "
        "alone; bold: after Holm over the laws of a joint"
    )


def describe_scope(ratios: Iterable[ErrorRatio]) -> str:
    """Return the logs for which the intervals of ratios hold."""
    if any(ratio.on_other_logs for ratio in ratios):
        return "other logs of the kind"
    return "this log"


def recommendation(choice: LawChoice, properties: Properties | None) -> ResultTable:
    """Return the law of each joint, its error on left-out rows, and whether it is safe.

    `properties` are the physics checks of the recommended laws, None if they were not run.
    """
    rows = []
    names = joints(len(choice.joints))
    for j, joint_choice in enumerate(choice.joints):
        rows.append(
            make_row(
                names[j],
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
    if share is None:
        return NOT_JUDGED
    return f"{100.0 * share:.0f} %"


def _describe_feed_forward(properties: Properties | None, j: int) -> str:
    """Return whether a joint's law passes the checks that feed-forward needs."""
    if properties is None:
        return "not checked"
    results = properties.joints[j].findings
    failed = [EXPECTATIONS[key].title for key in FEED_FORWARD if results[key].verdict == "fail"]
    if failed:
        return f"fails: {', '.join(failed)}"
    return "safe"


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
            cells += [title(best), _join_titles(better)]
        cells += _describe_separation(unseparated)
        rows.append(make_row(short, *cells))
    judged = "law with the lowest error"
    head = ["lowest error"]
    if laws:
        judged = "recommended law"
        head = ["recommended", "lowest error", "better"]
    return ResultTable(
        caption=f"{name}: laws that the test does not separate from the {judged}",
        head=("joint", *head, "not separated", "would show", "for 10 %"),
        rows=rows,
        numeric=False,
        note=_describe_test(comparison.log_count),
    )


def _describe_separation(unseparated: Unseparated | None) -> list[str]:
    """Return the laws not separated from a law, what would show, and the time that it takes."""
    if unseparated is None:  # results of earlier versions
        return ["unknown"] * 3
    detectable_text = "too short"
    if unseparated.detectable:
        detectable_text = format_excess_percent(*unseparated.detectable)
    return [_join_titles(unseparated.laws), detectable_text, f"{unseparated.seconds:.0f} s"]


def _join_titles(laws: Iterable[str]) -> str:
    return ", ".join(map(title, laws)) or "none"


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
    caption = f"RMSE on training logs left out in turn [{unit_of_joints('N.m', sliding)}]"
    if any(model.coupling for model in validated_models.values()):
        caption += ", of friction coordinates"
    return ResultTable(
        caption=caption,
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
    ranked = _rank_laws(comparison.bands, comparison)
    return ResultTable(
        caption=f"{name}: rows within the 95\u00a0% band [%]; small: moving, near reversals, and "
        "width over that of a constant band of the same coverage",
        head=("law", *joints(len(comparison.joints))),
        rows=[
            make_row(title(law_name), *map(_band_cell, comparison.bands[law_name]))
            for law_name in ranked
        ],
    )


def _band_cell(band: BandScore) -> TableCell:
    """Return the coverage of a joint's band [%]; notes as in `bands`."""
    notes = (
        _format_number(band.held_moving, "{:.0f}", scale=100.0),
        _format_number(band.held_reversal, "{:.0f}", scale=100.0),
        _format_number(band.width, "× {:.2f}"),
    )
    return fixed_cell(100.0 * band.held, 1, notes=notes)


def _format_number(value: float | None, template: str, *, scale: float = 1.0) -> str:
    """Return a scaled number by a template, or a dash without one."""
    if value is None:
        return NOT_JUDGED
    return template.format(scale * value)


def compare_truths(
    comparisons: Mapping[str, Comparison],
    errors_by_truth: Mapping[str, Errors],
    run_truth: str = "",
) -> ResultTable:
    """Return errors over the reference's by plant of a twin; `run_truth` is that of the run."""
    first_errors = next(iter(errors_by_truth.values()))
    laws = list(dict.fromkeys(chain.from_iterable(first_errors.values())))
    run_errors = {test: _select_rmse(comparisons[test], laws) for test in first_errors}
    truths: Mapping[str, Errors] = {run_truth or "MJCF": run_errors, **errors_by_truth}
    reference = REFERENCE if REFERENCE in laws else laws[0]
    columns = [_mean_ratios(truth_errors, laws, reference) for truth_errors in truths.values()]
    lowest_ratios = [_find_lowest_ratio(column) for column in columns]

    def rank(law_name: str) -> tuple[bool, float]:
        # A law that has no error on some plant follows all that have one on each.
        return law_name == ORACLE, sum(column[law_name] or math.inf for column in columns)

    rows = []
    for law_name in sorted(laws, key=rank):
        cells = []
        for column, lowest_ratio in zip(columns, lowest_ratios, strict=True):
            mean_ratio = column[law_name]
            cells.append(fixed_cell(mean_ratio, 3, best=mean_ratio == lowest_ratio))
        rows.append(make_row(title(law_name), *cells))
    return ResultTable(
        caption=f"Alternative plants of the twin: RMSE over that of {title(reference)}, geometric "
        "mean over joints and test sets",
        head=("law", *truths),
        rows=rows,
    )


def _select_rmse(comparison: Comparison, laws: Iterable[str]) -> dict[str, tuple[float, ...]]:
    """Return the errors [N.m] by joint of those laws that a test has scored."""
    return {
        law_name: comparison.laws[law_name].rmse for law_name in laws if law_name in comparison.laws
    }


def _find_lowest_ratio(mean_ratios: Mapping[str, float | None]) -> float:
    """Return the lowest ratio of a law that users can run; 0 if there is none."""
    known_ratios = [
        mean_ratio
        for law_name, mean_ratio in mean_ratios.items()
        if law_name != ORACLE and mean_ratio is not None
    ]
    return min(known_ratios, default=0.0)


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


def _mean_ratios(errors: Errors, laws: Iterable[str], reference: str) -> dict[str, float | None]:
    return {law_name: _mean_ratio(errors, law_name, reference) for law_name in laws}


def _mean_ratio(errors: Errors, law_name: str, reference: str) -> float | None:
    """Return the geometric mean of a law's errors over those of a reference; None if unknown."""
    log_ratios: list[float] = []
    for test_errors in errors.values():
        if law_name in test_errors and reference in test_errors:
            pairs = zip(test_errors[law_name], test_errors[reference], strict=True)
            log_ratios += [math.log(error / reference_error) for error, reference_error in pairs]

    if not log_ratios:
        return None
    # An exact sum does not depend on the order of the tests.
    return math.exp(math.fsum(log_ratios) / len(log_ratios))


def position_errors(
    name: str,
    simulated_errors: PositionErrors,
    comparison: Comparison,
    sliding: Sequence[bool] = (),
) -> ResultTable:
    """Return errors of laws by joint: torque for feed-forward, position for simulation."""
    laws = list(simulated_errors.windows)
    joint_names = joints(len(simulated_errors.joints))
    columns = _position_columns(simulated_errors, comparison)
    rows = []
    for j, joint in enumerate(joint_names):
        if len(joint_names) > 1:
            rows.append(make_row(joint))
        column_cells = [_position_cells(column, laws, j) for column in columns]
        for law_name, *cells in zip(laws, *column_cells, strict=True):
            rows.append(make_row(title(law_name), *cells))
    torque = unit_of_joints("N.m", sliding)
    position = unit_of_joints("mrad", sliding)
    return ResultTable(
        caption=f"{name}: RMS error of the torque [{torque}], and of the position [{position}] "
        "simulated with measured torque, identified body and friction: over windows, and over "
        "whole logs in open loop",
        head=("law", *(column.head for column in columns)),
        rows=rows,
    )


def _position_columns(
    simulated_errors: PositionErrors, comparison: Comparison
) -> list[_PositionColumn]:
    """Return the columns of torques, of windows by length, and of whole logs if simulated."""
    windows = simulated_errors.windows
    torque_errors = {law_name: comparison.laws[law_name].rmse for law_name in windows}
    columns = [_PositionColumn("torque", 1.0, torque_errors)]
    for k, length in enumerate(simulated_errors.lengths):
        window_errors = {law_name: windows[law_name][k] for law_name in windows}
        columns.append(_PositionColumn(f"{length:g} s", 1e3, window_errors))
    if simulated_errors.open_loop:
        unknown = (None,) * len(simulated_errors.joints)
        log_errors = {
            law_name: simulated_errors.open_loop.get(law_name, unknown) for law_name in windows
        }
        columns.append(_PositionColumn("open loop", 1e3, log_errors))
    return columns


def _position_cells(column: _PositionColumn, laws: Sequence[str], j: int) -> list[TableCell]:
    """Return the cells of one joint by law, the lowest error in bold."""
    joint_errors = [column.errors[law_name][j] for law_name in laws]
    scaled_errors = [None if error is None else column.scale * error for error in joint_errors]
    lowest = min((error for error in scaled_errors if error is not None), default=None)
    places = decimals(scaled_errors)
    return [fixed_cell(error, places, best=error == lowest) for error in scaled_errors]


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

    def rank(label: str | None) -> tuple[bool, int]:
        # Few inputs come first; rows without a class, for comparison, come last.
        return not label, str(label).count(",")

    return {label: classes[label] for label in sorted(classes, key=rank)}
