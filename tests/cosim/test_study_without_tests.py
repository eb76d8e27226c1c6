"""A study without test sets: laws are judged on left-out rows, and its page says so."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import Containing
from small_study import uf850, write_study

from cosim.report.results import Results
from cosim.study import steps
from cosim.study.run import Outcome, run_study
from cosim.study.study import LEFT_OUT
from cosim.study.verdict import describe_choice
from hesr_model.fitting.estimator import select_laws
from hesr_model.inference.left_out import LeftOutErrors

pytestmark = pytest.mark.ci

TESTED = '[logs.test]\nunseen = ["trial"]\n'
FAILED = "dahl"
MODELS = {*select_laws("baseline"), "stribeck"}


def fail_on_relaxed(judge: Callable[..., LeftOutErrors]) -> Callable[..., LeftOutErrors]:
    """Judge laws as if one of them could not be fitted without a part of the logs."""

    def judge_others(laws: Sequence[str], *arguments: Any, **settings: Any) -> LeftOutErrors:
        others = [law_name for law_name in laws if law_name != FAILED]
        assert len(others) == len(laws) - 1
        return replace(judge(others, *arguments, **settings), failed={FAILED: "no solution."})

    return judge_others


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Outcome]:
    folder = tmp_path_factory.mktemp("untested")
    study = write_study(folder)
    text = study.read_text(encoding="utf-8")
    assert TESTED in text
    assert str(uf850("robot.toml")) in text
    text = text.replace(TESTED, "").replace('parfam_h"]', f'{FAILED}"]')
    options = text.index("[options.parfam_h]")
    text = text[:options] + text[text.index("[twin]") :]
    study.write_text(text.replace("seed = 3", "seed = 3\nfolds = 3"), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps, "judge_laws", fail_on_relaxed(steps.judge_laws))
        yield run_study(study, folder / "results")


@pytest.fixture(scope="module")
def folder(outcome: Outcome) -> Path:
    return outcome.fmus["stribeck"].parents[1]


def test_laws_are_compared_on_left_out_rows_only(outcome: Outcome) -> None:
    (name,) = outcome.comparisons
    assert name == LEFT_OUT
    comparison = outcome.comparisons[name]
    assert set(comparison.laws) >= MODELS
    for law_name in MODELS:
        model = outcome.models[law_name]
        np.testing.assert_allclose(comparison.laws[law_name].rmse, model.left_out_rmse, rtol=0.05)


def test_the_verdict_has_the_figures_of_each_joint(outcome: Outcome, folder: Path) -> None:
    verdict = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    assert verdict["test"] == LEFT_OUT
    choice = verdict["choice"]
    assert choice["base"] in MODELS
    assert choice["fold_count"] == 3
    assert len(choice["joints"]) == 3
    for joint in choice["joints"]:
        assert joint["law_name"] in MODELS
        assert joint["known"] in ("law", "level", "nothing")
        assert 0.0 < joint["low"] <= joint["ratio"] <= joint["high"]
        assert 0.0 < joint["unexplained"] < 1.5
    assert Path(folder / verdict["fmu"]).is_file()
    sentences = outcome.verdict.sentences
    assert "test" not in " ".join(outcome.verdict.limits)
    assert not any(sentence.startswith("Unexplained friction on") for sentence in sentences)


def test_the_page_does_not_speak_of_tests(outcome: Outcome, folder: Path) -> None:
    results = Results.read(folder)
    assert not results.has_tests
    assert results.tests == [LEFT_OUT]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "unseen test" not in page
    assert "Test set" not in page
    assert "the test" not in page
    assert page == Containing("judged on rows of the logs that neither", "laws were judged on rows")
    assert "were fitted without these rows" in page
    assert "that were fitted without it" in page
    # Laws were fitted to all rows, on which they cannot be scored as simulators.
    assert "As simulators" not in page
    assert outcome.verdict.choice is not None
    for sentence in describe_choice(outcome.verdict.choice):
        assert sentence in page


def test_errors_in_the_files_of_logs_are_the_left_out_ones(outcome: Outcome, folder: Path) -> None:
    results = Results.read(folder)
    log = results.find_log(LEFT_OUT)
    assert log is not None
    torques = results.torques(log)
    predicted = torques["stribeck.tau_f1"]
    measured = torques["tau1"] - torques["tau_rb1"]
    rmse = float(np.sqrt(np.mean((predicted - measured) ** 2)))
    assert rmse == pytest.approx(outcome.comparisons[LEFT_OUT].laws["stribeck"].rmse[0])


def test_a_law_that_fails_without_a_part_of_the_logs_is_named(
    outcome: Outcome, folder: Path
) -> None:
    """It has no error on left-out rows, hence no row in tables and no FMU."""
    assert set(outcome.models) == set(outcome.fmus) == MODELS
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f"The law {FAILED} was left out: no solution." in page
