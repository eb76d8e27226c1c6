"""The summary: what was done, the figures that matter, and what they do not say."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.report.figures.plots import ratios
from cosim.report.markup import Pictures, joined, listing, paragraph, render
from cosim.report.results import Results
from cosim.report.sections.audit import passive
from cosim.report.sections.tracking import of_scheme, outer
from cosim.report.tables.scores import leading
from cosim.report.tables.table import decimals, title
from cosim.study.results import read_findings
from cosim.study.scores import BASELINE, ORACLE
from cosim.study.verdict import VERDICT, read_verdict
from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.friction.registry import papers_law
from hesr_model.support.arrays import Array

_FEW = 3  # joints whose figures stand side by side


@dataclass(frozen=True, kw_only=True)
class Tile:
    """A figure that matters: the figure, its unit, and a sentence on it."""

    figure: str
    unit: str
    text: str


def summary(results: Results, pictures: Pictures) -> Markup:
    """Return the head of the page."""
    tiles = [
        t for t in (_error(results), _paper(results), _tracking(results), _physics(results)) if t
    ]
    return joined(
        _words(results),
        _warnings(results),
        paragraph(_done(results)),
        *(
            paragraph(f"The law {law} was left out: {why}")
            for law, why in results.run.left_out.items()
        ),
        render("tiles.html.j2", tiles=tiles),
        _picture(results, pictures),
        listing(_honest(results)),
    )


def _warnings(results: Results) -> Markup:
    """Say how much the checks found; what, stands with the data."""
    count = len(read_findings(results.folder))
    if not count:
        return Markup()
    return Markup(
        '<p><strong class="fail">{}</strong> of data and fits: see <a href="#data">robot, data and '
        "their health</a>.</p>"
    ).format(_count(count, "warning"))


def _words(results: Results) -> Markup:
    """Say which FMU to take, and link the files that stand beside the page."""
    found = read_verdict(results.folder)
    files = [
        *(f"fmus/{law}.fmu" for law in results.models),
        *("evaluation.json", "rigid_body.json", VERDICT, "health.json"),
    ]
    there = [file for file in files if (results.folder / file).is_file()]
    links = Markup(", ").join(Markup('<a href="{0}">{0}</a>').format(file) for file in there)
    listed = Markup("<p>Files beside this page: {}.</p>").format(links) if there else Markup()
    if found is None:
        return listed
    said = Markup("").join(Markup("<p>{}</p>").format(s) for s in found.sentences)
    return Markup('<div class="verdict">{}{}</div>').format(said, listed)


def _done(results: Results) -> str:
    run = results.run
    loop = ", and put into a closed loop of FMUs" if results.loop else ""
    quick = " A quick run: few laws, no property battery and no closed loop." if run.quick else ""
    return (
        f"From the logs of {run.robot} a rigid body was identified; {len(results.models)} friction "
        f"laws were fitted to what is left of the torque, exported as FMUs, tried on "
        f"{_count(len(results.tests), 'test set')} that no fit has seen{loop}.{quick}"
    )


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' if n != 1 else ''}"


def _listed(values: Sequence[float] | Array, digits: int = 3) -> str:
    """Return the figures of few joints, or the range over many, as exact as the largest needs."""
    places = decimals([max(values)], digits)
    shown = values if len(values) <= _FEW else (min(values), max(values))
    return (" / " if len(values) <= _FEW else " – ").join(f"{v:.{places}f}" for v in shown)


def _over(results: Results) -> str:
    short = results.joints
    return "/".join(short) if len(short) <= _FEW else f"{short[0]} to {short[-1]}"


def _error(results: Results) -> Tile:
    scores = results.comparisons[results.tests[0]].laws
    best = scores[results.best].rmse
    text = f"error of {title(results.best)}, the best law on ‘{results.tests[0]}’"
    if BASELINE in scores and results.best != BASELINE:
        text += f"; {title(BASELINE)} {_listed(scores[BASELINE].rmse)}"
    if ORACLE in scores:
        text += f"; the true friction {_listed(scores[ORACLE].rmse)}"
    return Tile(figure=_listed(best), unit=results.unit("N.m"), text=f"{text} ({_over(results)})")


def _paper(results: Results) -> Tile | None:
    scores = results.comparisons[results.tests[0]].ratios
    if papers_law() not in scores.laws:
        return None
    found = scores.laws[papers_law()]
    return Tile(
        figure=_listed([r.value for r in found]),
        unit=f"× {title(scores.of(papers_law()))}",
        text=f"error of the paper’s {title(papers_law())} relative to a "
        f"{title(scores.of(papers_law()))} that is fitted with the same care: {_verdict(results)}",
    )


def _verdict(results: Results) -> str:
    """Say on how many joints the paper's law is better or worse, beyond chance."""
    found = results.comparisons[results.tests[0]].ratios.laws[papers_law()]
    better, worse, alike = (
        [j for j, r in zip(results.joints, found, strict=True) if r.verdict == verdict]
        for verdict in ("better", "worse", "alike")
    )
    groups = {"better": better, "worse": worse, "alike": alike}
    return ", ".join(f"{word} on {', '.join(of)}" for word, of in groups.items() if of)


def _tracking(results: Results) -> Tile | None:
    if results.loop is None:
        return None
    rows = of_scheme(results, outer(results, Scheme(compensation="servo_inversion")))
    law = results.best if results.best in rows else next(iter(rows))
    body = rows.get(StandIn.BODY_ONLY)
    beside = f"; with the rigid body alone {_listed(1e3 * body.mean, 2)}" if body else ""
    return Tile(
        figure=_listed(1e3 * rows[law].mean, 2),
        unit="mrad",
        text=f"tracking error with {title(law)} through the servo’s inverse{beside}",
    )


def _physics(results: Results) -> Tile | None:
    found = results.audits
    if not found:
        return None
    good = [law for law, of_law in found.items() if all(map(passive, of_law.audits))]
    text = "laws never give energy on the closed cycles that were tried"
    if papers_law() in found and papers_law() not in good:
        text += f"; the paper’s {title(papers_law())} does"
    return Tile(figure=f"{len(good)} of {len(found)}", unit="", text=text)


def _picture(results: Results, pictures: Pictures) -> Markup:
    test = results.tests[0]
    scores = results.comparisons[test].ratios
    if not scores.laws:
        return Markup()
    laws = {title(law): row for law, row in scores.laws.items()}
    reference = "its reference" if scores.references else title(scores.reference)
    return pictures.figure(
        "ratios",
        ratios(laws, results.joints, x=f"RMSE / RMSE of {reference}"),
        f"Error of every law relative to {reference} on ‘{test}’, with 95 % intervals (bootstrap "
        "of blocks of time). Left of the line is better. The reference of a law is the strongest "
        "classic law of the same inputs or fewer; the claim is about these logs.",
        alt=f"For each law and joint, a dot at its error relative to {reference} and its interval.",
    )


def _truth(results: Results) -> str:
    """Say what the true friction of a twin is, and who wins where it is another one."""
    rank = "measured robots may rank the laws otherwise."
    if results.run.truth:
        return f"Its friction is the truth ‘{results.run.truth}’ of its plant; {rank}"
    text = (
        "Its friction is of no law’s form, but it is bristle-like, so laws of that kind are at "
        f"home on it; {rank}"
    )
    winners = [
        f"{title(leading(errors))} under ‘{truth}’" for truth, errors in results.truths.items()
    ]
    return f"{text} Least error under other truths: {', '.join(winners)}." if winners else text


def _honest(results: Results) -> list[str]:
    said = []
    scores = results.comparisons[results.tests[0]]
    if results.run.twin:
        said.append(f"The robot is a simulated one. {_truth(results)}")
    if ORACLE in scores.laws:
        floor = scores.laws[ORACLE].rmse
        best = scores.laws[results.best].rmse
        above = 100.0 * float(np.mean(np.divide(best, floor)) - 1.0)
        said.append(
            f"Noise and the rigid body’s own error leave {_listed(floor)} {results.unit('N.m')} to "
            f"any law; {title(results.best)} is {above:.0f}\u00a0% above that on average."
        )
    if papers_law() in results.properties:
        counts = {law: found.passed for law, found in results.properties.items()}
        most = max(counts, key=lambda law: counts[law])
        said.append(
            f"Of the {len(EXPECTATIONS)} properties of friction the paper’s law has "
            f"{counts[papers_law()]} on all joints; the most are had by {title(most)}, "
            f"{counts[most]}. A small RMSE does not make a law friction."
        )
    if results.loop:
        said.append(
            "The paper’s own control scheme barely tells good laws apart: with a servo that "
            "integrates, a perfect law gives no correction. Laws pay where they are fed forward "
            "through the servo’s inverse."
        )
    return said
