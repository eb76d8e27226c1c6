"""Results of runs as one page of Markdown, with all tables as CSV."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import geometric_mean

from cosim.loop.closed_loop import StandIn
from cosim.loop.traces import Tracked
from cosim.report.markup import Tables
from cosim.report.results import AREAS, Results
from cosim.report.tables.laws import find_most_passing, properties
from cosim.report.tables.loop import outcome, tracking
from cosim.report.tables.scores import (
    bands,
    compare_truths,
    cross_validation,
    describe_true_friction,
    errors,
    find_leader,
)
from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    TableRow,
    fixed_cell,
    make_row,
    markdown,
    title,
)
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
    tables_folder = output.with_name(f"{output.stem}_tables")  # not the name of a folder of results
    parts = ["# Results\n", _INTRODUCTION]
    with written_together(output) as provide_file:
        if len(runs) > 1:
            robot_table = build_robot_table(runs)
            Tables(tables_folder, provide_file).csv(robot_table, "robots")
            parts += ["## Robots\n", markdown(robot_table)]
        for results in runs:
            tables = Tables(tables_folder / results.run.study, provide_file)
            for name, table in _collect_tables(results).items():
                tables.csv(table, name)
            table_folder = f"{tables_folder.name}/{results.run.study}"
            links = [f"[{Path(file).stem}]({table_folder}/{file})" for file in tables.written]
            parts += [*_describe_run(results), f"All laws: {', '.join(links)}.\n"]
        provide_file(output).write_text("\n".join(parts), encoding="utf-8")
    return output


def build_robot_table(runs: Sequence[Results]) -> ResultTable:
    """Return errors of the recommended law over those of the strongest reference, by joint."""
    rows = []
    for results in runs:
        joint_rows = []
        ratios_by_area: dict[str, list[float]] = {area: [] for area in AREAS}
        for j, joint in enumerate(results.joints):
            law_name, reference, ratios = results.compare_to_reference(j)
            cells = [fixed_cell(ratios[area], 2) for area in AREAS]
            joint_rows.append(make_row(joint, title(law_name), title(reference), *cells))
            for area in AREAS:
                ratio = ratios[area]
                if ratio:
                    ratios_by_area[area].append(ratio)
        means = [_average_ratios(area_ratios) for area_ratios in ratios_by_area.values()]
        rows += [make_row(results.run.robot), make_row("mean", "", "", *means), *joint_rows]
    return ResultTable(
        caption="Error of the recommended law over that of the strongest classic law with the same "
        "inputs or fewer, and over that of Coulomb + viscous friction, on the first test set "
        "(mean: geometric; simulation: position errors; between days: training logs left out in "
        "turn)",
        head=("joint", "recommended", "reference", *AREAS),
        rows=rows,
        words=(1, 2),
    )


def _average_ratios(ratios: Sequence[float]) -> TableCell:
    if not ratios:
        return fixed_cell(None, 2)
    return fixed_cell(geometric_mean(ratios), 2)


def _collect_tables(results: Results) -> dict[str, ResultTable]:
    named_tables = {}
    for test, comparison in results.comparisons.items():
        name = file_name(test)
        named_tables[name] = errors(
            test, comparison, inputs=results.run.inputs, sliding=results.sliding
        )
        if comparison.bands:
            named_tables[f"{name}_bands"] = bands(test, comparison)
    table = cross_validation(results.models, results.sliding)
    if table:
        named_tables["left_out"] = table
    if results.truths:
        named_tables["alternative_plants"] = compare_truths(
            results.comparisons, results.truths, results.run.truth
        )
    if results.loop:
        tables = enumerate(outcome(results.loop), start=1)
        named_tables |= {f"closed_loop_{k}": table for k, table in tables}
    if results.properties:
        named_tables["physics_checks"] = properties(results.properties, full=True)
    return named_tables


def file_name(test: str) -> str:
    """Return the stem of the file for a test set."""
    return re.sub(r"[^\w.-]+", "_", test)


def _describe_run(results: Results) -> Iterator[str]:
    yield f"## {results.run.study}: {results.run.robot}\n"
    yield f"`{results.run.command}`\n"
    if results.verdict:
        yield f"{results.verdict.sentences[0]}\n"
    yield "### How well is the friction of unseen motions predicted?\n"
    yield f"{_describe_prediction(results)}\n"
    yield markdown(build_short_table(results))
    if results.truths:
        yield "### Does the order of the laws depend on the true friction?\n"
        yield from _describe_truths(results)
    if results.loop:
        yield "### Does friction compensation improve tracking?\n"
        shown_laws = {*StandIn, REFERENCE, papers_law(), *results.recommended}
        yield from _describe_tracking(
            [
                row
                for row in results.loop.tracking
                if row.scheme.source == "desired" and row.law in shown_laws
            ]
        )
    if results.properties:
        yield "### Which laws behave as friction in physics checks?\n"
        yield from _describe_physics(results)


def _describe_truths(results: Results) -> Iterator[str]:
    """Yield the leaders on alternative plants, and the errors of a few laws."""
    leaders_text = ", ".join(
        f"{title(find_leader(errors))} with {plant}" for plant, errors in results.truths.items()
    )
    yield f"{describe_true_friction(results.run.truth)} Lowest error: {leaders_text}.\n"
    table = compare_truths(results.comparisons, results.truths, results.run.truth)
    yield markdown(_select_rows(table, [REFERENCE, papers_law(), results.best, ORACLE]))


def _describe_tracking(rows: Sequence[Tracked]) -> Iterator[str]:
    """Yield whether the best law tracks better than the body alone, and a table of all rows."""
    law_rows = [row for row in rows if row.law not in set(StandIn)]
    body_rows = [row for row in rows if row.law == StandIn.BODY_ONLY]
    if law_rows and body_rows:
        best_row = min(law_rows, key=lambda row: float(row.mean.mean()))
        body_row = next((row for row in body_rows if row.scheme == best_row.scheme), body_rows[0])
        best_error = best_row.mean.mean()
        body_error = body_row.mean.mean()
        if best_error < body_error:
            yield (
                f"Yes: {best_row.scheme.title} with {title(best_row.law)} tracks to "
                f"{1e3 * best_error:.2f} mrad, averaged over joints; "
                f"{title(body_row.law)} to {1e3 * body_error:.2f} mrad.\n"
            )
        else:
            yield "No.\n"
    yield markdown(tracking("RMSE of tracking [mrad], mean over the motions", rows))


def _describe_prediction(results: Results) -> str:
    comparison = results.comparisons[results.tests[0]]
    best_law = results.best
    unexplained = 100.0 * comparison.size(best_law)
    text = (
        f"{title(best_law)} leaves {unexplained:.0f} % of the friction unexplained, "
        "averaged over joints"
    )
    ratios = comparison.ratios.laws.get(best_law, ())
    if not ratios:
        return f"{text}."
    mean = geometric_mean(ratio.value for ratio in ratios)
    return f"{text}; its error is {mean:.2f} times that of its reference (geometric mean)."


def build_short_table(results: Results) -> ResultTable:
    """Return the best law, its references and ParFam-H on the first test set."""
    test = results.tests[0]
    best_law = results.best
    comparison = results.comparisons[test]
    references = [
        comparison.ratios.find_reference(best_law, j) for j in range(len(comparison.joints))
    ]
    return _select_rows(
        errors(test, comparison, sliding=results.sliding), [*references, papers_law(), best_law]
    )


def _select_rows(table: ResultTable, laws: Sequence[str]) -> ResultTable:
    rows = {str(row.head): row for row in table.rows}
    titles = dict.fromkeys(map(title, laws))
    selected_rows: list[TableRow] = [row for row in table.rows if row.quiet]
    selected_rows += [rows[head] for head in titles if head in rows]
    return ResultTable(caption=table.caption, head=table.head, rows=selected_rows)


def _describe_physics(results: Results) -> Iterator[str]:
    properties_by_law = results.properties
    laws, most_passed = find_most_passing(properties_by_law)
    yield (
        f"{', '.join(map(title, laws))}: {most_passed} of {len(EXPECTATIONS)} checks passed on all "
        f"joints, the most of {len(properties_by_law)} laws.\n"
    )
    rows = []
    for law_name in dict.fromkeys([REFERENCE, papers_law(), *results.recommended, *laws]):
        if law_name in properties_by_law:
            law_properties = properties_by_law[law_name]
            failures = "; ".join(law_properties.failed) or "–"
            rows.append(make_row(title(law_name), str(law_properties.passed), failures))
    head = ("law", "passed", "fails on at least one joint")
    yield markdown(ResultTable(caption="Physics checks", head=head, rows=rows, numeric=False))
