"""Results of the study: judged claims, tables, and pages in HTML and Markdown."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cosim.loop.closed_loop import StandIn
from cosim.report.markup import TABLES, Tables
from cosim.report.result_page import write_answer
from cosim.report.tables.scores import ratio_notes
from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    fixed,
    joints,
    markdown,
    rounded,
    row_of,
    title,
)
from cosim.workflow.answer import Written
from fmu_src.pages.html import code_templates
from hesr.extras.paper import measures
from hesr.extras.paper.evidence import LUGRE, TWIN, Claim, Evidence, Limit, Number
from hesr_model.errors import ArgumentError
from hesr_model.inference.comparison import ErrorRatio
from hesr_model.support.files import written_together
from hesr_model.support.typed_files import from_json, read_json

FORMAT = "hesr-paper-1"
FILE = "paper.json"
REPRODUCED = "reproduced"
REFUTED = "not reproduced"
OPEN = "not testable"
_TEMPLATES = code_templates(Path(__file__).parent / "templates")
_TITLES = {
    "parfam_h_paper": "ParFam-H (paper)",
    "lugre_static_first_textbook": "LuGre, static first, F_s >= F_c",
}


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A claim, its values on the twin and the verdict."""

    claim: Claim
    values: Mapping[str, Number]
    verdict: str


Numbers = Mapping[str, Mapping[str, Mapping[str, Number]]]  # by truth, law and label


@dataclass(frozen=True, kw_only=True)
class PaperResult:
    """Results of `hesr run paper`."""

    command: str
    claims: tuple[Judged, ...]
    rmse: Numbers  # [N.m]
    ratios: Numbers  # of the literal law to others
    tracking: Mapping[str, Mapping[str, tuple[float, ...]]]  # [rad] by controller, law and joint

    @classmethod
    def of(cls, e: Evidence, command: str) -> "PaperResult":
        """Judge claims by the evidence."""
        laws = {truth: next(iter(models.values())).models for truth, models in e.cases.items()}
        return cls(
            command=command,
            claims=tuple(judged(claim, e) for claim in e.study.claims),
            rmse={
                t: {k: measures.level(e, truth=t, law=k) for k in models}
                for t, models in laws.items()
            },
            ratios={
                t: {
                    k: measures.errors(e, truth=t, others=[k])
                    for k in models
                    if k != e.study.literal
                }
                for t, models in laws.items()
            },
            tracking={
                controller: {law: tuple(row.mean.tolist()) for law, row in rows.items()}
                for controller, rows in e.tracked.items()
            },
        )


def verdict(values: Sequence[Number], at_least: Limit | None, at_most: Limit | None) -> str:
    """Compare the intervals of values with limits.

    A claim is reproduced if all are within, not reproduced if one is outside, else not testable.
    """
    low = np.array([v.value if v.low is None else v.low for v in values])
    high = np.array([v.value if v.high is None else v.high for v in values])
    least = -np.inf if at_least is None else np.array(at_least)
    most = np.inf if at_most is None else np.array(at_most)
    if np.any((high < least) | (low > most)):
        return REFUTED
    return REPRODUCED if np.all((low >= least) & (high <= most)) else OPEN


def judged(claim: Claim, e: Evidence) -> Judged:
    """Measure a claim and judge it."""
    if not claim.measure:
        return Judged(claim=claim, values={}, verdict=OPEN)
    found = getattr(measures, claim.measure)(e, **claim.options)
    values = {label: v for label, v in found.items() if label.endswith(claim.joint)}
    compared = verdict([*values.values()], claim.at_least, claim.at_most)
    return Judged(claim=claim, values=values, verdict=compared)


def tables(result: PaperResult) -> dict[str, ResultTable]:
    """Return all tables by title."""
    return {
        "Claims": _claims(result.claims),
        "Prediction on the twin": _errors(result, TWIN, "the bristles of the MJCF are"),
        "Prediction where LuGre is the truth": _errors(result, LUGRE, "LuGre is"),
        "Tracking": _tracking(result.tracking),
    }


def _claims(claims: Sequence[Judged]) -> ResultTable:
    rows = [
        row_of(
            str(claim.number),
            f"{claim.text} ({claim.where})",
            claim.printed,
            claim.test,
            "; ".join(f"{label} {_shown(v)}".strip() for label, v in one.values.items()) or "–",
            _limits(claim),
            one.verdict,
        )
        for one in claims
        for claim in [one.claim]
    ]
    return ResultTable(
        caption="Claims of the paper and the twin; in brackets 95\u00a0% intervals",
        head=("no.", "claim", "printed", "measure on the twin", "here", "needed", "verdict"),
        rows=rows,
        numeric=False,
    )


def _shown(v: Number) -> str:
    between = f" ({rounded(v.low)}–{rounded(v.high)})" if v.low and v.high else ""
    return f"{rounded(v.value)}{between}"


def _limits(claim: Claim) -> str:
    pairs = (("at least", claim.at_least), ("at most", claim.at_most))
    found = [(word, np.atleast_1d(limit)) for word, limit in pairs if limit is not None]
    return ", ".join(f"{word} {' / '.join(f'{x:g}' for x in limits)}" for word, limits in found)


def _errors(result: PaperResult, truth: str, words: str) -> ResultTable:
    def cells(law: str) -> Iterator[TableCell]:
        ratios = result.ratios[truth].get(law, {})
        for label, value in result.rmse[truth][law].items():
            r = ratios.get(label)
            found = r and ratio_notes(ErrorRatio(value=r.value, low=r.low, high=r.high))
            yield fixed(value.value, 2, notes=found or ())

    return ResultTable(
        caption=f"RMSE of the predicted torque [N.m] where {words} the true friction; small: error "
        "of ParFam-H (paper) over that of the law, with its 95\u00a0% interval",
        head=("law", *next(iter(result.rmse[truth].values()))),
        rows=[row_of(_TITLES.get(law, title(law)), *cells(law)) for law in result.rmse[truth]],
    )


def _tracking(errors: Mapping[str, Mapping[str, tuple[float, ...]]]) -> ResultTable:
    rows = []
    for controller, of in errors.items():
        rows.append(row_of(controller))
        rows += [
            row_of(_TITLES.get(law, title(law)), *(fixed(1e3 * v, 1) for v in row))
            for law, row in of.items()
        ]
    return ResultTable(
        caption="RMSE of tracking [mrad], mean over the motions",
        head=("torque model", *joints(len(rows[1].cells))),
        rows=rows,
    )


def write_page(folder: Path, output: Path | None = None, **_: Any) -> None:
    """Write the page of a folder of results as .html, by default in the folder, or as .md."""
    data = read_json(folder / FILE, FORMAT)
    path = output or folder / "report.html"
    result = from_json(PaperResult, data, folder / FILE, "results of the paper's study")
    if path.suffix not in (".md", ".html"):
        raise ArgumentError(f"{path}: reports of a study of claims are .html and .md.")
    plain = path.suffix == ".md"
    shown = tables(result)
    with written_together(path) as file:
        files = Tables(path.parent / (f"{path.stem}_tables" if plain else TABLES), file)
        for heading, one in shown.items():
            files.csv(one, heading.lower().replace(" ", "_"))
        if plain:
            bodies = [rows[StandIn.BODY_ONLY] for rows in result.tracking.values()]
            text = _TEMPLATES.get_template("paper.md.j2").render(
                command=result.command,
                opening=opening(result),
                bodies=[[f"{1e3 * error:.0f}" for error in body] for body in bodies],
                controllers=[*result.tracking],
                parts={heading: markdown(one) for heading, one in shown.items()},
                files=[f"{files.folder.name}/{file}" for file in files.written],
            )
            file(path).write_text(text, encoding="utf-8")
        else:
            answer = Written(
                title="Claims of the paper on the digital twin",
                lines=opening(result),
                shown=[replace(one, section=heading) for heading, one in shown.items()],
            )
            write_answer(answer, file(path))


def opening(result: PaperResult) -> list[str]:
    """Return what explains the claimed gain, and the numbers of verdicts."""
    ratios = result.ratios[LUGRE]
    text = _TEMPLATES.get_template("opening.j2").render(
        static=ratios["lugre_static_first"],
        bounded=ratios["lugre_static_first_textbook"],
        fair=ratios["lugre"],
        verdicts=[one.verdict for one in result.claims],
    )
    return [line for line in text.splitlines() if line]
