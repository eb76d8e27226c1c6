"""The results of runs as one page of Markdown: every figure from their files, none typed."""

from collections.abc import Sequence
from pathlib import Path

from cosim.report.results import Results
from cosim.report.tables.loop import outcome
from cosim.report.tables.markdown import markdown
from cosim.report.tables.properties import legend, properties
from cosim.report.tables.scores import MEASURES, bands, errors, other_truths
from cosim.report.tables.table import ResultTable, TableRow, named
from cosim.study.verdict import read_verdict
from hesr_model.friction.registry import laws_with, papers_law
from hesr_model.support.files import written_whole


def write_digest(folders: Sequence[Path], output: Path) -> Path:
    """Write the tables of runs to a page of Markdown and return it.

    Parameters
    ----------
    folders : results of `hesr run`.
    output : the page to write.

    Raises
    ------
    ArtifactError, LogError
        If a folder holds no results, or the page cannot be written.
    """
    runs = [Results.read(folder) for folder in folders]
    parts = [
        "# Results\n",
        "Written by `hesr results` from the files of the runs below. RMSE of each exported FMU on "
        "logs that no fit has seen; in brackets the ratio to the reference and its 95 % interval. "
        "How it is measured: [methods.md](methods.md).\n",
        *(line for results in runs for line in _run(results)),
    ]
    with written_whole(output) as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")
    return output


def _run(results: Results) -> list[str]:
    """Return the parts of a run's chapter."""
    run = results.run
    said = read_verdict(results.folder)
    parts = [
        f"## {run.study}: {run.robot}\n",
        f"`{run.command}`\n",
        *(f"{sentence}\n" for sentence in (said.sentences if said else ())),
        "### In short\n",
        markdown(short(results)),
        "### Prediction\n",
    ]
    for name, scores in results.comparisons.items():
        measures = MEASURES if name == results.tests[0] else ("rmse",)
        parts += [
            markdown(errors(name, scores, measure, run.inputs, results.sliding))
            for measure in measures
        ]
        if scores.bands and name == results.tests[0]:
            parts.append(markdown(bands(name, scores)))
    if results.truths:
        table = other_truths(results.comparisons, results.truths, run.truth)
        parts += ["### Under other truths\n", markdown(table)]
    if results.loop:
        parts += ["### In closed loop\n", *map(markdown, outcome(results.loop))]
    if found := results.properties:
        tables = (properties(found), legend(results.sliding))
        parts += ["### Does it behave as friction does?\n", *map(markdown, tables)]
    return parts


def short(results: Results) -> ResultTable:
    """Return the best classic law, the paper's and the best of all on the first test set."""
    test = results.tests[0]
    whole = errors(test, results.comparisons[test], sliding=results.sliding)
    ranked = [str(row.head) for row in whole.rows]
    best = min((law for law in laws_with("classic") if named(law) in ranked),
               key=lambda law: ranked.index(named(law)), default=results.best)  # fmt: skip
    wanted = list(dict.fromkeys(named(law) for law in (best, papers_law(), results.best)))
    rows = {str(row.head): row for row in whole.rows}
    shown: list[TableRow] = [row for row in whole.rows if row.quiet]
    shown += [rows[head] for head in wanted if head in rows]
    return ResultTable(caption=whole.caption, head=whole.head, rows=shown)
