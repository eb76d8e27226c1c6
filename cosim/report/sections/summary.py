"""First layer: recommended FMU, warnings, errors by joint, one plot, and limits."""

from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel, draw_chart
from cosim.report.figures.style import MEASURED, SERIES, Stroke
from cosim.report.results import Results
from cosim.report.sections.prediction import WINDOW, band
from cosim.report.tables import table
from cosim.report.tables.laws import find_most_passing
from cosim.report.tables.scores import (
    describe_scope,
    find_leader,
    ratio_notes,
    recommendation,
)
from cosim.study.results import read_findings
from cosim.study.scores import ORACLE, Comparison, is_usable
from cosim.study.verdict import describe_choice
from hesr_model.audit.properties import EXPECTATIONS, combine_results
from hesr_model.fitting.estimator import papers_law
from hesr_model.inference.comparison import ErrorRatio

_MAX_LISTED_JOINTS = 3  # maximum number of joints whose figures are listed
_MAX_LISTED_FINDINGS = 2  # number of findings in the first layer
_WIDTH = 4.4
_HEIGHT = 1.9  # size of the plot [in], readable on a phone


def summary(results: Results) -> dict[str, Any]:
    """Return the values of the first layer."""
    laws = results.recommended
    findings = read_findings(results.folder)
    first_findings = findings[:_MAX_LISTED_FINDINGS]
    values: dict[str, Any] = {
        "run": results.run,
        "verdict": results.verdict,
        "law": table.join_law_titles(laws),
        "fmu": "",
        "findings": len(findings),
        "first": [replace(finding, remedy="").sentence for finding in first_findings],
        "errors": errors(results, laws),
        "recommendation": _recommend(results),
        "choice": _describe_choice(results),
        "plot": _plot(results, laws),
        "laws": len(results.models),
        "tests": len(results.tests),
        "has_tests": results.has_tests,
        "has_loop": results.loop is not None,
        "floor": _floor(results),
        "winners": [
            (table.title(find_leader(plant_errors)), plant)
            for plant, plant_errors in results.truths.items()
        ],
        "passed": None,
        "most": None,
        "checks": len(EXPECTATIONS),
    }
    if (results.folder / results.fmu).is_file():
        values["fmu"] = results.fmu
    if papers_law() in results.properties:
        values["passed"] = results.properties[papers_law()].passed
    if results.properties:
        passing_laws, passed_count = find_most_passing(results.properties)
        values["most"] = (", ".join(map(table.title, passing_laws)), passed_count)
    return values


def _recommend(results: Results) -> table.ResultTable | None:
    """Return the table of the recommended laws; None for results of earlier versions."""
    verdict = results.verdict
    if verdict is None or verdict.choice is None:
        return None
    properties = combine_results(verdict.law, results.properties, verdict.laws)
    return recommendation(verdict.choice, properties)


def _describe_choice(results: Results) -> list[str]:
    """Return what left-out rows say of the recommended laws; none for earlier versions."""
    verdict = results.verdict
    if verdict is None or verdict.choice is None:
        return []
    return list(describe_choice(verdict.choice))


def errors(results: Results, laws: Sequence[str]) -> table.ResultTable:
    """Return error, unexplained share, and ratio to the strongest reference of a law per joint."""
    test = results.tests[0]
    comparison = results.comparisons[test]
    rmse = comparison.combine_scores(laws).rmse
    places = table.decimals(rmse)
    head = ["joint", "RMSE", "unexplained"]
    caption = f"Error of {table.join_law_titles(laws)} on ‘{test}’ [{results.unit('N.m')}]"
    cells_by_joint: list[list[table.TableCell]] = []
    for error, share in zip(rmse, comparison.unexplained_shares(rmse), strict=True):
        percent = 100 * share
        share_cell = table.TableCell(text=f"{percent:.0f} %", value=percent)
        cells_by_joint.append([table.fixed_cell(error, places), share_cell])
    reference = _choose_reference(comparison, laws)
    if reference:
        head += ["reference", "ratio"]
        caption += f" and of {reference.describe()}"
        reference_rmse = comparison.combine_scores(reference.laws).rmse
        for j, ratio in enumerate(reference.ratios):
            reference_cell = table.fixed_cell(reference_rmse[j], places)
            ratio_cell = table.fixed_cell(ratio.value, 2, notes=ratio_notes(ratio)[1:])
            cells_by_joint[j] += [reference_cell, ratio_cell]
    rows = [
        table.make_row(joint, *cells)
        for joint, cells in zip(results.joints, cells_by_joint, strict=True)
    ]
    return table.ResultTable(caption=caption, head=head, rows=rows)


class _Reference(NamedTuple):
    """Laws that those of a run are compared with.

    Attributes
    ----------
    laws : reference of each joint.
    ratios : ratio of each joint's error to that of its reference.
    role : what the references are.
    """

    laws: Sequence[str]
    ratios: Sequence[ErrorRatio]
    role: str

    def describe(self) -> str:
        """Return references, their role, and the scope of the intervals, for a caption."""
        names = table.join_law_titles(self.laws)
        text = f"{self.role} ({names})"
        if len(set(self.laws)) == 1:
            text = f"{names}, {self.role}"
        return f"{text}; small: 95\u00a0% interval on {describe_scope(self.ratios)}"


def _choose_reference(comparison: Comparison, laws: Sequence[str]) -> _Reference | None:
    """Return the references of the laws; if they are references themselves, their best rival."""
    law_ratios = comparison.ratios
    if not any(law_name in law_ratios.laws for law_name in laws):
        return _find_rival(comparison, laws)
    references = []
    ratios = []
    for j, law_name in enumerate(laws):
        if law_name in law_ratios.laws:
            references.append(law_ratios.find_reference(law_name, j))
            ratios.append(law_ratios.laws[law_name][j])
        else:
            references.append(law_name)
            ratios.append(ErrorRatio(value=1.0, low=1.0, high=1.0, p=1.0))
    return _Reference(references, ratios, "the strongest reference")


def _find_rival(comparison: Comparison, laws: Sequence[str]) -> _Reference | None:
    """Return the best law whose references are these laws; None if there is none."""
    law_ratios = comparison.ratios
    rivals = []
    for other in law_ratios.laws:
        references = [law_ratios.find_reference(other, j) for j in range(len(laws))]
        if is_usable(other) and references == list(laws):
            rivals.append(other)
    if not rivals:
        return None
    rival = min(rivals, key=lambda other: fmean(ratio.value for ratio in law_ratios.laws[other]))
    ratios = [_invert_ratio(ratio) for ratio in law_ratios.laws[rival]]
    role = f"the best law with {table.join_law_titles(laws)} as its reference"
    return _Reference([rival] * len(ratios), ratios, role)


def _invert_ratio(ratio: ErrorRatio) -> ErrorRatio:
    """Return the ratio of the second error to the first; the ends of the interval swap."""
    return ErrorRatio(
        value=1.0 / ratio.value,
        low=ratio.high and 1.0 / ratio.high,
        high=ratio.low and 1.0 / ratio.low,
        p=ratio.p,
        adjusted_p=ratio.adjusted_p,
        on_other_logs=ratio.on_other_logs,
    )


def _plot(results: Results, laws: Sequence[str]) -> dict[str, Any] | None:
    """Draw measured and predicted friction of the joint with the largest unexplained share."""
    test = results.tests[0]
    log = results.find_log(test)
    comparison = results.comparisons[test]
    if log is None:
        return None
    worst = int(np.argmax(comparison.unexplained_shares(comparison.combine_scores(laws).rmse)))
    k, short, name = results.numbered[worst]
    law_name = laws[worst]
    torques = results.torques(log)
    t = torques["t"]
    measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
    predicted = torques[f"{law_name}.tau_f{k}"]
    lines = (
        *(replace(line, name="95 % band") for line in band(results, law_name, k, torques)),
        Line(name="measured", x=t, y=measured, stroke=MEASURED),
        Line(name="predicted", x=t, y=predicted, stroke=Stroke(colour=SERIES[0])),
    )
    panel = Panel(
        title=f"{short}: {name}, {table.title(law_name)}",
        y=f"friction [{results.unit('N.m', k - 1)}]",
        lines=lines,
    )
    chart = Chart(x="t [s]", rows=((panel,),), height=_HEIGHT, window=(0.0, WINDOW))
    return {
        "figure": draw_chart(chart, _WIDTH),
        "joint": name,
        "short": short,
        "law": table.title(law_name),
        "log": log.name,
    }


def _floor(results: Results) -> dict[str, str] | None:
    """Return the error of the true friction, and how much above it the best law is."""
    scores = results.comparisons[results.tests[0]].laws
    best = results.best
    if ORACLE not in scores:
        return None
    floor = scores[ORACLE].rmse
    excess_percent = 100.0 * float(np.mean(np.divide(scores[best].rmse, floor)) - 1.0)
    listed_errors = floor
    separator = " / "
    if len(floor) > _MAX_LISTED_JOINTS:
        listed_errors = (min(floor), max(floor))
        separator = " – "
    places = table.decimals([max(floor)])
    error_texts = [f"{error:.{places}f}" for error in listed_errors]
    return {
        "error": separator.join(error_texts),
        "best": table.title(best),
        "above": f"{excess_percent:.0f}",
    }
