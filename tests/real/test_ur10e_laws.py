"""The main task on measured logs: predictions of the FMUs on unseen motions."""

from pathlib import Path

import numpy as np
import pytest

from cosim.study.results import ScoredRun
from cosim.study.run import score_study
from cosim.study.scores import Comparison, compare, predict_models, select_records
from cosim.study.steps import Job
from cosim.study.study import Study
from hesr_model.fitting.estimator import select_laws
from hesr_model.friction.model import FrictionModel
from hesr_model.support import parallel
from hesr_model.support.progress import silent

MOST = {
    "parfam_h": [2.73, 4.08, 1.99, 0.449, 0.826, 0.908],
    "lugre_relaxed": [2.76, 4.04, 1.96, 0.456, 0.732, 0.686],
}
"""RMSE of the predicted torque over all rows of all test logs [N.m], J1 to J6."""
MOST_AT_REVERSALS = {"parfam_h": [3.0, 5.0, 1.95, 0.45, 0.70, 0.60]}
"""RMSE within 0.1 s of reversals."""

STUDY = Path(__file__).with_name("ur10e_study.toml")
STUDIED = ("stribeck", "parfam_h")
VARIANT = "lugre_relaxed"


@pytest.fixture(scope="module")
def outcome(ur10e_data: Path, tmp_path_factory: pytest.TempPathFactory) -> ScoredRun:
    """The study next to this file, with the laws of known figures."""
    whole = Study.read(STUDY)
    variants = {VARIANT: whole.variants[VARIANT]}
    study = whole.model_copy(update={"laws": STUDIED, "variants": variants, "refinement": None})
    with parallel.one_pool():
        job = Job(study=study, path=STUDY, progress=silent)
        return score_study(job, tmp_path_factory.mktemp("ur10e"))


@pytest.fixture(scope="module")
def without_lag(outcome: ScoredRun) -> Comparison:
    """Scores with the velocity of the fits; the bounds are for it."""
    records = select_records(outcome.study.logs.test["test"], outcome.records)
    return compare(records, predict_models(outcome.models, records), {})


def scores(comparison: Comparison, law: str, measure: str) -> list[float]:
    return list(getattr(comparison.laws[law], measure))


def test_scores_of_the_fmus_without_lag_are_those_of_the_laws(
    outcome: ScoredRun, without_lag: Comparison
) -> None:
    for law, found in outcome.comparisons["test"].zero_phase.items():
        np.testing.assert_allclose(found, scores(without_lag, law, "rmse"), rtol=1e-9)


def test_the_test_logs_are_the_known_ones(outcome: ScoredRun) -> None:
    spread = outcome.comparisons["test"].tau_std
    np.testing.assert_allclose(spread, [27.6, 23.9, 11.7, 4.33, 4.25, 3.73], rtol=0.005)


@pytest.mark.parametrize("law", MOST)
def test_torque_is_predicted_on_unseen_motions(without_lag: Comparison, law: str) -> None:
    np.testing.assert_array_less(scores(without_lag, law, "rmse"), np.nextafter(MOST[law], np.inf))


@pytest.mark.parametrize("law", MOST_AT_REVERSALS)
def test_torque_is_predicted_around_reversals(without_lag: Comparison, law: str) -> None:
    most = np.nextafter(MOST_AT_REVERSALS[law], np.inf)
    np.testing.assert_array_less(scores(without_lag, law, "rmse_reversal"), most)


def test_a_state_reduces_the_error_at_reversals(without_lag: Comparison) -> None:
    """The purpose of the hysteresis state: J1 to J6 improve by at least 10 %."""
    with_state = np.array(scores(without_lag, "parfam_h", "rmse_reversal"))
    without = np.array(scores(without_lag, "stribeck", "rmse_reversal"))
    assert np.all(with_state < 0.9 * without)


def test_everything_is_written(outcome: ScoredRun) -> None:
    assert set(outcome.fmus) == {*select_laws("baseline"), *STUDIED, VARIANT}
    for law, fmu in outcome.fmus.items():
        assert fmu.is_file()
        assert FrictionModel.read(fmu.parents[1] / "laws" / f"{law}.json") == outcome.models[law]
    folder = outcome.fmus["parfam_h"].parents[1]
    assert {"rigid_body.json", "evaluation.json", "laws", "fmus"} <= {
        path.name for path in folder.iterdir()
    }
