"""Pages of results: the order of their parts, and missing parts."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel, draw_chart
from cosim.report.figures.style import MEASURED
from cosim.report.markup import ResultFigure
from cosim.report.result_page import write_answer
from cosim.report.tables.table import ResultTable, make_row
from cosim.workflow.answer import Answer, Written
from hesr_model.findings import Finding


def figure(section: str, key: str) -> ResultFigure:
    line = Line(name="a", x=np.arange(3.0), y=np.arange(3.0), stroke=MEASURED)
    chart = Chart(x="t [s]", rows=((Panel(title="one", y="y", lines=(line,)),),))
    return ResultFigure(
        section=section,
        key=key,
        drawing=draw_chart(chart),
        caption=f"Curve {key}",
        alt="A rising line",
    )


def table(caption: str, *, section: str = "", note: str = "", rows: int = 1) -> ResultTable:
    return ResultTable(
        caption=caption,
        head=("name", "value"),
        rows=[make_row(f"row {k}", "1.5") for k in range(rows)],
        section=section,
        note=note,
    )


def page_of(answer: Answer, folder: Path) -> str:
    write_answer(answer, folder / "page.html")
    return (folder / "page.html").read_text(encoding="utf-8")


def ordered(page: str, *texts: str) -> None:
    """Assert that texts follow each other in the page, each once."""
    places = [page.index(text) for text in texts]
    assert places == sorted(places)
    assert [page.count(text) for text in texts] == [1] * len(texts)


def test_parts_follow_in_the_order_of_their_sections(tmp_path: Path) -> None:
    answer = Written(
        title="A fleet",
        origin="Made of 3 logs.",
        lines=["Two of them differ.", "One got worse."],
        findings=[
            Finding(check="units", found="q is in degrees"),
            Finding(check="load", severity="advice", found="no load is logged"),
        ],
        shown=[
            table("First", section="Numbers", note="Without offsets."),
            "Largest first.",
            table("Second"),
            table("Third", section="Numbers"),
        ],
        drawn=[figure("Numbers", "early"), figure("Pictures", "late")],
    )
    page = page_of(answer, tmp_path)
    assert "<title>HESR: A fleet</title>" in page
    links = re.findall(r'<a href="#([\w-]+)">(.+?)</a>', page[page.index("<nav") :])
    assert links == [
        ("summary", "Summary"),
        ("findings", "Findings"),
        ("numbers", "Numbers"),
        ("second", "Second"),
        ("pictures", "Pictures"),
    ]
    ordered(
        page,
        "<h1>A fleet</h1>",
        "<p>Made of 3 logs.</p>",
        "<p>Two of them differ.</p>",
        "<p>One got worse.</p>",
        '<strong class="fail">Error.</strong>',
        '<strong class="pass">Warning.</strong>',
        'id="figure-early"',
        "Curve early",
        "<caption>First</caption>",
        '<p class="note">Without offsets.</p>',
        "<caption>Third</caption>",
        "<p>Largest first.</p>",
        "<caption>Second</caption>",
        'id="figure-late"',
    )
    for finding in answer.findings:
        assert finding.sentence in page
    for number in (1, 2):
        assert f"<strong>Figure {number}.</strong>" in page


def test_an_explanation_precedes_the_figures_of_its_section(tmp_path: Path) -> None:
    shown = ["Shares add up to one.", table("Shares")]
    answer = Written(lines=[], shown=shown, drawn=[figure("Shares", "bars")])
    ordered(
        page_of(answer, tmp_path), "<p>Shares add", 'id="figure-bars"', "<caption>Shares</caption>"
    )


def test_missing_parts_leave_no_trace(tmp_path: Path) -> None:
    @dataclass
    class Short(Answer):
        def summary(self) -> str:
            return "Done <b>soon</b>."

    page = page_of(Short(), tmp_path)
    assert "<p>Done &lt;b&gt;soon&lt;/b&gt;.</p>" in page
    assert "<h1>Result</h1>" in page
    assert page.count("<section") == 1
    assert "<p></p>" not in page


def test_an_empty_table_is_none(tmp_path: Path) -> None:
    answer = Written(lines=["Nothing changed."], shown=[table("Alarms", rows=0), "The end."])
    page = page_of(answer, tmp_path)
    assert "<p>None.</p>" in page
    assert "<caption>Alarms" not in page
    ordered(page, '<h2 id="heading-alarms">', '<h2 id="heading-remarks">', "<p>The end.</p>")


def test_the_page_is_reproducible(tmp_path: Path) -> None:
    pages = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        answer = Written(lines=["Done."], shown=[table("One")], drawn=[figure("One", "same")])
        pages.append(page_of(answer, tmp_path / name))
    assert pages[0] == pages[1]
