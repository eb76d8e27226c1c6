"""The tables of runs as a page of Markdown."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from cosim.report.digest import short, write_digest
from cosim.report.results import Results
from cosim.report.tables.markdown import markdown
from cosim.report.tables.table import ResultTable, TableCell, TableRow, named
from cosim.study.verdict import read_verdict
from hesr.cli import app
from hesr_model.errors import ArtifactError

pytestmark = pytest.mark.ci


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


def test_every_figure_matches_the_files_of_the_runs(small_results: Path, tmp_path: Path) -> None:
    page = write_digest([small_results, small_results], tmp_path / "results.md")
    text = page.read_text(encoding="utf-8")
    results = Results.read(small_results)
    assert text.count(f"## {results.run.study}: {results.run.robot}\n") == 2
    said = read_verdict(small_results)
    assert said
    assert all(text.splitlines().count(sentence) == 2 for sentence in said.sentences)
    scores = results.comparisons[results.tests[0]]
    lines = [cells(line) for line in text.splitlines() if line.startswith("| ")]
    for law in scores.laws:
        of_law = [line for line in lines if line[0] == named(law)]
        assert of_law
        assert all(len(line) > len(results.joints) for line in of_law[:3])
    head = next(line for line in text.splitlines() if "over all rows" in line)
    assert results.tests[0] in head
    best = next(line for line in text.splitlines() if line.startswith(f"| {named(results.best)}"))
    for shown, rmse in zip(cells(best)[1:], scores.laws[results.best].rmse, strict=True):
        assert float(shown.replace("*", "").split()[0]) == pytest.approx(rmse, rel=0.01)


def test_the_summary_lists_the_papers_law_next_to_the_best(small_results: Path) -> None:
    results = Results.read(small_results)
    heads = [str(row.head) for row in short(results).rows]
    assert named(results.best) in heads
    assert len(heads) == len(set(heads)) <= 4


def test_a_folder_without_results_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="no results of 'hesr run'"):
        write_digest([tmp_path], tmp_path / "results.md")
    assert not (tmp_path / "results.md").exists()


def test_the_command_prints_the_written_file(small_results: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    ended = CliRunner().invoke(app, ["report", str(small_results), "-o", str(page)])
    assert ended.exit_code == 0, ended.output
    assert page.name in ended.output.replace("\n", "")
