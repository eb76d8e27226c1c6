"""Every figure of the first layer, of the terminal and of the digest is that of a table.

The tables are read from the CSV files of the report; no code of the sentences is called.
"""

import csv
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path
from statistics import fmean

import numpy as np
import pytest

from cosim.report.page import write_report
from cosim.report.results import Results
from cosim.report.tables.scores import errors as errors_table
from cosim.report.tables.scores import separations
from cosim.study.run import write_mixed_model
from cosim.study.scores import ORACLE
from cosim.study.verdict import Verdict, read_verdict, write_verdict
from cosim.workflow.test import _scores_lines
from fmu_src.friction.embedded_model import read_embedded_model
from hesr.extras.reports.digest import write_digest
from hesr_model.friction.model import FrictionModel

JOINTS = ("J1", "J2", "J3")
Rows = dict[str, list[str]]


def first_layer(folder: Path) -> str:
    page = (folder / "report.html").read_text(encoding="utf-8")
    part = page[page.index('id="summary"') : page.index('id="prediction"')]
    return " ".join(unescape(re.sub(r"<svg.*?</svg>|<[^>]+>", " ", part, flags=re.DOTALL)).split())


def table(folder: Path, name: str) -> Rows:
    """Cells of a CSV file by the law or joint of its row."""
    with (folder / "tables" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    skip = head.index("law") if "law" in head else 0
    kept = [k for k, column in enumerate(head) if k > skip and not column.endswith(": note")]
    return {row[skip]: [row[k] for k in kept] for row in rows}


def numbers(row: list[str]) -> list[float]:
    return [float(cell) for cell in row[: len(JOINTS)]]


def found(pattern: str, text: str) -> re.Match[str]:
    match = re.search(pattern, text)
    assert match, f"{pattern} is not in: {text}"
    return match


@pytest.fixture(scope="module")
def text(small_results: Path) -> str:
    return first_layer(small_results)


@pytest.fixture(scope="module")
def words(small_results: Path) -> Verdict:
    verdict = read_verdict(small_results)
    assert verdict
    return verdict


def laws_of(folder: Path) -> Rows:
    """RMSE of the laws that users can run."""
    errors = table(folder, "errors_1")
    return {k: v for k, v in errors.items() if k[0] != "(" and k != "true friction"}


def test_unexplained_shares_are_errors_over_friction(
    small_results: Path, text: str, words: Verdict
) -> None:
    """In the first layer, the terminal's verdict and the sentence of `hesr test`."""
    errors, laws = table(small_results, "errors_1"), laws_of(small_results)
    pick = found(r"Recommended: (.+?) Download fmus/(\w+)\.fmu", text)
    assert pick[2] == words.law
    size = numbers(errors["(std of friction)"])
    shares = [100 * e / s for e, s in zip(numbers(laws[pick[1]]), size, strict=True)]
    summary = numbers([row[1] for row in table(small_results, "joints").values()])
    assert summary == pytest.approx(shares)
    listed = ", ".join(f"{j} {share:.0f} %" for j, share in zip(JOINTS, shares, strict=True))
    assert f"Unexplained friction on 'trial & error': {listed}." in words.sentences
    for joint, share, e in zip(JOINTS, shares, numbers(laws[pick[1]]), strict=True):
        found(rf"{joint} {e:.2f} {share:.0f} %", text)
    means = {law: fmean(np.divide(numbers(row), size)) for law, row in laws.items()}
    best = min(means, key=lambda law: means[law])
    results = Results.read(small_results)
    scores = results.comparisons["trial & error"]
    known = {law: row for law, row in scores.laws.items() if law != ORACLE}
    (first, *_) = _scores_lines(replace(scores, laws=known))
    of_best = [100 * e / s for e, s in zip(numbers(laws[best]), size, strict=True)]
    pairs = zip(results.run.joints, of_best, strict=True)
    assert first.endswith(", ".join(f"{joint} {share:.0f} %" for joint, share in pairs) + ".")
    worst = JOINTS[int(np.argmax(shares))]
    assert f"Friction of {worst}, the joint with the largest unexplained share" in text


def test_weak_joints_are_those_of_the_tables(small_results: Path, words: Verdict) -> None:
    shares = {j: float(row[1]) for j, row in table(small_results, "joints").items()}
    titles = {"parfam_h": "ParFam-H", "stribeck": "Stribeck", "plain": "plain"}
    title = titles[words.law]
    turning = numbers(table(small_results, "errors_reversal_1")[title])
    whole = numbers(laws_of(small_results)[title])
    marks = table(small_results, "properties")
    with (small_results / "tables" / "properties.csv").open(encoding="utf-8") as file:
        checks = next(csv.reader(file))[1:]
    failed = [c for c, cell in zip(checks, marks[title], strict=True) if "fail" in cell]
    pairs = zip(JOINTS, turning, whole, strict=True)
    expected = {
        "Poorly modelled: ": ", ".join(j for j, share in shares.items() if share > 25),
        "Large errors near reversals: ": ", ".join(j for j, at, e in pairs if at > 1.5 * e),
        "Physics checks it fails": ", ".join(failed),
    }
    for start, names in expected.items():
        said = [s for s in words.weak if s.startswith(start)]
        assert bool(said) == bool(names)
        assert not said or said[0].partition(": ")[2].startswith(names)


def test_what_the_test_cannot_separate_is_that_of_its_table(
    small_results: Path, text: str, words: Verdict
) -> None:
    rows = table(small_results, "separations_1")
    laws = laws_of(small_results)
    for row in rows.values():
        recommended, lowest, better, not_separated, *shown = row
        assert {recommended, lowest} <= laws.keys()
        assert better == "none"  # a test of 5 s shows nothing
        assert set(not_separated.split(", ")) == laws.keys() - {recommended}
        assert shown == ["too short", "40 s"]
    assert "record at least 40 s" in text
    # The choice is made by left-out rows, and by nothing of the test.
    assert words.choice is not None
    for joint in words.choice.joints:
        assert f"{joint.ratio:.2f} ({joint.low:.2f} to {joint.high:.2f})" in text


def test_what_was_done_is_counted_in_the_tables(small_results: Path, text: str) -> None:
    laws, errors = laws_of(small_results), table(small_results, "errors_1")
    assert f" {len(laws)} friction laws were fitted" in text
    floor = numbers(errors["true friction"])
    listed = " / ".join(f"{value:.2f}" for value in floor)
    said = found(r"cause (.+?) N\.m; (.+?) is (-?\d+) % above that on average", text)
    above = 100 * (fmean(np.divide(numbers(laws[said[2]]), floor)) - 1)
    assert (said[1], said[3]) == (listed, f"{above:.0f}")
    marks = table(small_results, "properties")
    passed = {
        law: sum("fail" not in c and "not run" not in c for c in row) for law, row in marks.items()
    }
    most = max(passed.values())
    names = ", ".join(law for law, count in passed.items() if count == most)
    count = len(next(iter(marks.values())))
    start = f"Physics checks passed on all joints, of {count}: ParFam-H {passed['ParFam-H']}; "
    assert f"{start}most, {most}: {names}." in text


def test_passive_laws_are_counted_in_the_tables(small_results: Path) -> None:
    page = (small_results / "report.html").read_text(encoding="utf-8")
    energy = table(small_results, "energy")
    none = [law for law, row in energy.items() if numbers(row[:3]) == [0.0] * 3]
    assert f" {len(none)} of {len(energy)} laws give no energy;" in page
    with (small_results / "tables" / "certificates.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))[1:]
    open_ = {law for law, _, said in rows if not said.startswith("passive, proven")}
    assert f"Proven passive on all joints: {len(energy.keys() - open_)}." in page
    assert not any(law in none for law, _, said in rows if said.startswith("not passive"))


def test_bold_errors_are_those_separated_from_all_others() -> None:
    """On each joint, bold if and only if the other table separates all laws."""
    from test_recorded_tables import COMPARISON

    table, other = errors_table("t", COMPARISON), separations("t", COMPARISON)
    assert other
    for k, row in enumerate(other.rows):
        best, tied, *_ = (cell.text for cell in row.cells)
        bold = [str(row.head) for row in table.rows if row.cells and row.cells[k].best]
        assert bold == ([best] if tied == "none" else [])


@pytest.mark.ci
def test_the_digest_repeats_the_tables(small_results: Path, tmp_path: Path) -> None:
    text = write_digest([small_results], tmp_path / "r.md").read_text(encoding="utf-8")
    laws, errors = laws_of(small_results), table(small_results, "errors_1")
    said = found(r"(\S+) leaves (\d+) % .+?; its error is ([\d.]+) times", text)
    size = numbers(errors["(std of friction)"])
    share = 100 * fmean(np.divide(numbers(laws[said[1]]), size))
    references = numbers([row[2] for row in table(small_results, "joints").values()])
    ratio = np.exp(np.mean(np.log(np.divide(numbers(laws[said[1]]), references))))
    assert (said[2], said[3]) == (f"{share:.0f}", f"{ratio:.2f}")


@pytest.mark.ci
def test_a_page_with_a_law_per_joint(small_results: Path, tmp_path: Path) -> None:
    """The results of a run whose joints have different laws, written as the run writes them."""
    folder = shutil.copytree(
        small_results, tmp_path / "results", ignore=shutil.ignore_patterns(".hesr-*")
    )
    results = Results.read(folder)
    old = read_verdict(folder)
    assert old
    laws = ("stribeck", "parfam_h", "parfam_h")
    joints = tuple(replace(one, law=law) for one, law in zip(old.joints, laws, strict=True))
    words = replace(old, law="recommended", fmu="fmus/recommended.fmu", joints=joints)
    write_verdict(folder, words)
    made = write_mixed_model(words, results.models, folder, results.audits, results.properties)
    written = FrictionModel.read(folder / "laws" / "recommended.json")
    assert made == {"recommended": written}
    assert read_embedded_model(folder / words.fmu) == written
    assert [law.name for law in written.laws] == list(laws)
    write_report(folder)
    text = first_layer(folder)
    assert "Recommended: Stribeck on J1; ParFam-H on J2, J3 Download fmus/recommended.fmu" in text
    errors = laws_of(folder)
    rmse = [errors["Stribeck"][0], *errors["ParFam-H"][1 : len(JOINTS)]]
    assert [row[0] for row in table(folder, "joints").values()] == rmse
    own = [row[0] for row in table(folder, "separations_1").values()]
    assert own == ["Stribeck", "ParFam-H", "ParFam-H"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert 'data-law="recommended"' in page
    assert "Stribeck on J1; ParFam-H on J2, J3: figures, reasons and plots" in page
