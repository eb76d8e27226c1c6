"""Answers of commands: at most 25 lines, the JSON envelope, and their display."""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest

import cosim.workflow
import hesr.extras
from cosim.report.tables.table import ResultTable, make_row
from cosim.workflow.answer import (
    Answer,
    Written,
    finding_lines,
    read_health,
    shorten_lines,
    written_files,
)
from hesr_model.findings import Finding
from hesr_model.support.typed_files import to_json

ADVICE = Finding(check="load", severity="advice", found="no load is logged")
ERROR = Finding(check="units", where="a.csv", found="q is in degrees", remedy="give the unit")


def numbered(count: int) -> list[str]:
    return [f"line {k}" for k in range(1, count + 1)]


def test_25_lines_are_shown_whole() -> None:
    assert shorten_lines(numbered(25)).splitlines() == numbered(25)
    assert shorten_lines(["a\nb", "c"]) == "a\nb\nc"
    assert shorten_lines([]) == ""


@pytest.mark.parametrize(("count", "left"), [(26, 2), (40, 16)])
def test_longer_answers_are_cut_to_25_lines(count: int, left: int) -> None:
    shown = shorten_lines(["\n".join(numbered(count - 1)), "end"]).splitlines()
    assert shown == [*numbered(24), f"{left} more lines: --verbose shows them."]


def test_written_files_are_always_shown() -> None:
    files = [Path("a.json"), Path("b.ssv")]
    said = "Written: a.json, b.ssv"
    assert shorten_lines(numbered(24), files).splitlines() == [*numbered(24), said]
    more = "2 more lines: --verbose shows them."
    assert shorten_lines(numbered(25), files).splitlines() == [*numbered(23), more, said]


@pytest.mark.parametrize(
    ("findings", "passed"), [([], True), ([ADVICE], True), ([ADVICE, ERROR], False)]
)
def test_an_answer_passes_without_errors(findings: list[Finding], passed: bool) -> None:
    answer = Written(lines=["done"], findings=findings, data=[1], files=[Path("a.json")])
    assert answer.passed is passed
    assert answer.to_json() == {
        "format": "hesr-answer-1",
        "passed": passed,
        "findings": [to_json(one) for one in findings],
        "result": [1],
        "files": ["a.json"],
    }


def test_findings_are_one_line_each() -> None:
    assert finding_lines([ADVICE, ERROR]) == [
        "advice: no load is logged [load]",
        "error: a.csv: q is in degrees: give the unit. [units]",
    ]


def test_findings_of_a_provenance_have_errors_first() -> None:
    assert read_health({"health": [to_json(ADVICE), to_json(ERROR)]}) == [ERROR, ADVICE]
    assert read_health({}) == []


def test_only_a_given_output_is_written() -> None:
    assert written_files(None) == []
    assert written_files("a.json") == [Path("a.json")]


def test_an_answer_is_displayed() -> None:
    table = ResultTable(caption="Errors", head=("law",), rows=[make_row("lugre")])
    answer = Written(lines=["a < b", "c"], shown=["1 < 2", table])
    assert repr(answer) == "Written('a < b')"
    html = answer._repr_html_()
    assert html.startswith("<pre>a &lt; b\nc</pre>\n<p>1 &lt; 2</p>\n<")
    assert "lugre" in html
    assert "Errors" in html


def kinds(of: type[Answer]) -> Iterator[type[Answer]]:
    for kind in of.__subclasses__():
        yield kind
        yield from kinds(kind)


def test_every_answer_is_displayed_by_its_first_line() -> None:
    for package in (cosim.workflow, hesr.extras):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            import_module(module.name)
    found = [kind for kind in kinds(Answer) if kind.__module__.startswith(("cosim.", "hesr."))]
    assert len(found) > 5
    assert [kind for kind in found if kind.__repr__ is not Answer.__repr__] == []
