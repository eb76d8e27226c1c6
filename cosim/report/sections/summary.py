"""First layer: recommended FMU, warnings, errors by joint, one plot, and limits."""

from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean
from typing import Any

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel, drawn
from cosim.report.figures.style import MEASURED, SERIES, Stroke
from cosim.report.results import Results
from cosim.report.sections.prediction import WINDOW, band
from cosim.report.tables import table
from cosim.report.tables.laws import find_most_passing
from cosim.report.tables.scores import leading, ratio_notes
from cosim.study.results import read_findings
from cosim.study.scores import MEASURED_START, ORACLE, Comparison
from hesr_model.audit.properties import EXPECTATIONS
from hesr_model.fitting.estimator import papers_law
from hesr_model.inference.comparison import ErrorRatio

_FEW = 3  # maximum number of joints whose figures are listed
_FINDINGS = 2  # number of findings in the first layer
_WIDTH = 4.4
_HEIGHT = 1.9  # size of the plot [in], readable on a phone


def summary(results: Results) -> dict[str, Any]:
    """Return the values of the first layer."""
    laws = results.recommended
    findings = read_findings(results.folder)
    found = results.properties
    paper = found.get(papers_law())
    most = find_most_passing(found) if found else None
    return {
        "run": results.run,
        "verdict": results.verdict,
        "law": table.on_joints(laws),
        "fmu": results.fmu if (results.folder / results.fmu).is_file() else "",
        "findings": len(findings),
        "first": [replace(finding, remedy="").sentence for finding in findings[:_FINDINGS]],
        "errors": errors(results, laws),
        "plot": _plot(results, laws),
        "laws": len(results.models),
        "tests": len(results.tests),
        "has_loop": results.loop is not None,
        "floor": _floor(results),
        "winners": [(table.title(leading(of)), plant) for plant, of in results.truths.items()],
        "passed": paper and paper.passed,
        "most": most and (", ".join(map(table.title, most[0])), most[1]),
        "checks": len(EXPECTATIONS),
    }


def errors(results: Results, laws: Sequence[str]) -> table.ResultTable:
    """Return error, unexplained share, and ratio to the strongest reference of a law per joint."""
    test = results.tests[0]
    comparison = results.comparisons[test]
    own = comparison.of(laws).rmse
    places = table.decimals(own)
    head = ["joint", "RMSE", "unexplained"]
    columns = [
        [table.fixed(error, places) for error in own],
        [
            table.TableCell(text=f"{100 * s:.0f} %", value=100 * s)
            for s in comparison.unexplained(own)
        ],
    ]
    caption = f"Error of {table.on_joints(laws)} on ‘{test}’ [{results.unit('N.m')}]"
    found = _reference(comparison, laws)
    if found:
        references, ratios, role = found
        head += ["reference", "ratio"]
        names = table.on_joints(references)
        said = f"{names}, {role}" if len(set(references)) == 1 else f"{role} ({names})"
        caption += f" and of {said}; small: 95\u00a0% interval"
        columns += [
            [table.fixed(error, places) for error in comparison.of(references).rmse],
            [table.fixed(ratio.value, 2, notes=ratio_notes(ratio)[1:]) for ratio in ratios],
        ]
    rows = [table.row_of(*cells) for cells in zip(results.joints, *columns, strict=True)]
    return table.ResultTable(caption=caption, head=head, rows=rows)


def _reference(
    comparison: Comparison, laws: Sequence[str]
) -> tuple[Sequence[str], Sequence[ErrorRatio], str] | None:
    found = comparison.ratios
    joints = list(enumerate(laws))
    if any(law in found.laws for law in laws):
        itself = ErrorRatio(value=1.0, low=1.0, high=1.0, p=1.0)
        known = [law in found.laws for law in laws]
        references = [found.of(law, k) if known[k] else law for k, law in joints]
        ratios = [found.laws[law][k] if known[k] else itself for k, law in joints]
        return references, ratios, "the strongest reference"
    rivals = [
        other
        for other in found.laws
        if all(found.of(other, k) == law for k, law in joints)
        and other != ORACLE
        and not other.endswith(MEASURED_START)
    ]
    if not rivals:
        return None
    rival = min(rivals, key=lambda other: fmean(ratio.value for ratio in found.laws[other]))
    inverse = [
        ErrorRatio(
            value=1.0 / ratio.value,
            low=ratio.high and 1.0 / ratio.high,
            high=ratio.low and 1.0 / ratio.low,
            p=ratio.p,
        )
        for ratio in found.laws[rival]
    ]
    role = f"the best law with {table.on_joints(laws)} as its reference"
    return [rival] * len(inverse), inverse, role


def _plot(results: Results, laws: Sequence[str]) -> dict[str, Any] | None:
    test = results.tests[0]
    log = results.log_of(test)
    comparison = results.comparisons[test]
    if log is None:
        return None
    worst = int(np.argmax(comparison.unexplained(comparison.of(laws).rmse)))
    (k, short, name), law = results.numbered[worst], laws[worst]
    torques = results.torques(log)
    t = torques["t"]
    predicted = torques[f"{law}.tau_f{k}"]
    lines = (
        *(replace(line, name="95 % band") for line in band(results, law, k, torques)),
        Line(name="measured", x=t, y=torques[f"tau{k}"] - torques[f"tau_rb{k}"], stroke=MEASURED),
        Line(name="predicted", x=t, y=predicted, stroke=Stroke(colour=SERIES[0])),
    )
    unit = results.unit("N.m", k - 1)
    panel = Panel(title=f"{short}: {name}, {table.title(law)}", y=f"friction [{unit}]", lines=lines)
    chart = Chart(x="t [s]", rows=((panel,),), height=_HEIGHT, window=(0.0, WINDOW))
    return {
        "figure": drawn(chart, _WIDTH),
        "joint": name,
        "short": short,
        "law": table.title(law),
        "log": log.name,
    }


def _floor(results: Results) -> dict[str, str] | None:
    scores = results.comparisons[results.tests[0]].laws
    best = results.best
    if ORACLE not in scores:
        return None
    floor = scores[ORACLE].rmse
    above = 100.0 * float(np.mean(np.divide(scores[best].rmse, floor)) - 1.0)
    places = table.decimals([max(floor)])
    few = len(floor) <= _FEW
    shown = [f"{value:.{places}f}" for value in (floor if few else (min(floor), max(floor)))]
    listed = (" / " if few else " – ").join(shown)
    return {"error": listed, "best": table.title(best), "above": f"{above:.0f}"}
