"""What the laws must reach on the digital twin, trained on the sweep: the shipped study itself."""

import numpy as np
import pytest

from cosim.run import Outcome, run_study
from cosim.scoring import ORACLE, Comparison
from hesr_model.files import models_folder

STUDY = models_folder() / "studies" / "default.toml"

LEAST_GAIN = [0.35, 0.45, 0.45]
"""By which share ParFam-H is below the laws of velocity alone on joints 1 to 3."""


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run_study(STUDY, tmp_path_factory.mktemp("twin") / "uf850")


@pytest.fixture(scope="module")
def fourier(outcome: Outcome) -> Comparison:
    return outcome.comparisons["fourier"]


def errors(scores: Comparison, law: str) -> np.ndarray:
    return np.array([score.rmse for score in scores.laws[law]])


@pytest.mark.parametrize("other", ["parfam_v", "stribeck"])
def test_memory_pays_on_the_fourier_test(fourier: Comparison, other: str) -> None:
    ratio = errors(fourier, "parfam_h") / errors(fourier, other)
    assert np.all(ratio <= 1.0 - np.array(LEAST_GAIN)), ratio


def test_the_extended_law_keeps_up_with_exact_lugre_where_friction_is_bristles(
    fourier: Comparison,
) -> None:
    ratio = errors(fourier, "parfam_hx") / errors(fourier, "lugre")
    assert np.exp(np.mean(np.log(ratio))) <= 1.05, ratio
    assert np.all(ratio <= 1.15), ratio


def test_the_extended_law_beats_the_papers(fourier: Comparison) -> None:
    ratio = errors(fourier, "parfam_hx") / errors(fourier, "parfam_h")
    assert np.exp(np.mean(np.log(ratio))) < 0.95, ratio


def test_both_bands_of_the_chirp_are_scored_for_every_law(outcome: Outcome) -> None:
    low, high = (outcome.comparisons[f"chirp {band}"] for band in ("to 0.6 Hz", "from 0.6 Hz"))
    whole = outcome.comparisons["chirp"]
    assert set(low.laws) == set(high.laws) == set(whole.laws) == {*outcome.models, ORACLE}
    for law in whole.laws:
        between = (errors(low, law), errors(high, law))
        assert np.all(np.minimum(*between) <= errors(whole, law))
        assert np.all(np.maximum(*between) >= errors(whole, law))


def test_on_the_chirp_the_extended_law_extrapolates_as_well_as_the_truth(
    outcome: Outcome,
) -> None:
    """High over low band, in geometric mean: what rises with speed is the rigid body's error."""
    low, high = (outcome.comparisons[f"chirp {band}"] for band in ("to 0.6 Hz", "from 0.6 Hz"))
    extended, truth, paper = (
        np.exp(np.mean(np.log(errors(high, law) / errors(low, law))))
        for law in ("parfam_hx", ORACLE, "parfam_h")
    )
    assert extended <= 1.05 * truth
    assert extended < 0.95 * paper
