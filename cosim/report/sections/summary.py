"""First layer: recommended FMU, warnings, errors by joint, one plot, and limits."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel, drawn
from cosim.report.figures.style import MEASURED, SERIES, Stroke
from cosim.report.results import Results
from cosim.report.sections.prediction import WINDOW, band
from cosim.report.tables.scores import leading, ratio_notes
from cosim.report.tables.table import ResultTable, TableCell, decimals, fixed, row_of, title
from cosim.study.results import read_findings
from cosim.study.scores import MEASURED_START, ORACLE, Comparison, Ratio
from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.friction.registry import papers_law

_FEW = 3  # maximum number of joints whose figures are listed
_FINDINGS = 2  # number of findings in the first layer
_WIDTH, _HEIGHT = 4.4, 1.9  # size of the plot [in], readable on a phone


def summary(results: Results) -> dict[str, Any]:
    """Return the values of the first layer."""
    law = results.recommended
    fmu = f"fmus/{law}.fmu"
    findings = read_findings(results.folder)
    passed = {name: of_law.passed for name, of_law in results.properties.items()}
    most = max(passed, key=lambda name: passed[name], default=None)
    return {
        "run": results.run,
        "verdict": results.verdict,
        "law": title(law),
        "fmu": fmu if (results.folder / fmu).is_file() else "",
        "findings": len(findings),
        "first": [replace(finding, remedy="").sentence for finding in findings[:_FINDINGS]],
        "errors": errors(results, law),
        "plot": _plot(results, law),
        "laws": len(results.models),
        "tests": len(results.tests),
        "has_loop": results.loop is not None,
        "floor": _floor(results),
        "winners": [(title(leading(of)), plant) for plant, of in results.truths.items()],
        "passed": passed.get(papers_law()),
        "most": most and (title(most), passed[most]),
        "checks": len(EXPECTATIONS),
    }


def errors(results: Results, law: str) -> ResultTable:
    """Return error, unexplained share, and ratio to the strongest reference by joint."""
    test = results.tests[0]
    scores = results.comparisons[test]
    own = scores.laws[law].rmse
    places = decimals(own)
    head = ["joint", "RMSE", "unexplained"]
    columns = [
        [fixed(error, places) for error in own],
        [
            TableCell(text=f"{share:.0f} %", value=float(share))
            for share in 100.0 * np.divide(own, np.maximum(scores.tau_std, 1e-300))
        ],
    ]
    caption = f"Error of {title(law)} on ‘{test}’ [{results.unit('N.m')}]"
    if found := _reference(scores, law):
        references, ratios, role = found
        head += ["reference", "ratio"]
        where: dict[str, list[str]] = {}
        for short, reference in zip(results.joints, references, strict=True):
            where.setdefault(title(reference), []).append(short)
        names = "; ".join(f"{name} on {', '.join(of)}" for name, of in where.items())
        said = f"{next(iter(where))}, {role}" if len(where) == 1 else f"{role} ({names})"
        caption += f" and of {said}; small: 95\u00a0% interval"
        columns += [
            [fixed(scores.laws[r].rmse[k], places) for k, r in enumerate(references)],
            [fixed(ratio.value, 2, notes=ratio_notes(ratio)[1:]) for ratio in ratios],
        ]
    rows = [row_of(*cells) for cells in zip(results.joints, *columns, strict=True)]
    return ResultTable(caption=caption, head=head, rows=rows)


def _reference(scores: Comparison, law: str) -> tuple[list[str], Sequence[Ratio], str] | None:
    """Return the law to compare with on each joint, the ratios to it and its role."""
    found, joints = scores.ratios, range(len(scores.joints))
    if law in found.laws:
        return [found.of(law, k) for k in joints], found.laws[law], "the strongest reference"
    rivals = {
        other: float(np.mean([ratio.value for ratio in ratios]))
        for other, ratios in found.laws.items()
        if all(found.of(other, k) == law for k in joints)
        and other != ORACLE
        and not other.endswith(MEASURED_START)
    }
    if not rivals:
        return None
    rival = min(rivals, key=lambda other: rivals[other])
    inverse = [
        Ratio(
            value=1.0 / ratio.value,
            low=ratio.high and 1.0 / ratio.high,
            high=ratio.low and 1.0 / ratio.low,
            p=ratio.p,
        )
        for ratio in found.laws[rival]
    ]
    return [rival] * len(inverse), inverse, f"the best law with {title(law)} as its reference"


def _plot(results: Results, law: str) -> dict[str, Any] | None:
    test = results.tests[0]
    log, scores = results.log_of(test), results.comparisons[test]
    if log is None:
        return None
    worst = int(np.argmax(np.divide(scores.laws[law].rmse, scores.tau_std)))
    k, short, name = results.numbered[worst]
    torques = results.torques(log)
    t, predicted = torques["t"], torques[f"{law}.tau_f{k}"]
    measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
    lines = (
        *(replace(line, name="95 % band") for line in band(results, law, k, torques)),
        Line(name="measured", x=t, y=measured, stroke=MEASURED),
        Line(name="predicted", x=t, y=predicted, stroke=Stroke(colour=SERIES[0])),
    )
    unit = results.unit("N.m", k - 1)
    panel = Panel(title=f"{short}: {name}, {title(law)}", y=f"friction [{unit}]", lines=lines)
    chart = Chart(x="t [s]", rows=((panel,),), height=_HEIGHT, window=(0.0, WINDOW))
    return {"figure": drawn(chart, _WIDTH), "joint": name, "short": short, "log": log.name}


def _floor(results: Results) -> dict[str, str] | None:
    scores, best = results.comparisons[results.tests[0]].laws, results.best
    if ORACLE not in scores:
        return None
    floor = scores[ORACLE].rmse
    above = 100.0 * float(np.mean(np.divide(scores[best].rmse, floor)) - 1.0)
    places, few = decimals([max(floor)]), len(floor) <= _FEW
    shown = [f"{value:.{places}f}" for value in (floor if few else (min(floor), max(floor)))]
    listed = (" / " if few else " – ").join(shown)
    return {"error": listed, "best": title(best), "above": f"{above:.0f}"}
