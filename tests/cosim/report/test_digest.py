"""The tables of runs as a page of Markdown."""

import csv
import re
import shutil
from dataclasses import replace
from io import StringIO
from pathlib import Path
from statistics import geometric_mean

import pytest
from click.testing import CliRunner

from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, TableCell, TableRow, markdown, title
from hesr.cli import app
from hesr.extras.reports.digest import build_short_table, file_name, write_digest
from hesr_model.errors import ArtifactError
from hesr_model.inference.choice import PLAIN


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_table_has_best_values_notes_and_marks() -> None:
    rows = [
        TableRow(head="inputs v"),
        TableRow(head="a|b", cells=[TableCell(text="1.5", best=True, notes=("0.9", "0.8–1.0"))]),
        TableRow(head="c", cells=[TableCell(text="2\n", marks=("pass", "fail"))]),
    ]
    text = markdown(ResultTable(caption="What; small: ratio", head=("law", "J1"), rows=rows))
    assert text.splitlines() == [
        "What; in brackets: ratio.",
        "",
        "| law | J1 |",
        "| --- | ---: |",
        "| **inputs v** |  |",
        r"| a\|b | **1.5** (0.9, 0.8–1.0) |",
        "| c | 2✓<br>✗ |",
    ]


def test_every_figure_is_that_of_the_run(results: Path, tmp_path: Path) -> None:
    page = write_digest([results], tmp_path / "results.md")
    text = page.read_text(encoding="utf-8")
    read = Results.read(results)
    assert f"## {read.run.study}: {read.run.robot}\n" in text
    assert read.verdict
    assert read.verdict.sentences[0] in text.splitlines()
    share = 100.0 * read.comparisons[read.tests[0]].size(read.best)
    assert f"leaves {share:.0f} % of the friction" in text
    head = next(line for line in text.splitlines() if "over all rows" in line)
    assert read.tests[0] in head
    scores = read.comparisons[read.tests[0]]
    best = next(line for line in text.splitlines() if line.startswith(f"| {title(read.best)}"))
    errors = scores.laws[read.best].rmse
    for shown, rmse in zip(cells(best)[1 : len(errors) + 1], errors, strict=True):
        assert float(shown.replace("*", "").split()[0]) == pytest.approx(rmse, rel=0.01)


def test_csv_files_have_all_laws_with_all_digits(results: Path, tmp_path: Path) -> None:
    page = write_digest([results], tmp_path / "results.md")
    read = Results.read(results)
    files = sorted((tmp_path / "results_tables" / read.run.study).iterdir())
    links = re.findall(r"\]\((.*?\.csv)\)", page.read_text(encoding="utf-8"))
    assert sorted(tmp_path / link for link in links) == files
    for test in read.tests:
        table = files[0].with_name(f"{file_name(test)}.csv").read_text(encoding="utf-8")
        rows = {row["law"]: row for row in csv.DictReader(StringIO(table))}
        for law, scores in read.comparisons[test].laws.items():
            shown = [float(rows[title(law)][joint]) for joint in read.joints]
            assert shown == list(scores.rmse)


def test_results_next_to_the_page_are_kept(results: Path, tmp_path: Path) -> None:
    """The page results.md of results/small, written where that folder is."""
    folder = tmp_path / "results" / Results.read(results).run.study
    # Another test may be writing its page there.
    shutil.copytree(results, folder, ignore=shutil.ignore_patterns(".hesr-*"))
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    write_digest([folder], tmp_path / "results.md")
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_the_summary_lists_the_papers_law_next_to_the_best(results: Path) -> None:
    read = Results.read(results)
    heads = [str(row.head) for row in build_short_table(read).rows]
    assert title(read.best) in heads
    assert len(heads) == len(set(heads)) <= 4


def test_a_folder_without_results_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="no results of 'hesr run'"):
        write_digest([tmp_path], tmp_path / "results.md")
    assert not (tmp_path / "results.md").exists()


def test_the_command_prints_the_written_file(results: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    ended = CliRunner().invoke(app, ["report", str(results), "-o", str(page)])
    assert ended.exit_code == 0, ended.output
    assert page.name in ended.output.replace("\n", "")


def test_several_runs_begin_with_a_table_of_recommended_laws(results: Path, tmp_path: Path) -> None:
    run = Results.read(results)
    page = write_digest([results, results], tmp_path / "r.md").read_text(encoding="utf-8")
    assert "## Robots\n" not in write_digest([results], tmp_path / "one.md").read_text("utf-8")
    lines = page[page.index("## Robots\n") : page.index("## small")].splitlines()
    test = run.comparisons[run.tests[0]]
    shown = [cells(line) for line in lines if line.startswith(tuple(f"| {j} " for j in run.joints))]
    assert len(shown) == 2 * len(run.joints)
    ratios = []
    for k, (joint, law, reference, *figures) in enumerate(shown[: len(run.joints)]):
        names = {title(name): name for name in test.laws}
        own, other = test.laws[names[law]], test.laws[names[reference]]
        assert joint == run.joints[k]
        assert names[law] == run.recommended[k]
        ratios.append(own.rmse[k] / other.rmse[k])
        plain = test.laws[PLAIN].rmse[k]
        assert float(figures[0]) == pytest.approx(own.rmse[k] / plain, abs=0.006)
        assert float(figures[1]) == pytest.approx(ratios[-1], abs=0.006)
        assert own.rmse_rest[k]
        assert other.rmse_rest[k]
        assert float(figures[2]) == pytest.approx(own.rmse_rest[k] / other.rmse_rest[k], abs=0.006)
        assert figures[5] == "–"  # a single training log has no other day
    (mean, again) = (cells(line) for line in lines if line.startswith("| mean "))
    assert mean == again
    assert sum(line.startswith(f"| **{run.run.robot}** ") for line in lines) == 2
    assert float(mean[4]) == pytest.approx(geometric_mean(ratios), abs=0.006)
    with (tmp_path / "r_tables" / "robots.csv").open(encoding="utf-8") as file:
        (_, first, *_) = csv.DictReader(file)
    assert float(first["prediction"]) == pytest.approx(ratios[0], rel=1e-12, abs=0.0)


def test_areas_that_a_run_has_not_are_dashes(results: Path) -> None:
    run = Results.read(results)
    scores = {
        name: replace(of, laws={law: replace(s, rmse_rest=()) for law, s in of.laws.items()})
        for name, of in run.comparisons.items()
    }
    _, _, found = replace(run, comparisons=scores, simulated={}).compare_to_reference(0)
    assert found["prediction"]
    assert found["at rest"] is found["simulation"] is found["between days"] is None


def test_errors_between_days_are_those_of_left_out_training_logs(results: Path) -> None:
    run = Results.read(results)
    again = [replace(log, name=f"{log.name} 2") for log in run.run.logs if "training" in log.roles]
    several = replace(run, run=replace(run.run, logs=(*run.run.logs, *again)))
    law, reference, found = several.compare_to_reference(0)
    own, other = (run.models[name].left_out_rmse[0] for name in (law, reference))
    assert found["between days"] == own / other
