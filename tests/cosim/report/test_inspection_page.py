"""The page of `hesr inspect`: findings before and after the proposal, and missing figures."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.report.inspection import write_inspection
from hesr_model.findings import Finding
from hesr_model.health.proposal import Proposal, inspect_logs
from hesr_model.logs.robot_log import Log

ERROR = Finding(check="units", found="q is in degrees")
WARNING = Finding(check="load", severity="advice", found="no load is logged")


def page_of(proposal: Proposal, folder: Path) -> str:
    write_inspection(folder / "page.html", proposal)
    return (folder / "page.html").read_text(encoding="utf-8")


@pytest.fixture
def proposal(arm_log: Log, tmp_path: Path) -> Proposal:
    arm_log.write(tmp_path / "log.csv")
    return inspect_logs([tmp_path / "log.csv"])


@pytest.mark.parametrize("left", [[], [WARNING]], ids=["all fixed", "one open"])
def test_open_findings_follow_all_others(
    proposal: Proposal, tmp_path: Path, left: list[Finding]
) -> None:
    examination = replace(proposal.examination, findings=left)
    changed = replace(
        proposal,
        first_findings=[ERROR, WARNING],
        reasons={"units": "a guess"},
        examination=examination,
    )
    page = page_of(changed, tmp_path)
    assert "<p>1 error, 1 warning.</p>" in page
    assert ("fixes all of them" in page) == (not left)
    assert ("Still open with" in page) == bool(left)
    assert page.count(ERROR.sentence) == 1
    assert page.count(WARNING.sentence) == 1 + len(left)


def test_a_log_without_motion_has_no_figure(arm_log: Log, tmp_path: Path) -> None:
    rest = np.zeros_like(arm_log.q)
    replace(arm_log, q=rest + 0.1, dq=rest).write(tmp_path / "rest.csv")
    page = page_of(inspect_logs([tmp_path / "rest.csv"]), tmp_path)
    assert "<p>No joint moves.</p>" in page
    assert "Motion and torque" not in page
    assert "<figure" not in page
    assert "What this log cannot show" in page


def test_the_page_has_the_size_of_each_log(arm_log: Log, tmp_path: Path) -> None:
    """41 rows of 300 ms."""
    short = replace(
        arm_log,
        t=0.3 * np.arange(41),
        **{name: getattr(arm_log, name)[:41] for name in ("q", "dq", "tau")},
    )
    short.write(tmp_path / "short.csv")
    page = page_of(inspect_logs([tmp_path / "short.csv"]), tmp_path)
    (row,) = re.findall(r"<tr[^>]*><th[^>]*>short</th>(.*?)</tr>", page, re.DOTALL)
    cells = re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)
    assert cells == ["41", "12.0", "3.333", "0", "0", "0"]
