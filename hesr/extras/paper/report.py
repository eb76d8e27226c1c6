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
    fixed_cell,
    format_significant,
    joints,
    make_row,
    markdown,
    title,
)
from cosim.workflow.answer import Written
from fmu_src.pages.html import code_templates
from hesr.extras.paper import measures
from hesr.extras.paper.evidence import (
    LUGRE,
    MEASURED,
    STRAIN_WAVE,
    TABLE_1,
    TWIN,
    Claim,
    Evidence,
    Limit,
    Number,
)
from hesr_model.errors import ArgumentError
from hesr_model.inference.comparison import ErrorRatio
from hesr_model.support.files import written_together
from hesr_model.support.typed_files import from_json, read_json

FORMAT = "hesr-paper-2"
FILE = "paper.json"
HOLDS = "holds"
PARTLY = "partly"
FAILS = "fails"
OPEN = "not testable"
_REVERSAL_CLAIM = 6  # the ablation of the state h
_GAIN_PLACES = {TWIN: "fits to the twin", MEASURED: "measured joints"}
_RIVALS = {
    "rbfnn_h": "RBFNN-H",
    "lugre": "LuGre fitted at once",
    "lugre_static_first": "LuGre fitted static-first",
}
_ERROR_TABLES = (
    ("Prediction on the twin", TWIN, "the bristles of the MJCF are"),
    ("Prediction where LuGre is the truth", LUGRE, "LuGre is"),
    ("Prediction where a strain wave is the truth", STRAIN_WAVE, "a strain-wave gear is"),
    ("Prediction where Table I is the truth", TABLE_1, "the laws of Table I are"),
)
"""Heading, true friction and words of the caption of each table of errors."""
_TEMPLATES = code_templates(Path(__file__).parent / "templates")
_TITLES = {
    "parfam_h_paper": "ParFam-H (paper)",
    "lugre_static_first_textbook": "LuGre, static first, F_s >= F_c",
}


@dataclass(frozen=True, kw_only=True)
class TruthVerdict:
    """Values of a claim under one true friction, the verdict, and the values that hold."""

    values: Mapping[str, Number]
    verdict: str
    holding: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A claim, its judgement by true friction, and the verdict over all of them."""

    claim: Claim
    truths: Mapping[str, TruthVerdict]
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
    def from_evidence(cls, evidence: Evidence, command: str) -> "PaperResult":
        """Judge claims by the evidence."""
        rmse = {}
        ratios = {}
        for truth, motion_cases in evidence.cases.items():
            first_case = next(iter(motion_cases.values()))  # all cases have the same laws
            rmse[truth] = {
                law_name: measures.level(evidence, truth=truth, law=law_name)
                for law_name in first_case.models
            }
            ratios[truth] = {
                law_name: measures.errors(evidence, truth=truth, others=[law_name])
                for law_name in first_case.models
                if law_name != evidence.study.literal
            }
        tracking = {}
        for controller, rows in evidence.tracked.items():
            tracking[controller] = {
                law_name: tuple(row.mean.tolist()) for law_name, row in rows.items()
            }
        return cls(
            command=command,
            claims=tuple(judge_claim(claim, evidence) for claim in evidence.study.claims),
            rmse=rmse,
            ratios=ratios,
            tracking=tracking,
        )


def judge_values(
    values: Mapping[str, Number], at_least: Limit | None, at_most: Limit | None
) -> TruthVerdict:
    """Compare the intervals of values with limits.

    A claim holds if all intervals are within the limits, and fails if none is and one is outside.
    It holds partly if some are within; it is not testable if all intervals contain a limit.
    """
    if at_least is None:
        at_least = -np.inf
    if at_most is None:
        at_most = np.inf
    floors = np.broadcast_to(at_least, len(values))
    ceilings = np.broadcast_to(at_most, len(values))
    holding = []
    is_refuted = False
    for (label, number), floor, ceiling in zip(values.items(), floors, ceilings, strict=True):
        low, high = number.interval
        if number.is_open:
            continue
        if floor <= low and high <= ceiling:
            holding.append(label)
        elif high < floor or low > ceiling:
            is_refuted = True
    if len(holding) == len(values):
        verdict = HOLDS
    elif holding:
        verdict = PARTLY
    elif is_refuted:
        verdict = FAILS
    else:
        verdict = OPEN
    return TruthVerdict(values=values, verdict=verdict, holding=tuple(holding))


def judge_claim(claim: Claim, evidence: Evidence) -> Judged:
    """Measure a claim under each true friction and judge it."""
    values_by_truth: dict[str, Mapping[str, Number]] = {}
    if claim.measure:
        measure = getattr(measures, claim.measure)
        if claim.measure in measures.CASE_MEASURES and claim.everywhere:
            for truth in evidence.cases:
                values_by_truth[truth] = measure(evidence, **claim.options, truth=truth)
        else:
            values_by_truth[TWIN] = measure(evidence, **claim.options)
    truths: dict[str, TruthVerdict] = {}
    for truth, values in values_by_truth.items():
        claimed_values = {
            label: value for label, value in values.items() if label.endswith(claim.joint)
        }
        if claimed_values:
            truths[truth] = judge_values(claimed_values, claim.at_least, claim.at_most)
    return Judged(claim=claim, truths=truths, verdict=combine_verdicts(truths))


def combine_verdicts(truths: Mapping[str, TruthVerdict]) -> str:
    """Return the verdict over all true frictions."""
    verdicts = {judgement.verdict for judgement in truths.values()} - {OPEN}
    if not verdicts:
        return OPEN
    if len(verdicts) > 1:
        return PARTLY
    return verdicts.pop()


def tables(result: PaperResult) -> dict[str, ResultTable]:
    """Return all tables by title."""
    sections = {
        "Claims": _build_claim_table(result.claims),
        "Claims by true friction": _build_truth_table(result.claims),
    }
    for heading, truth, words in _ERROR_TABLES:
        where = f"[N.m] where {words} the true friction"
        sections[heading] = _build_error_table(result, truth, where)
    sections["Tracking"] = _build_tracking_table(result.tracking)
    if MEASURED in result.rmse:
        where = "[N.m; N] of measured joints, by the split of their own study"
        sections["Prediction on measured joints"] = _build_error_table(result, MEASURED, where)
    return sections


def _build_claim_table(claims: Sequence[Judged]) -> ResultTable:
    rows = []
    for judged in claims:
        claim = judged.claim
        row = make_row(
            str(claim.number),
            f"{claim.text} ({claim.where})",
            claim.printed,
            claim.test,
            _format_values(judged),
            _format_limits(claim),
            judged.verdict,
        )
        rows.append(row)
    return ResultTable(
        caption="Claims of the paper and the twin; in brackets 95\u00a0% intervals",
        head=("no.", "claim", "printed", "measure on the twin", "here", "needed", "verdict"),
        rows=rows,
        numeric=False,
    )


def _build_truth_table(claims: Sequence[Judged]) -> ResultTable:
    """Return the verdict of each claim under each true friction, and where it holds partly."""
    names: dict[str, None] = {}  # in the order of the claims
    for judged in claims:
        names |= dict.fromkeys(judged.truths)
    rows = []
    for judged in claims:
        cells = [_format_judgement(judged.truths.get(truth)) for truth in names]
        rows.append(make_row(str(judged.claim.number), judged.claim.text, *cells))
    return ResultTable(
        caption="Verdicts by true friction; on measured joints by the split of their own study",
        head=("no.", "claim", *names),
        rows=rows,
        numeric=False,
    )


def _format_judgement(judgement: TruthVerdict | None) -> str:
    if judgement is None:
        return "–"
    if judgement.verdict != PARTLY:
        return judgement.verdict
    return f"{PARTLY}: {', '.join(judgement.holding)}"


def _format_values(judged: Judged) -> str:
    """Return the values on the twin."""
    if TWIN not in judged.truths:
        return "–"
    values = judged.truths[TWIN].values
    return "; ".join(f"{label} {_format_number(value)}".strip() for label, value in values.items())


def _format_number(number: Number) -> str:
    text = format_significant(number.value)
    if number.low and number.high:
        text += f" ({format_significant(number.low)}–{format_significant(number.high)})"
    return text


def _format_limits(claim: Claim) -> str:
    stated_limits = []
    for words, limit in (("at least", claim.at_least), ("at most", claim.at_most)):
        if limit is not None:
            values = " / ".join(f"{value:g}" for value in np.atleast_1d(limit))
            stated_limits.append(f"{words} {values}")
    return ", ".join(stated_limits)


def _title_law(law_name: str) -> str:
    return _TITLES.get(law_name, title(law_name))


def _build_error_table(result: PaperResult, truth: str, where: str) -> ResultTable:
    """Return the errors of all laws under one true friction, which the caption names `where`."""
    rows = []
    for law_name, errors in result.rmse[truth].items():
        ratios = result.ratios[truth].get(law_name, {})
        cells = [_format_error(error, ratios.get(label)) for label, error in errors.items()]
        rows.append(make_row(_title_law(law_name), *cells))
    return ResultTable(
        caption=f"RMSE of the predicted torque {where}; small: error "
        "of ParFam-H (paper) over that of the law, with its 95\u00a0% interval",
        head=("law", *next(iter(result.rmse[truth].values()))),
        rows=rows,
    )


def _format_error(error: Number, ratio: Number | None) -> TableCell:
    """Return an error with the ratio of the literal law to it as notes."""
    if ratio is None:
        return fixed_cell(error.value, 2)
    error_ratio = ErrorRatio(value=ratio.value, low=ratio.low, high=ratio.high)
    return fixed_cell(error.value, 2, notes=ratio_notes(error_ratio))


def _build_tracking_table(errors: Mapping[str, Mapping[str, tuple[float, ...]]]) -> ResultTable:
    rows = []
    for controller, errors_by_law in errors.items():
        rows.append(make_row(controller))
        for law_name, joint_errors in errors_by_law.items():
            cells = [fixed_cell(1e3 * error, 1) for error in joint_errors]
            rows.append(make_row(_title_law(law_name), *cells))
    return ResultTable(
        caption="RMSE of tracking [mrad], mean over the motions",
        head=("torque model", *joints(len(rows[1].cells))),
        rows=rows,
    )


def write_page(folder: Path, output: Path | None = None, **_: Any) -> None:
    """Write the page of a folder of results as .html, by default in the folder, or as .md."""
    document = read_json(folder / FILE, FORMAT)
    path = output or folder / "report.html"
    result = from_json(PaperResult, document, folder / FILE, "results of the paper's study")
    if path.suffix not in (".md", ".html"):
        raise ArgumentError(f"{path}: reports of a study of claims are .html and .md.")
    result_tables = tables(result)
    tables_folder = TABLES
    if path.suffix == ".md":
        tables_folder = f"{path.stem}_tables"
    with written_together(path) as provide_file:
        files = Tables(path.parent / tables_folder, provide_file)
        for heading, result_table in result_tables.items():
            files.csv(result_table, heading.lower().replace(" ", "_"))
        if path.suffix == ".md":
            table_files = [f"{tables_folder}/{file}" for file in files.written]
            text = _compose_markdown(result, result_tables, table_files)
            provide_file(path).write_text(text, encoding="utf-8")
        else:
            answer = Written(
                title="Claims of the paper on the digital twin",
                lines=compose_opening(result),
                shown=[
                    replace(result_table, section=heading)
                    for heading, result_table in result_tables.items()
                ],
            )
            write_answer(answer, provide_file(path))


def _compose_markdown(
    result: PaperResult, result_tables: Mapping[str, ResultTable], table_files: Sequence[str]
) -> str:
    """Return the page of the documentation, which links to its tables."""
    body_errors = [
        _format_milliradians(errors_by_law[StandIn.BODY_ONLY])
        for errors_by_law in result.tracking.values()
    ]
    return _TEMPLATES.get_template("paper.md.j2").render(
        command=result.command,
        opening=compose_opening(result),
        bodies=body_errors,
        controllers=[*result.tracking],
        parts={heading: markdown(result_table) for heading, result_table in result_tables.items()},
        files=table_files,
    )


def _format_milliradians(errors: Sequence[float]) -> list[str]:
    return [f"{1e3 * error:.0f}" for error in errors]


def compose_opening(result: PaperResult) -> list[str]:
    """Return what explains the claimed gain, the numbers of verdicts, and what memory brings."""
    ratios = result.ratios[LUGRE]
    text = _TEMPLATES.get_template("opening.j2").render(
        static=ratios["lugre_static_first"],
        bounded=ratios["lugre_static_first_textbook"],
        fair=ratios["lugre"],
        verdicts=[judged.verdict for judged in result.claims],
    )
    lines = [line for line in text.splitlines() if line]
    return [*lines, " ".join(_describe_gains(result))]


def _describe_gains(result: PaperResult) -> Iterator[str]:
    """Yield what the state h brings against velocity alone, and against laws with memory."""
    [reversals] = [judged for judged in result.claims if judged.claim.number == _REVERSAL_CLAIM]
    yield (
        "Within 0.1 s of reversals ParFam-H (paper) is compared with ParFam-V, the same law "
        "without h."
    )
    texts = [
        _describe_gain(reversals.truths[truth], cases)
        for truth, cases in _GAIN_PLACES.items()
        if truth in reversals.truths
    ]
    yield f"Its error is lower {' and '.join(texts)}, by the whole interval."
    if MEASURED in result.ratios:
        ranges = list(_list_measured_ratios(result.ratios[MEASURED]))
        if ranges:
            yield f"On measured joints with enough rows it is {', '.join(ranges)}."
    table_1 = [number.value for number in result.ratios[TABLE_1]["lugre"].values()]
    yield f"Where Table I is the truth it is {_format_range(table_1, 2)} times that of LuGre."


def _describe_gain(judgement: TruthVerdict, cases: str) -> str:
    """Return on how many cases the error is lower, and by how much."""
    decided_count = sum(not number.is_open for number in judgement.values.values())
    text = f"on {len(judgement.holding)} of {decided_count} {cases}"
    if not judgement.holding:
        return text
    gains = [100.0 * (1.0 - judgement.values[label].value) for label in judgement.holding]
    return f"{text} by {_format_range(gains, 0)} %"


def _list_measured_ratios(ratios: Mapping[str, Mapping[str, Number]]) -> Iterator[str]:
    """Yield the range of the ratios to each rival on joints with enough rows."""
    for law_name, rival in _RIVALS.items():
        values = [number.value for number in ratios[law_name].values() if not number.is_open]
        if values:
            yield f"{_format_range(values, 2)} times that of {rival}"


def _format_range(values: Sequence[float], digits: int) -> str:
    """Return the lowest and the highest of values."""
    lowest = f"{min(values):.{digits}f}"
    highest = f"{max(values):.{digits}f}"
    if lowest == highest:
        return lowest
    return f"{lowest} to {highest}"
