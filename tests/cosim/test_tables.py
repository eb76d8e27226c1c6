"""Tables: defined once, complete in a terminal of 80 columns, with the same figures on a page."""

import re
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import Tracked
from cosim.report.markup import table as page
from cosim.report.tables import laws, loop, scores
from cosim.report.tables.table import ResultTable, TableRow, number
from cosim.report.tables.terminal import TerminalTable
from cosim.study.scores import Comparison, LawScores, Ratios
from hesr_model.audit.properties import (
    EXPECTATIONS,
    Figure,
    JointProperties,
    Properties,
    PropertyResult,
)
from hesr_model.friction.records import BandScore
from hesr_model.inference.comparison import ErrorRatio

LONG = "a variant of the extended law without ripple and without an estimated start"
LAWS = ("lugre", "lugre_load_ripple", "parfam_hx", LONG, "anamewithoutanyblanks" * 3)


def terminal(table: ResultTable, width: int = 80) -> str:
    out = StringIO()
    Console(file=out, width=width).print(TerminalTable(table))
    assert max(map(len, out.getvalue().splitlines())) <= width
    assert "…" not in out.getvalue()
    return out.getvalue()


def comparison(joints: int) -> Comparison:
    """Distinct numbers, so that each can be searched for."""
    rng = np.random.default_rng(joints)

    def errors() -> tuple[float, ...]:
        return tuple(rng.uniform(100.0, 999.0, joints))

    return Comparison(
        joints=tuple(f"j{k}" for k in range(joints)),
        tau_std=errors(),
        laws={
            law: LawScores(
                rmse=errors(), rmse_reversal=errors(), rmse_moving=errors(), r2=(0.5,) * joints
            )
            for law in LAWS
        },
        ratios=Ratios(
            reference="lugre",
            laws={
                law: tuple(ErrorRatio(value=r / 11.0, low=r / 13.0, high=r / 7.0) for r in errors())
                for law in LAWS[1:]
            },
        ),
    )


@pytest.mark.parametrize("joints", [1, 3, 6, 7, 13])
@pytest.mark.parametrize("measure", scores.MEASURES)
def test_no_figure_of_many_joints_is_cut(joints: int, measure: str) -> None:
    found = comparison(joints)
    text = terminal(scores.errors("unseen", found, measure))
    assert re.findall(r"\bJ\d+", text) == [f"J{k}" for k in range(1, joints + 1)]
    figures = [f"{value:.0f}" for law in found.laws.values() for value in getattr(law, measure)]
    if measure == "rmse":
        ratios = [r for of_law in found.ratios.laws.values() for r in of_law]
        figures += [f"{r.value:.2f}" for r in ratios]
        figures += [f"{r.low:.2f}–{r.high:.2f}" for r in ratios]
        figures += [f"{s:.0f}" for s in found.tau_std]
    for figure in figures:
        assert re.search(rf"(?<![\d.]){re.escape(figure)}(?![\d.])", text), figure


@pytest.mark.parametrize("joints", [1, 6, 7])
def test_coverage_is_shown_for_every_joint(joints: int) -> None:
    rng = np.random.default_rng(joints)
    bands = tuple(
        BandScore(held=held, held_moving=moving, held_reversal=None, least_log=0.5, width=width)
        for held, moving, width in rng.uniform(0.2, 0.99, (joints, 3))
    )
    text = terminal(scores.bands("unseen", replace(comparison(joints), bands={"lugre": bands})))
    for band in bands:
        assert f"{100.0 * band.held:.1f}" in text
        assert f"{100.0 * (band.held_moving or 0.0):.0f}" in text
        assert f"× {band.width:.2f}" in text
    assert text.count("–") == joints


def test_names_are_wrapped_without_loss() -> None:
    text = terminal(scores.errors("unseen", comparison(7)))
    (head,) = (line for line in text.splitlines() if re.search(r"\bJ1\b", line))
    heads = "".join(line[: head.index("J1") - 6] for line in text.splitlines())
    letters = re.sub(r"[\s\d.–]", "", heads)
    assert LAWS[-1] in letters
    assert LONG.replace(" ", "") in letters


def test_page_and_terminal_show_the_same_figures() -> None:
    table = scores.errors("unseen", comparison(4))
    html = str(page(table))
    for row in table.rows:
        for cell in row.cells:
            assert cell.text in terminal(table)
            assert f">{cell.text}</td>" in html
            assert f">{cell.side_note}</td>" in html


def findings(joints: int, keys: list[str]) -> Properties:
    rng = np.random.default_rng(joints)
    return Properties(
        law="x",
        robot="bench",
        tau_load=0.0,
        joints=tuple(
            JointProperties(
                joint=f"j{k}",
                speed=1.0,
                level=1.0,
                deflection=1e-3,
                inertia=None,
                findings={
                    key: PropertyResult(
                        verdict="pass" if (k + place) % 3 else "fail",
                        figures=(Figure(name="x", value=float(rng.uniform(1.0, 9.0)), unit="1"),),
                    )
                    for place, key in enumerate(keys)
                },
            )
            for k in range(joints)
        ),
    )


def test_thirteen_experiments_are_split_into_two_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than fit side by side; every figure has its mark."""
    last = EXPECTATIONS["coupling"]
    more = {f"own{k}": replace(last, key=f"own{k}", short=f"own{k}") for k in range(3)}
    monkeypatch.setattr(laws, "EXPECTATIONS", EXPECTATIONS | more)
    keys = list(laws.EXPECTATIONS)
    table = laws.properties(dict.fromkeys(LAWS, findings(7, keys)))
    text = terminal(table)
    shorts = [e.short for e in laws.EXPECTATIONS.values()]
    heads = [line.split() for line in text.splitlines() if line.startswith("law ")]
    assert len(heads) > 1
    assert [name for head in heads for name in head[1:]] == shorts
    marked = re.findall(r"(?<!\S)(\S+)([✓✗])(?!\S)", text)
    assert len(marked) == len(LAWS) * len(keys) * 7
    cells = [cell for row in table.rows for cell in row.cells]
    expected = sorted(line for cell in cells for line in cell.text.split("\n"))
    assert sorted(figure for figure, _ in marked) == expected
    assert page(table).count('class="pass"') == sum(mark == "✓" for _, mark in marked)


def test_unavailable_results_are_stated_once_on_a_page() -> None:
    found = findings(3, list(EXPECTATIONS))
    none = PropertyResult(verdict="not applicable", reason="No states.")
    joints = tuple(replace(j, findings={**j.findings, "hold": none}) for j in found.joints)
    table = laws.properties({"x": replace(found, joints=joints)})
    assert page(table).count(">n/a<") == 1
    assert terminal(table).count("n/a") == 3


def tracked(scheme: Scheme, law: str, joints: int) -> Tracked:
    rng = np.random.default_rng(len(law) + joints)
    rmse = rng.uniform(0.001, 0.5, (4, joints))
    return Tracked(scheme=scheme, law=law, rmse=rmse, last=rmse / 7.0)


@pytest.mark.parametrize("joints", [3, 7, 13])
def test_a_closed_loop_of_many_joints_is_complete(joints: int) -> None:
    scheme = Scheme(compensation="servo_inversion", Kx=5.0, source="filtered")
    rows = [tracked(scheme, law, joints) for law in (*StandIn, *LAWS)]
    lost = replace(rows[-1], rmse=np.full((1, joints), np.nan), last=np.full((1, joints), np.nan))
    text = terminal(loop.tracking("Tracking", [*rows, lost]))
    for row in rows:
        for spread in row.spread:
            assert f"{1e3 * spread:.3g}" in text
    assert text.count("stopped") == joints
    assert "servo inversion, Kx = 5" in text


@pytest.mark.parametrize(("smallest", "decimals"), [(0.42e-3, 2), (4.2e-3, 1), (0.42, 0)])
def test_a_column_shows_two_digits_of_its_smallest_error(smallest: float, decimals: int) -> None:
    rows = []
    for error in (smallest, 2.0 * smallest):
        rmse = np.array([[error, 0.01]])
        scheme = Scheme(compensation="none")
        rows.append(Tracked(scheme=scheme, law="lugre", rmse=rmse, last=rmse))
    assert loop.places(rows) == [decimals, 0]


def test_changes_of_an_arm_are_grouped_by_scheme() -> None:
    schemes = [Scheme(compensation="none"), Scheme(compensation="servo_inversion", Kx=5.0)]
    rows = [
        tracked(replace(scheme, change=change), law, 7)
        for scheme in schemes
        for change in ("as it is", "payload 5 kg, identified")
        for law in LAWS
    ]
    tables = loop.sweeps(rows)
    assert [len(t.rows) for t in tables] == [2, 2]
    for table, scheme in zip(tables, schemes, strict=True):
        assert table.caption.startswith(scheme.title)
        worst = [row.mean.max() for row in rows if replace(row.scheme, change="") == scheme]
        assert [cell.value for row in table.rows for cell in row.cells] == pytest.approx(
            [1e3 * error for error in worst]
        )
        terminal(table)


def test_markup_in_a_name_is_escaped() -> None:
    table = ResultTable(
        caption="[bold]x[/] <b>",
        head=("[red]", "[/]"),
        rows=[TableRow(head="[i] <i>", cells=[number(1.0)])],
    )
    text = terminal(table)
    for name in ("[bold]x[/] <b>", "[red]", "[/]", "[i] <i>"):
        assert name in text
    assert "<b>" not in page(table)
