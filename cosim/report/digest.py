"""Results of runs as one page of Markdown."""

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

_INTRODUCTION = (
    "Written by `hesr report` from the files of the runs below. RMSE of each exported FMU on "
    "unseen logs; in brackets the ratio to the reference and its 95 % interval. For the method see "
    "[methods.md](methods.md).\n"
)


def write_digest(folders: Sequence[Path], output: Path) -> Path:
    """Write the tables of result folders to a page of Markdown and return its path."""
    runs = [Results.read(folder) for folder in folders]
    parts = ["# Results\n", _INTRODUCTION, *(part for results in runs for part in _run(results))]
    with written_whole(output) as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")
    return output


def _run(results: Results) -> list[str]:
    run, found = results.run, read_verdict(results.folder)
    parts = [
        f"## {run.study}: {run.robot}\n",
        f"`{run.command}`\n",
        *(f"{sentence}\n" for sentence in (found.sentences if found else ())),
        "### Summary\n",
        markdown(short(results)),
        "### Prediction\n",
    ]
    for name, scores in results.comparisons.items():
        first = name == results.tests[0]
        parts += [
            markdown(errors(name, scores, measure, run.inputs, results.sliding))
            for measure in (MEASURES if first else ("rmse",))
        ]
        if scores.bands and first:
            parts.append(markdown(bands(name, scores)))
    if results.truths:
        table = other_truths(results.comparisons, results.truths, run.truth)
        parts += ["### Alternative plants\n", markdown(table)]
    if results.loop:
        parts += ["### Closed loop\n", *map(markdown, outcome(results.loop))]
    if results.properties:
        tables = (properties(results.properties), legend(results.sliding))
        parts += ["### Physics checks\n", *map(markdown, tables)]
    return parts


def short(results: Results) -> ResultTable:
    """Return the best classic law, the paper's and the best of all on the first test set."""
    test = results.tests[0]
    whole = errors(test, results.comparisons[test], sliding=results.sliding)
    rows = {str(row.head): row for row in whole.rows}
    classic = [head for head in rows if head in set(map(named, laws_with("classic")))]
    best, paper = named(results.best), named(papers_law())
    wanted = dict.fromkeys([*classic[:1], paper, best])
    shown: list[TableRow] = [row for row in whole.rows if row.quiet]
    shown += [rows[head] for head in wanted if head in rows]
    return ResultTable(caption=whole.caption, head=whole.head, rows=shown)
