"""First layer of a report: recommended FMU, warnings, errors by joint, one plot, and limits."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.report.figures.chart import Chart, Line, Panel, drawn
from cosim.report.figures.style import MEASURED, SERIES, Stroke
from cosim.report.markup import Pictures
from cosim.report.results import Results
from cosim.report.sections.prediction import WINDOW, band
from cosim.report.tables.scores import leading
from cosim.report.tables.table import ResultTable, TableCell, decimals, fixed, row_of, title
from cosim.study.results import read_findings
from cosim.study.scores import MEASURED_START, ORACLE, Comparison, Ratio
from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.friction.registry import papers_law

_FEW = 3
"""Maximum number of joints whose figures are shown next to each other."""
_FINDINGS = 2
"""Number of findings in the first layer; the data checks list all."""
_WIDTH, _HEIGHT = 4.4, 1.9
"""Size of the plot [in], small enough for letters that can be read on a phone."""


def summary(results: Results, pictures: Pictures) -> dict[str, Any]:
    """Return the values of the first layer."""
    law = results.recommended
    fmu = f"fmus/{law}.fmu"
    findings = read_findings(results.folder)
    return {
        "run": results.run,
        "verdict": results.verdict,
        "law": title(law),
        "fmu": fmu if (results.folder / fmu).is_file() else "",
        "findings": len(findings),
        "first": [replace(finding, remedy="").sentence for finding in findings[:_FINDINGS]],
        "errors": errors(results, law),
        "plot": _plot(results, pictures, law),
        "laws": len(results.models),
        "tests": len(results.tests),
        "has_loop": results.loop is not None,
        "remarks": _remarks(results),
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
        reference, ratios, role = found
        head += ["reference", "ratio"]
        caption += f" and of {title(reference)}, {role}; small: 95\u00a0% interval"
        columns += [
            [fixed(error, places) for error in scores.laws[reference].rmse],
            [fixed(ratio.value, 2, notes=_interval(ratio)) for ratio in ratios],
        ]
    rows = [row_of(*cells) for cells in zip(results.joints, *columns, strict=True)]
    return ResultTable(caption=caption, head=head, rows=rows)


def _reference(scores: Comparison, law: str) -> tuple[str, Sequence[Ratio], str] | None:
    """Return the law to compare with, the ratios to it and its role."""
    found = scores.ratios
    if law in found.laws:
        return found.of(law), found.laws[law], "the strongest reference"
    rivals = {
        other: float(np.mean([ratio.value for ratio in ratios]))
        for other, ratios in found.laws.items()
        if found.of(other) == law and other != ORACLE and not other.endswith(MEASURED_START)
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
    return rival, inverse, f"the best law with {title(law)} as its reference"


def _interval(ratio: Ratio) -> tuple[str, ...]:
    return () if ratio.low is None else (f"{ratio.low:.2f}–{ratio.high:.2f}",)


def _plot(results: Results, pictures: Pictures, law: str) -> Markup:
    """Draw friction of the joint with the largest unexplained share."""
    test = results.tests[0]
    log, scores = results.log_of(test), results.comparisons[test]
    if log is None:
        return Markup()
    k, short, name = results.numbered[
        int(np.argmax(np.divide(scores.laws[law].rmse, scores.tau_std)))
    ]
    torques = results.torques(log)
    t = torques["t"]
    measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
    panel = Panel(
        title=f"{short}: {name}, {title(law)}",
        y=f"friction [{results.unit('N.m', k - 1)}]",
        lines=(
            *(replace(line, name="95 % band") for line in band(results, law, k, torques)),
            Line(name="measured", x=t, y=measured, stroke=MEASURED),
            Line(
                name="predicted",
                x=t,
                y=torques[f"{law}.tau_f{k}"],
                stroke=Stroke(colour=SERIES[0]),
            ),
        ),
    )
    chart = Chart(x="t [s]", rows=((panel,),), height=_HEIGHT, window=(0.0, WINDOW))
    return pictures.figure(
        "prediction",
        drawn(chart, _WIDTH),
        f"Friction of {short}, the joint with the largest unexplained share, on {log.name}: "
        "measured, and predicted by the FMU.",
        alt=f"Friction torque of {name} over time, measured and predicted by {title(law)}.",
        small=True,
    )


def _listed(values: Sequence[float], digits: int = 3) -> str:
    """Return the figures of few joints, or the range over many."""
    places = decimals([max(values)], digits)
    few = len(values) <= _FEW
    shown = values if few else (min(values), max(values))
    return (" / " if few else " – ").join(f"{v:.{places}f}" for v in shown)


def _remarks(results: Results) -> list[str]:
    """Return the limits of the results, one sentence or two each."""
    found = []
    law, best, scores = papers_law(), results.best, results.comparisons[results.tests[0]].laws
    if results.run.twin:
        found.append(f"The robot is simulated. {_truth(results)}")
    if ORACLE in scores:
        floor = scores[ORACLE].rmse
        above = 100.0 * float(np.mean(np.divide(scores[best].rmse, floor)) - 1.0)
        found.append(
            f"Noise and the error of the rigid body alone cause {_listed(floor)} "
            f"{results.unit('N.m')}; {title(best)} is {above:.0f}\u00a0% above that on average."
        )
    if law in results.properties:
        counts = {name: of_law.passed for name, of_law in results.properties.items()}
        most = max(counts, key=lambda name: counts[name])
        found.append(
            f"The paper’s law passes {counts[law]} of {len(EXPECTATIONS)} physics checks on all "
            f"joints; {title(most)} passes most, {counts[most]}. A small RMSE does not imply "
            "physical friction."
        )
    if results.loop:
        found.append(
            "The paper’s own control scheme hardly separates good laws: with an integrating servo "
            "a perfect law gives no correction. Laws pay off as feed-forward through the servo’s "
            "inverse."
        )
    return found


def _truth(results: Results) -> str:
    """Return the kind of the twin's friction, and the best laws on alternative plants."""
    rank = "measured robots may rank the laws otherwise."
    if results.run.truth:
        return f"Its friction is ‘{results.run.truth}’ of its plant; {rank}"
    text = (
        f"Its friction has the form of no law, but is bristle-like, which favours such laws; {rank}"
    )
    winners = [f"{title(leading(errors))} on ‘{truth}’" for truth, errors in results.truths.items()]
    return f"{text} Lowest error on other plants: {', '.join(winners)}." if winners else text
