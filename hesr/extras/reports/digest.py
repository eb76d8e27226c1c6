"""Results of runs as one page of Markdown, with all tables as CSV."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import geometric_mean

from cosim.loop.closed_loop import StandIn
from cosim.report.markup import Tables
from cosim.report.results import AREAS, Results
from cosim.report.tables.laws import find_most_passing, properties
from cosim.report.tables.loop import outcome, tracking
from cosim.report.tables.scores import bands, errors, leading, left_out, other_truths, own_friction
from cosim.report.tables.table import ResultTable, TableRow, fixed, markdown, row_of, title
from cosim.study.scores import ORACLE, REFERENCE
from hesr_model.audit.properties import EXPECTATIONS
from hesr_model.fitting.estimator import papers_law
from hesr_model.support.files import written_together

_INTRODUCTION = (
    "Written by `hesr report` from the runs below; the CSV files have all laws and tests. "
    "RMSE of the exported FMUs on unseen logs; in brackets the ratio to the reference and its "
    "95 % interval. For the method see [methods.md](methods.md).\n"
)


def write_digest(folders: Sequence[Path], output: Path) -> Path:
    """Write the main tables of runs to a page, all tables to CSV files in a folder of its name."""
    runs = [Results.read(folder) for folder in folders]
    data = output.with_name(f"{output.stem}_tables")  # not the name of a folder of results
    parts = ["# Results\n", _INTRODUCTION]
    with written_together(output) as file:
        if len(runs) > 1:
            found = robots(runs)
            Tables(data, file).csv(found, "robots")
            parts += ["## Robots\n", markdown(found)]
        for results in runs:
            tables = Tables(data / results.run.study, file)
            for name, table in _data(results).items():
                tables.csv(table, name)
            where = f"{data.name}/{results.run.study}"
            files = ", ".join(f"[{Path(file).stem}]({where}/{file})" for file in tables.written)
            parts += [*_run(results), f"All laws: {files}.\n"]
        file(output).write_text("\n".join(parts), encoding="utf-8")
    return output


def robots(runs: Sequence[Results]) -> ResultTable:
    """Return errors of the recommended law over those of the strongest reference, by joint."""
    rows = []
    for results in runs:
        found = [results.against(k) for k in range(len(results.joints))]
        known = [[one for *_, of in found if (one := of[area])] for area in AREAS]
        means = (fixed(geometric_mean(of) if of else None, 2) for of in known)
        rows += [row_of(results.run.robot), row_of("mean", "", "", *means)]
        rows += [
            row_of(joint, title(law), title(other), *(fixed(of[area], 2) for area in AREAS))
            for joint, (law, other, of) in zip(results.joints, found, strict=True)
        ]
    return ResultTable(
        caption="Error of the recommended law over that of the strongest classic law with the same "
        "inputs or fewer, on the first test set (mean: geometric; simulation: position errors; "
        "between days: training logs left out in turn)",
        head=("joint", "recommended", "reference", *AREAS),
        rows=rows,
        words=(1, 2),
    )


def _data(results: Results) -> dict[str, ResultTable]:
    found = {}
    for test, comparison in results.comparisons.items():
        name = file_name(test)
        found[name] = errors(test, comparison, inputs=results.run.inputs, sliding=results.sliding)
        if comparison.bands:
            found[f"{name}_bands"] = bands(test, comparison)
    table = left_out(results.models, results.sliding)
    if table:
        found["left_out"] = table
    if results.truths:
        found["alternative_plants"] = other_truths(
            results.comparisons, results.truths, results.run.truth
        )
    if results.loop:
        tables = enumerate(outcome(results.loop), start=1)
        found |= {f"closed_loop_{k}": table for k, table in tables}
    if results.properties:
        found["physics_checks"] = properties(results.properties, full=True)
    return found


def file_name(test: str) -> str:
    """Return the stem of the file for a test set."""
    return re.sub(r"[^\w.-]+", "_", test)


def _run(results: Results) -> Iterator[str]:
    yield f"## {results.run.study}: {results.run.robot}\n"
    yield f"`{results.run.command}`\n"
    if results.verdict:
        yield f"{results.verdict.sentences[0]}\n"
    yield "### How well is the friction of unseen motions predicted?\n"
    yield f"{_prediction(results)}\n"
    yield markdown(short(results))
    if results.truths:
        yield "### Does the order of the laws depend on the true friction?\n"
        led = ", ".join(
            f"{title(leading(of))} with {plant}" for plant, of in results.truths.items()
        )
        yield f"{own_friction(results.run.truth)} Lowest error: {led}.\n"
        table = other_truths(results.comparisons, results.truths, results.run.truth)
        yield markdown(_rows(table, [REFERENCE, papers_law(), results.best, ORACLE]))
    if results.loop:
        yield "### Does friction compensation improve tracking?\n"
        wanted = {*StandIn, REFERENCE, papers_law(), *results.recommended}
        desired = (row for row in results.loop.tracking if row.scheme.source == "desired")
        rows = [row for row in desired if row.law in wanted]
        laws = [row for row in rows if row.law not in set(StandIn)]
        body = [row for row in rows if row.law == StandIn.BODY_ONLY]
        if laws and body:
            best = min(laws, key=lambda row: float(row.mean.mean()))
            alone = next((row for row in body if row.scheme == best.scheme), body[0])
            yield (
                f"Yes: {best.scheme.title} with {title(best.law)} tracks to "
                f"{1e3 * best.mean.mean():.2f} mrad, averaged over joints; "
                f"{title(alone.law)} to {1e3 * alone.mean.mean():.2f} mrad.\n"
                if best.mean.mean() < alone.mean.mean()
                else "No.\n"
            )
        yield markdown(tracking("RMSE of tracking [mrad], mean over the motions", rows))
    if results.properties:
        yield "### Which laws behave as friction in physics checks?\n"
        yield from _physics(results)


def _prediction(results: Results) -> str:
    comparison = results.comparisons[results.tests[0]]
    best = results.best
    left = 100.0 * comparison.size(best)
    text = f"{title(best)} leaves {left:.0f} % of the friction unexplained, averaged over joints"
    ratios = comparison.ratios.laws.get(best, ())
    if not ratios:
        return f"{text}."
    mean = geometric_mean(ratio.value for ratio in ratios)
    return f"{text}; its error is {mean:.2f} times that of its reference (geometric mean)."


def short(results: Results) -> ResultTable:
    """Return the best law, its references and ParFam-H on the first test set."""
    test = results.tests[0]
    best = results.best
    comparison = results.comparisons[test]
    references = [comparison.ratios.of(best, k) for k in range(len(comparison.joints))]
    return _rows(
        errors(test, comparison, sliding=results.sliding), [*references, papers_law(), best]
    )


def _rows(table: ResultTable, laws: Sequence[str]) -> ResultTable:
    rows = {str(row.head): row for row in table.rows}
    wanted = dict.fromkeys(map(title, laws))
    shown: list[TableRow] = [row for row in table.rows if row.quiet]
    shown += [rows[head] for head in wanted if head in rows]
    return ResultTable(caption=table.caption, head=table.head, rows=shown)


def _physics(results: Results) -> Iterator[str]:
    found = results.properties
    laws, most = find_most_passing(found)
    yield (
        f"{', '.join(map(title, laws))}: {most} of {len(EXPECTATIONS)} checks passed on all "
        f"joints, the most of {len(found)} laws.\n"
    )
    rows = [
        row_of(title(law), str(found[law].passed), "; ".join(found[law].failed) or "–")
        for law in dict.fromkeys([REFERENCE, papers_law(), *results.recommended, *laws])
        if law in found
    ]
    head = ("law", "passed", "fails on at least one joint")
    yield markdown(ResultTable(caption="Physics checks", head=head, rows=rows, numeric=False))
