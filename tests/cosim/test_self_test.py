"""The self-test of the sandbox says what holds on this machine."""

import logging
from pathlib import Path

import pytest
from test_foreign_fmus import linux

from fmu_src.check.run import check
from hesr.extras.hostile import sandbox
from hesr_model.support.self_test import find_holes, try_all


@linux
def test_nothing_succeeds_in_a_child_of_this_machine() -> None:
    holes = find_holes()
    assert len(holes) > 10
    assert [deed for deed, succeeds in holes.items() if succeeds] == []


def test_the_same_deeds_succeed_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A control, so that failing there means something; limits of processes are not tried here."""
    monkeypatch.setattr("hesr_model.support.self_test._start_threads", lambda: None)
    monkeypatch.setattr("hesr_model.support.self_test._HUGE", 1 << 20)
    monkeypatch.setattr("os.setpriority", lambda *_: None)
    monkeypatch.chdir(tmp_path)
    outside = tmp_path / "outside"
    outside.write_text("mine", encoding="utf-8")
    failed = [deed for deed, succeeds in try_all(str(outside), 1).items() if not succeeds]
    assert failed in ([], ["signal other processes"])  # an ordinary user may not signal process 1


@pytest.mark.ci
def test_holes_are_findings_of_a_check(
    lag_fmu: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sandbox, "find_holes", lambda: {"fly": True, "swim": False})
    caplog.set_level(logging.INFO)
    problems = check(lag_fmu, kinds=["sandbox"]).problems
    (hole,) = [problem for problem in problems if problem.check == "sandbox"]
    assert "fly" in str(hole.found)
    assert "swim" in caplog.text
