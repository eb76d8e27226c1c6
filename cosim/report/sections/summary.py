"""First layer: recommended FMU, warnings, errors by joint, one plot, and limits."""

from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean
from typing import Any

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel, draw_chart
from cosim.report.figures.style import MEASURED, SERIES, Stroke
from cosim.report.results import Results
from cosim.report.sections.prediction import WINDOW, band
from cosim.report.tables import table
from cosim.report.tables.laws import find_most_passing
from cosim.report.tables.scores import find_leader, ratio_notes, recommendation
from cosim.study.results import read_findings
from cosim.study.scores import MEASURED_START, ORACLE, Comparison
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
    properties = results.properties
    paper = properties.get(papers_law())
    most_passing = find_most_passing(properties) if properties else None
    return {
        "run": results.run,
        "verdict": results.verdict,
        "law": table.join_law_titles(laws),
        "fmu": results.fmu if (results.folder / results.fmu).is_file() else "",
        "findings": len(findings),
        "first": [
            replace(finding, remedy="").sentence for finding in findings[:_MAX_LISTED_FINDINGS]
        ],
        "errors": errors(results, laws),
        "recommendation": _recommend(results),
        "choice": list(describe_choice(results.verdict.choice))
        if results.verdict and results.verdict.choice
        else [],
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
        "passed": paper and paper.passed,
        "most": most_passing and (", ".join(map(table.title, most_passing[0])), most_passing[1]),
        "checks": len(EXPECTATIONS),
    }


def _recommend(results: Results) -> table.ResultTable | None:
    """Return the table of the recommended laws; None for results of earlier versions."""
    verdict = results.verdict
    if verdict is None or verdict.choice is None:
        return None
    return recommendation(
        verdict.choice, combine_results(verdict.law, results.properties, verdict.laws)
    )


def errors(results: Results, laws: Sequence[str]) -> table.ResultTable:
    """Return error, unexplained share, and ratio to the strongest reference of a law per joint."""
    test = results.tests[0]
    comparison = results.comparisons[test]
    rmse = comparison.combine_scores(laws).rmse
    places = table.decimals(rmse)
    head = ["joint", "RMSE", "unexplained"]
    columns = [
        [table.fixed_cell(error, places) for error in rmse],
        [
            table.TableCell(text=f"{100 * s:.0f} %", value=100 * s)
            for s in comparison.unexplained_shares(rmse)
        ],
    ]
    caption = f"Error of {table.join_law_titles(laws)} on ‘{test}’ [{results.unit('N.m')}]"
    reference = _reference(comparison, laws)
    if reference:
        references, ratios, role = reference
        head += ["reference", "ratio"]
        names = table.join_law_titles(references)
        reference_text = f"{names}, {role}" if len(set(references)) == 1 else f"{role} ({names})"
        is_for_others = any(ratio.on_other_logs for ratio in ratios)
        scope = "other logs of the kind" if is_for_others else "this log"
        caption += f" and of {reference_text}; small: 95\u00a0% interval on {scope}"
        columns += [
            [
                table.fixed_cell(error, places)
                for error in comparison.combine_scores(references).rmse
            ],
            [table.fixed_cell(ratio.value, 2, notes=ratio_notes(ratio)[1:]) for ratio in ratios],
        ]
    rows = [table.make_row(*cells) for cells in zip(results.joints, *columns, strict=True)]
    return table.ResultTable(caption=caption, head=head, rows=rows)


def _reference(
    comparison: Comparison, laws: Sequence[str]
) -> tuple[Sequence[str], Sequence[ErrorRatio], str] | None:
    law_ratios = comparison.ratios
    joints = list(enumerate(laws))
    if any(law_name in law_ratios.laws for law_name in laws):
        itself = ErrorRatio(value=1.0, low=1.0, high=1.0, p=1.0)
        has_ratio = [law_name in law_ratios.laws for law_name in laws]
        references = [
            law_ratios.find_reference(law_name, k) if has_ratio[k] else law_name
            for k, law_name in joints
        ]
        ratios = [
            law_ratios.laws[law_name][k] if has_ratio[k] else itself for k, law_name in joints
        ]
        return references, ratios, "the strongest reference"
    rivals = [
        other
        for other in law_ratios.laws
        if all(law_ratios.find_reference(other, k) == law_name for k, law_name in joints)
        and other != ORACLE
        and not other.endswith(MEASURED_START)
    ]
    if not rivals:
        return None
    rival = min(rivals, key=lambda other: fmean(ratio.value for ratio in law_ratios.laws[other]))
    inverse = [
        ErrorRatio(
            value=1.0 / ratio.value,
            low=ratio.high and 1.0 / ratio.high,
            high=ratio.low and 1.0 / ratio.low,
            p=ratio.p,
            adjusted_p=ratio.adjusted_p,
            on_other_logs=ratio.on_other_logs,
        )
        for ratio in law_ratios.laws[rival]
    ]
    role = f"the best law with {table.join_law_titles(laws)} as its reference"
    return [rival] * len(inverse), inverse, role


def _plot(results: Results, laws: Sequence[str]) -> dict[str, Any] | None:
    test = results.tests[0]
    log = results.find_log(test)
    comparison = results.comparisons[test]
    if log is None:
        return None
    worst = int(np.argmax(comparison.unexplained_shares(comparison.combine_scores(laws).rmse)))
    (k, short, name), law_name = results.numbered[worst], laws[worst]
    torques = results.torques(log)
    t = torques["t"]
    predicted = torques[f"{law_name}.tau_f{k}"]
    lines = (
        *(replace(line, name="95 % band") for line in band(results, law_name, k, torques)),
        Line(name="measured", x=t, y=torques[f"tau{k}"] - torques[f"tau_rb{k}"], stroke=MEASURED),
        Line(name="predicted", x=t, y=predicted, stroke=Stroke(colour=SERIES[0])),
    )
    unit = results.unit("N.m", k - 1)
    panel = Panel(
        title=f"{short}: {name}, {table.title(law_name)}", y=f"friction [{unit}]", lines=lines
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
    scores = results.comparisons[results.tests[0]].laws
    best = results.best
    if ORACLE not in scores:
        return None
    floor = scores[ORACLE].rmse
    excess_percent = 100.0 * float(np.mean(np.divide(scores[best].rmse, floor)) - 1.0)
    places = table.decimals([max(floor)])
    lists_all = len(floor) <= _MAX_LISTED_JOINTS
    error_texts = [
        f"{value:.{places}f}" for value in (floor if lists_all else (min(floor), max(floor)))
    ]
    error_range = (" / " if lists_all else " – ").join(error_texts)
    return {"error": error_range, "best": table.title(best), "above": f"{excess_percent:.0f}"}
