"""Summary of a report: verdict, key figures, and limits of the results."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.report.figures.plots import ratios
from cosim.report.markup import Pictures
from cosim.report.results import Results
from cosim.report.sections.loop import of_scheme, outer
from cosim.report.sections.physics import passive
from cosim.report.tables.scores import leading
from cosim.report.tables.table import decimals, title
from cosim.study.results import HEALTH, read_findings
from cosim.study.scores import BASELINE, ORACLE
from cosim.study.verdict import VERDICT, read_verdict
from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.friction.registry import papers_law
from hesr_model.support.arrays import Array

_FEW = 3
"""Maximum number of joints whose figures are shown next to each other."""


@dataclass(frozen=True, kw_only=True)
class Tile:
    """A key figure with its unit and a sentence."""

    figure: str
    unit: str
    text: str


def summary(results: Results, pictures: Pictures) -> dict[str, Any]:
    """Return the values of the summary."""
    files = [
        *(f"fmus/{law}.fmu" for law in results.models),
        *("evaluation.json", "rigid_body.json", VERDICT, HEALTH),
    ]
    tiles = (_error(results), _paper(results), _tracking(results), _physics(results))
    return {
        "run": results.run,
        "verdict": read_verdict(results.folder),
        "files": [file for file in files if (results.folder / file).is_file()],
        "findings": len(read_findings(results.folder)),
        "laws": len(results.models),
        "tests": len(results.tests),
        "has_loop": results.loop is not None,
        "tiles": [tile for tile in tiles if tile],
        "figure": _ratios(results, pictures),
        "remarks": _remarks(results),
    }


def _listed(values: Sequence[float] | Array, digits: int = 3) -> str:
    """Return the figures of few joints, or the range over many."""
    places = decimals([max(values)], digits)
    few = len(values) <= _FEW
    shown = values if few else (min(values), max(values))
    return (" / " if few else " – ").join(f"{v:.{places}f}" for v in shown)


def _error(results: Results) -> Tile:
    scores, short = results.comparisons[results.tests[0]].laws, results.joints
    text = f"error of {title(results.best)}, the best law on ‘{results.tests[0]}’"
    if BASELINE in scores and results.best != BASELINE:
        text += f"; {title(BASELINE)} {_listed(scores[BASELINE].rmse)}"
    if ORACLE in scores:
        text += f"; the true friction {_listed(scores[ORACLE].rmse)}"
    over = "/".join(short) if len(short) <= _FEW else f"{short[0]} to {short[-1]}"
    figure = _listed(scores[results.best].rmse)
    return Tile(figure=figure, unit=results.unit("N.m"), text=f"{text} ({over})")


def _paper(results: Results) -> Tile | None:
    law, scores = papers_law(), results.comparisons[results.tests[0]].ratios
    if law not in scores.laws:
        return None
    found, reference = scores.laws[law], title(scores.of(law))
    groups = {
        verdict: [j for j, r in zip(results.joints, found, strict=True) if r.verdict == verdict]
        for verdict in ("better", "worse", "alike")
    }
    said = ", ".join(f"{word} on {', '.join(of)}" for word, of in groups.items() if of)
    return Tile(
        figure=_listed([r.value for r in found]),
        unit=f"× {reference}",
        text=f"error of the paper’s {title(law)} over that of {reference}, fitted with the same "
        f"care: {said}",
    )


def _tracking(results: Results) -> Tile | None:
    if results.loop is None:
        return None
    rows = of_scheme(results, outer(results, Scheme(compensation="servo_inversion")))
    law = results.best if results.best in rows else next(iter(rows))
    body = rows.get(StandIn.BODY_ONLY)
    only = f"; with the rigid body alone {_listed(1e3 * body.mean, 2)}" if body else ""
    return Tile(
        figure=_listed(1e3 * rows[law].mean, 2),
        unit="mrad",
        text=f"tracking error with {title(law)} through the servo’s inverse{only}",
    )


def _physics(results: Results) -> Tile | None:
    found, law = results.audits, papers_law()
    if not found:
        return None
    good = [name for name, of_law in found.items() if all(map(passive, of_law.audits))]
    text = "laws give no energy on the tested closed cycles"
    if law in found and law not in good:
        text += f"; the paper’s {title(law)} does"
    return Tile(figure=f"{len(good)} of {len(found)}", unit="", text=text)


def _ratios(results: Results, pictures: Pictures) -> Markup:
    test = results.tests[0]
    scores = results.comparisons[test].ratios
    if not scores.laws:
        return Markup()
    laws = {title(law): row for law, row in scores.laws.items()}
    reference = "its reference" if scores.references else title(scores.reference)
    return pictures.figure(
        "ratios",
        ratios(laws, results.joints, x=f"RMSE / RMSE of {reference}"),
        f"Error of every law over that of {reference} on ‘{test}’, with 95 % intervals (bootstrap "
        "of blocks of time). Left of the line is better. The reference of a law is the strongest "
        "classic law of the same inputs or fewer; the claim is about these logs.",
        alt=f"For each law and joint, a dot at its error relative to {reference} and its interval.",
    )


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
