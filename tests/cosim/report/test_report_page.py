"""The report: sections, numbers, files, missing data and errors."""

import base64
import hashlib
import json
import os
import re
import shutil
import sys
from collections.abc import Callable
from html import escape, unescape
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import markupsafe
import numpy as np
import pandas as pd
import pytest
from containing import Containing, OneSentence
from small_study import Hesr, hesr_here

from cosim.report.markup import Tables
from cosim.report.page import _relative_link, write_report
from cosim.report.results import Results
from cosim.report.sections.summary import errors as summary_errors
from cosim.report.tables.table import ResultTable
from cosim.study.results import read_findings
from cosim.study.verdict import read_verdict
from hesr_model.errors import HesrError
from hesr_model.support.extras import install_command

Json = dict[str, Any]

__all__ = ["hesr_here"]

SECTIONS = ["summary", "prediction", "loop", "physics", "data", "laws", "settings"]
PARTS = ["chirp", "loops", "robustness", "following", "audit", "body", "hysteresis", "ablation"]
PARTS += ["live"]
MOST_BYTES, MOST_TABLES = 3e6, 25


class Page(HTMLParser):
    """The parts of a page that the tests use."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text = path.read_text(encoding="utf-8")
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.tags if name == tag]

    @property
    def sections(self) -> list[str | None]:
        return [a["id"] for a in self.of("section") if "aria-labelledby" in a]

    @property
    def parts(self) -> list[str | None]:
        return [a["id"] for a in self.of("h3") if "id" in a]

    @property
    def files(self) -> list[str]:
        """Links to files next to the page."""
        return [str(a["href"]) for a in self.of("a") if not str(a["href"]).startswith("#")]

    @property
    def figures(self) -> list[str]:
        ids = [str(a["id"]) for a in self.of("figure") if "id" in a]
        return [name.removeprefix("figure-") for name in ids if name.startswith("figure-")]

    def table(self, caption: str) -> list[list[float]]:
        """The numbers of the first table whose caption contains a text, row by row."""
        start = re.search(rf"<caption>[^<]*{re.escape(caption)}", self.text).start()
        body = self.text[start : self.text.index("</table>", start)]
        rows = [re.findall(r'data-value="([^"]+)"', row) for row in body.split("<tr")[1:]]
        return [[float(cell) for cell in row] for row in rows if row]


def whole(*values: object) -> Any:
    """Values of a test on the whole study."""
    return pytest.param("whole", *values, marks=pytest.mark.ci)


of_a_whole_study = pytest.mark.parametrize("results", [whole()], indirect=True)
of_a_part = pytest.mark.parametrize(
    "results", [pytest.param("part", marks=pytest.mark.ci)], indirect=True
)
"""For tests of what does not depend on the sections, whose pages are quicker to build."""


@pytest.fixture
def copied(results: Path, tmp_path: Path) -> Path:
    unfinished = shutil.ignore_patterns(".hesr-*")  # of another test
    return shutil.copytree(results, tmp_path / "copied", ignore=unfinished)


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def edit(path: Path, change: Callable[[Json], object]) -> None:
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


@of_a_whole_study
def test_a_run_ends_with_its_report(results: Path) -> None:
    page = Page(results / "report.html")
    assert page.sections == SECTIONS
    assert page.parts == PARTS
    drawn = {path.stem for path in (results / "figures").iterdir()}
    assert {path.suffix for path in (results / "figures").iterdir()} == {".pdf", ".png"}
    assert set(page.figures) == drawn | {"controller"}
    assert len(page.figures) == len(set(page.figures))


def test_the_page_runs_its_own_scripts_only(results: Path) -> None:
    text = Page(results / "report.html").text
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]+)"', text)
    assert policy.startswith("default-src 'none'; ")
    assert not re.search(
        r"https?:|\*|'unsafe-(eval|hashes)'|script-src[^;]*'unsafe-inline'", policy
    )
    for script in re.findall(r"<script>(.*?)</script>", text, re.DOTALL):
        found = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{found}'" in policy


def test_the_page_is_small_and_has_few_tables(results: Path) -> None:
    page = Page(results / "report.html")
    assert len(page.text.encode()) < MOST_BYTES
    assert len(page.of("table")) <= MOST_TABLES
    assert len(page.of("details")) > len(page.sections) - 1


def test_each_section_links_its_tables(results: Path) -> None:
    page = Page(results / "report.html")
    linked = {Path(link).name for link in page.files}
    unlinked = {path.name for path in (results / "tables").iterdir()} - linked
    assert unlinked <= {"joints.csv", "recommendation.csv"}


def test_the_first_layer_names_the_law_and_links_to_its_fmu(results: Path) -> None:
    page = Page(results / "report.html")
    first = page.text[page.text.index('id="summary"') : page.text.index('id="prediction"')]
    found = read_verdict(results)
    assert found is not None
    assert f'<a class="download" href="{found.fmu}" download>' in first
    for sentence in (found.why[1:], *found.limits, *found.weak, *found.improve):
        assert escape(sentence, quote=False).replace("'", "&#39;") in first
    count = len(read_findings(results))
    assert (f"{count} warning" if count else "No warnings about data and fits.") in first
    assert first.count("<table") == 2  # the recommended laws, and their errors
    assert page.figures[0] == "prediction"


def test_the_errors_of_the_first_layer_are_against_the_strongest_reference(results: Path) -> None:
    comparison = next(iter(Results.read(results).comparisons.values()))
    shown = summary_errors(Results.read(results), ("parfam_h",) * 3)
    assert shown.head == ["joint", "RMSE", "unexplained", "reference", "ratio"]
    columns = list(zip(*(row.cells for row in shown.rows), strict=True))
    values = [[getattr(cell, "value", None) for cell in column] for column in columns]
    own, other = (comparison.laws[law].rmse for law in ("parfam_h", "stribeck"))
    share = np.divide(own, comparison.tau_std)
    assert values[0] == list(own)
    assert values[1] == pytest.approx(100.0 * share)
    assert values[2] == list(other)
    assert values[3] == pytest.approx(np.divide(own, other))
    turned = summary_errors(Results.read(results), ("stribeck",) * 3)
    assert [row.cells[3].value for row in turned.rows] == pytest.approx(np.divide(other, own))


@of_a_whole_study
def test_every_table_is_a_csv_file_with_the_same_data(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    described: dict[str, ResultTable] = {}
    csv = Tables.csv

    def kept(tables: Tables, shown: ResultTable, name: str) -> str:
        assert f"{name}.csv" not in described
        described[f"{name}.csv"] = shown
        return csv(tables, shown, name)

    monkeypatch.setattr(Tables, "csv", kept)
    page = Page(write_report(results, tmp_path / "page.html"))
    files = {path.name for path in (results / "tables").iterdir()}
    assert set(described) == files
    captions = re.findall(r"<caption>([^<]+)</caption>", page.text)
    assert {unescape(one) for one in captions} <= {one.caption for one in described.values()}
    for name, shown in described.items():
        read = pd.read_csv(results / "tables" / name, keep_default_na=False, dtype=str)
        rows = [row for row in shown.rows if row.cells]
        assert len(read) == len(rows), name
        for k, head in enumerate(shown.head[1:]):
            column = (
                read.iloc[:, list(read.columns).index(head, 1)] if head else read.iloc[:, k + 1]
            )
            for text, row in zip(column, rows, strict=True):
                value = row.cells[k].value
                assert value is None or float(text) == value, (name, head)


def test_the_page_is_self_contained(results: Path) -> None:
    page = Page(results / "report.html")
    for tag, attrs in page.tags:
        assert tag not in ("link", "img", "iframe", "base", "object"), tag
        assert "src" not in attrs
        to = str(attrs.get("href") or attrs.get("xlink:href") or "#")
        # Links to files next to the page are allowed; the page loads none of them.
        beside = tag == "a" and ".." not in to and (results / to).is_file()
        assert to.startswith("#") or beside, attrs
    targets = [str(a["href"]) for a in page.of("a") if str(a["href"]).startswith("#")]
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert len(ids) == len(set(ids))
    assert {t.removeprefix("#") for t in targets} <= set(ids)
    assert str(results.parent) not in page.text


def test_headings_are_in_order_and_parts_have_names(results: Path) -> None:
    page = Page(results / "report.html")
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    drawings = [a for a in page.of("div") if str(a.get("class")).startswith("drawing")]
    assert len(drawings) == len(page.figures)
    assert all(len(str(a["aria-label"])) > 40 for a in drawings)
    captions = re.findall(r"<caption>([^<]+)</caption>", page.text)
    assert page.text.count('class="copy"') == len(captions)


@of_a_whole_study
def test_numbers_match_the_saved_results(results: Path) -> None:
    page = Page(results / "report.html")
    scores = json.loads((results / "evaluation.json").read_text())["trial & error"]
    rows = page.table("trial &amp; error: RMSE of the predicted torque [N.m] over all rows")
    assert rows[0] == scores["tau_std"]
    errors = {name: law["rmse"] for name, law in scores["laws"].items()}
    without_lag = {  # not of the true friction
        name: [float(np.exp(np.mean(np.log(np.divide(zero, errors[name])))))]
        for name, zero in scores["zero_phase"].items()
    }
    expected = sorted([*rmse, *without_lag.get(name, [])] for name, rmse in errors.items())
    for row, own in zip(sorted(rows[1:]), expected, strict=True):
        n = len(rows[0])
        assert row[:n] == own[:n]
        assert row[n:] == pytest.approx(own[n:])
    tracked = json.loads((results / "closed_loop.json").read_text())["tracking"]
    shown = page.table("mean over the motions, servo inversion")
    of_body = next(
        t for t in tracked if (t["scheme"], t["law"]) == ("servo_inversion", "(rigid body only)")
    )
    assert shown[0][:3] == pytest.approx([1e3 * e for e in of_body["rmse"][0]])


@of_a_whole_study
def test_names_are_escaped(results: Path) -> None:
    text = Page(results / "report.html").text
    assert "first &lt;half&gt;" in text
    assert "<half>" not in text


@of_a_whole_study
def test_the_page_is_reproducible(results: Path, tmp_path: Path) -> None:
    page = write_report(results, tmp_path / "page.html")
    home = f'href="{quote(os.path.relpath(results, tmp_path))}/'.encode()
    equal = page.read_bytes().replace(home, b'href="') == (results / "report.html").read_bytes()
    assert equal  # a difference of megabytes takes hours to print
    assert_links_lead(page, results)


def assert_links_lead(page: Path, results: Path) -> None:
    links = re.findall(r'href="([^"#:]+)"', page.read_text(encoding="utf-8"))
    files = {(page.parent / unquote(link)).resolve() for link in links}
    assert results.resolve() / "tables/index.csv" in files
    assert results.resolve() / "fmus/stribeck.fmu" in files
    assert [file for file in files if not file.is_file()] == []


@of_a_part
def test_links_of_a_page_elsewhere_lead_to_the_results(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a b").mkdir()
    for name in ("page.html", "a b/page.html"):
        monkeypatch.chdir(tmp_path)
        assert_links_lead(write_report(results, Path(name)), results)


def test_links_to_another_drive_are_absolute(monkeypatch: pytest.MonkeyPatch) -> None:
    def relpath(path: Path, start: Path) -> str:
        raise ValueError(f"path is on mount {path!r}, start on mount {start!r}")

    monkeypatch.setattr(os.path, "relpath", relpath)
    assert _relative_link(Path("/a"), Path("/b c")) == "file:///b%20c/"


@of_a_whole_study
def test_measured_logs_have_neither_loop_nor_truth(copied: Path) -> None:
    edit(copied / "run.json", lambda run: run.update(twin=False, controller={}, robot="other"))

    def without_truth(scores: Json) -> None:
        for comparison in scores.values():
            del comparison["laws"]["true friction"]
            del comparison["ratios"]["laws"]["true friction"]

    edit(copied / "evaluation.json", without_truth)
    for name in ("closed_loop.json", "closed_loop.npz", "following.json", "properties.json"):
        (copied / name).unlink()
    page = Page(write_report(copied))
    assert page.sections == [s for s in SECTIONS if s != "loop"]
    assert "Thirteen experiments" not in page.text
    assert "The logs were measured. The true friction is not known" in page.text
    assert "paper_prediction.csv" not in page.text


@of_a_part
def test_logs_of_one_name_in_two_folders_keep_their_hashes(copied: Path) -> None:
    def renamed(run: Json) -> None:
        for k, log in enumerate(run["logs"][:2]):
            log.update(name=f"d{k}/log.csv", file=f"d{k}/log.csv", sha256=f"{k}" * 64)

    edit(copied / "run.json", renamed)
    page = Page(write_report(copied))
    for k in range(2):
        assert f"d{k}/log.csv" in page.text
        assert f"{k}" * 64 in (copied / "tables/hashes.csv").read_text(encoding="utf-8")


@of_a_whole_study
def test_only_the_live_plots_need_fmus(copied: Path) -> None:
    shutil.rmtree(copied / "fmus")
    page = Page(write_report(copied))
    assert page.sections == SECTIONS
    assert page.parts == [part for part in PARTS if part != "live"]
    assert 'class="download"' not in page.text


@of_a_part
def test_without_bokeh_the_page_says_so(
    copied: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    before = Page(copied / "report.html")
    assert before.text.count('class="to-zoom"') > 1
    monkeypatch.setitem(sys.modules, "bokeh", None)
    after = Page(write_report(copied))
    assert after.text.count('class="to-zoom"') == after.text.count('class="zoom"') == 0
    assert (
        f"Figures zoom after <code>{markupsafe.escape(install_command('report'))}</code>"
        in after.text
    )
    assert caplog.messages == [Containing(f"zoom: {install_command('report')}")]
    assert (after.parts, after.figures) == (before.parts, before.figures)


@of_a_whole_study
def test_variants_make_an_ablation(results: Path) -> None:
    text = Page(results / "report.html").text
    assert "RMSE [N.m] of the variants, each" in text


@of_a_part
def test_the_command_rebuilds_the_page(hesr: Hesr, results: Path) -> None:
    page = results / "rebuilt.html"
    try:
        answer = hesr("report", results, "-o", page)
        assert (answer.code, answer.err) == (0, "")
        assert answer.out == f"Written: {page}\n"
        equal = page.read_bytes() == (results / "report.html").read_bytes()
    finally:
        page.unlink()
    assert equal  # a difference of megabytes takes hours to print


def test_a_folder_without_results_is_refused(hesr: Hesr, tmp_path: Path) -> None:
    for folder, why in (
        (tmp_path, "'run.json' is missing in it"),
        (tmp_path / "none", "the folder does not exist"),
    ):
        answer = hesr("report", folder)
        assert (answer.code, answer.out) == (2, "")
        assert answer.err == f"hesr: {folder}: no results of 'hesr run'; {why}.\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("results", "name", "said"),
    [
        ("part", "evaluation.json", "{path}: no such file."),
        ("part", "rigid_body.json", "{path}: no such file."),
        ("part", "laws/parfam_h.json", "{path}: no such file."),
        whole("closed_loop.json", "{path}: no such file."),
        whole("closed_loop.npz", "{path}: no such file; "),
        whole("traces/torques_3.npz", "{path}: no such log file."),
    ],
    indirect=["results"],
)
def test_a_missing_file_is_named(copied: Path, name: str, said: str) -> None:
    before = (copied / "report.html").read_bytes()
    (copied / name).unlink()
    with pytest.raises(HesrError) as error:
        write_report(copied)
    assert str(error.value).startswith(said.format(path=copied / name))
    assert (copied / "report.html").read_bytes() == before


@pytest.mark.parametrize(
    ("results", "name", "said"),
    [
        ("part", "run.json", "not a readable JSON file"),
        ("part", "evaluation.json", "not a readable JSON file"),
        whole("closed_loop.json", "not a readable JSON file"),
        whole("closed_loop.npz", "file of closed-loop traces"),
        ("part", "properties.json", "not a readable JSON file"),
        whole("traces/torques_1.npz", "cannot be read as NumPy arrays without objects."),
    ],
    indirect=["results"],
)
def test_a_damaged_file_is_named(copied: Path, name: str, said: str) -> None:
    whole = (copied / name).read_bytes()
    (copied / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(HesrError) as error:
        write_report(copied)
    assert str(error.value) == OneSentence(f"{copied / name}: ", said)


@pytest.mark.parametrize(
    ("results", "name", "change", "said"),
    [
        (
            "part",
            "run.json",
            lambda d: d.update(format="x"),
            "'format' is 'x', expected 'hesr-run-1'.",
        ),
        ("part", "run.json", lambda d: d.pop("logs"), "key 'logs' is missing."),
        ("part", "run.json", lambda d: d.update(more=1), "not the description of a run"),
        (
            "part",
            "evaluation.json",
            lambda d: d.clear(),
            "run (it has no test set)",
        ),
        ("part", "evaluation.json", lambda d: d["unseen"].pop("laws"), "key 'laws' is missing."),
        ("part", "evaluation.json", lambda d: d.update(unseen=1), "not the scores of a run"),
        whole("closed_loop.json", lambda d: d.pop("long"), "key 'long' is missing."),
        whole("closed_loop.json", lambda d: d.update(long=[1]), "not the closed loop of a run"),
    ],
    indirect=["results"],
)
def test_errors_in_a_file_are_reported(
    copied: Path,
    name: str,
    change: Callable[[Json], object],
    said: str,
) -> None:
    edit(copied / name, change)
    with pytest.raises(HesrError) as error:
        Results.read(copied)
    assert str(error.value) == OneSentence(f"{copied / name}: ", said)


@of_a_part
def test_an_unwritable_page_is_reported(hesr: Hesr, results: Path, tmp_path: Path) -> None:
    answer = hesr("report", results, "-o", tmp_path)
    assert answer.code == 2
    assert answer.err == f"hesr: {tmp_path}: cannot be written there (Is a directory).\n"
