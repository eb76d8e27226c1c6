"""The measured robots that ship run by name, and give the figures of the readme."""

import csv
import zipfile
from pathlib import Path

import pytest
from documents import ROOT

import hesr
from cosim.study.results import read_findings

MEASURED = ("cylinder", "fretting", "ur10")
pytestmark = pytest.mark.ci


def test_a_measured_robot_runs_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    result = hesr.run("fretting", quick=True)
    assert result.folder == Path("results/fretting")
    findings = read_findings(result.folder)
    assert [finding for finding in findings if finding.severity == "error"] == []
    fmu = result.folder / result.outcome.verdict.fmu
    assert hesr.check(fmu).passed
    with zipfile.ZipFile(fmu) as archive:
        description = archive.read("modelDescription.xml").decode()
    assert 'unit="m/s"' in description
    assert 'unit="rad/s"' not in description
    page = (result.folder / "report.html").read_text(encoding="utf-8")
    assert "hesr run fretting" in page


def read_rows(path: Path, name: str) -> list[list[str]]:
    """Rows of a robot in a table of robots."""
    with path.open(encoding="utf-8") as file:
        return [cells for cells in csv.reader(file) if cells[0] == name]


def test_the_figures_of_the_readme_are_those_of_runs(tmp_path: Path) -> None:
    for name in MEASURED:
        hesr.run(name, output=tmp_path / name)
    hesr.report([tmp_path / name for name in MEASURED], output=tmp_path / "robots.md")
    for name in MEASURED:
        rows = read_rows(tmp_path / "robots_tables" / "robots.csv", name)
        expected_rows = read_rows(ROOT / "docs" / "results_tables" / "robots.csv", name)
        assert len(rows) == len(expected_rows)
        for row, expected in zip(rows, expected_rows, strict=True):
            assert row[:4] == expected[:4]
            for cell, expected_cell in zip(row[4:], expected[4:], strict=True):
                assert bool(cell) == bool(expected_cell)
                if cell:
                    assert float(cell) == pytest.approx(float(expected_cell), rel=1e-2)
