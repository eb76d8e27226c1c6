"""Comparison of laws on the same logs: size, intervals, power and minimum duration."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hesr_model.inference.comparison import (
    MIN_DEGREES,
    SIGNIFICANCE,
    LawErrors,
    adjust_by_holm,
    calibration,
    law_errors,
)

PERIOD = 0.01


def errors(
    seed: int, laws: int, logs: int, seconds: float, *, memory: float = 0.9, common: float = 0.0
) -> dict[str, list[np.ndarray]]:
    """Autocorrelated errors with a part common to all laws and an RMSE of 1."""
    rng = np.random.default_rng(seed)
    scale = np.sqrt(1.0 - memory**2)

    def series() -> np.ndarray:
        return lfilter([scale], [1.0, -memory], rng.normal(size=int(seconds / PERIOD)))

    shared = [series() for _ in range(logs)]
    own, joint = np.sqrt(1.0 - common), np.sqrt(common)
    return {f"law_{k}": [own * series() + joint * s for s in shared] for k in range(laws)}


def compared(of: dict[str, list[np.ndarray]]) -> LawErrors:
    return law_errors(of, [PERIOD] * len(next(iter(of.values()))))


def worse(found: LawErrors) -> set[str]:
    ratios = found.ratios(found.laws[found.best])
    adjusted = adjust_by_holm({law: r.p for law, r in ratios.items() if r.p is not None})
    return {law for law, p in adjusted.items() if p < SIGNIFICANCE}


def test_the_ratio_is_the_rmse_ratio_over_all_rows() -> None:
    of = errors(0, 2, 3, 17.3)
    rmse = [np.sqrt(np.mean(np.concatenate(logs) ** 2)) for logs in of.values()]
    ratio = compared(of).ratios("law_1")["law_0"]
    assert ratio.value == pytest.approx(rmse[0] / rmse[1], rel=1e-12)
    other = compared(of).ratios("law_0")["law_1"]
    assert other.value == pytest.approx(1.0 / ratio.value)
    assert other.p == pytest.approx(ratio.p)


@pytest.mark.parametrize(("logs", "seconds", "degrees"), [(1, 40, 5), (4, 20, 11), (2, 7.9, 1)])
def test_degrees_of_freedom_grow_with_duration_and_logs(
    logs: int, seconds: float, degrees: int
) -> None:
    found = compared(errors(0, 3, logs, seconds))
    assert found.degrees == degrees
    assert found.too_short == (degrees < MIN_DEGREES)
    assert found.is_between.sum() == logs - 1


def test_a_long_memory_costs_degrees_of_freedom() -> None:
    assert compared(errors(0, 3, 1, 200.0)).degrees == 25
    assert compared(errors(0, 3, 1, 200.0, memory=0.999)).degrees < 12


def test_rows_are_orthogonal_to_the_mean_and_have_the_variance_of_a_bin() -> None:
    """White errors: the mean square of a row is the variance of the influence of one bin."""
    of = errors(1, 2, 4, 400.0, memory=0.0)
    found = compared(of)
    squares = np.concatenate(of["law_0"]) ** 2
    bins = squares.reshape(-1, 5).mean(axis=1) / (2.0 * squares.mean())
    assert np.mean(found.rows[:, 0] ** 2) == pytest.approx(np.var(bins), rel=0.25)
    constant = {
        law: [np.full(4000, size) for _ in range(3)] for law, size in (("a", 1.0), ("b", 2.0))
    }
    assert np.abs(compared(constant).rows).max() < 1e-9


@pytest.mark.parametrize(("logs", "seconds"), [(1, 40.0), (4, 20.0)])
def test_size_and_coverage_for_equal_laws(logs: int, seconds: float) -> None:
    wrong, held = [], []
    for seed in range(300):
        found = compared(errors(seed, 6, logs, seconds, common=0.5))
        wrong.append(bool(worse(found)))
        ratio = found.ratios("law_0")["law_1"]
        assert ratio.low is not None
        assert ratio.high is not None
        held.append(ratio.low <= 1.0 <= ratio.high)
    # 300 draws: limits are three standard errors above 5 % and below 95 %.
    assert np.mean(wrong) <= 0.09
    assert np.mean(held) >= 0.91


def test_the_power_at_the_stated_difference_is_as_stated() -> None:
    hits = []
    for seed in range(150):
        of = errors(seed, 4, 1, 80.0, common=0.5)
        stated = compared(of).ratios("law_0")["law_1"].detectable
        assert stated is not None
        fresh = errors(10_000 + seed, 4, 1, 80.0, common=0.5)
        larger = {
            law: [e * (1.0 if law == "law_0" else stated) for e in logs]
            for law, logs in fresh.items()
        }
        hits.append("law_1" in worse(compared(larger)))
    assert 0.7 <= np.mean(hits) <= 0.93


def test_the_stated_duration_resolves_the_ratio() -> None:
    short = errors(5, 4, 1, 40.0, common=0.5)
    seconds = compared(short).required_seconds("law_1", "law_0", 1.1)
    assert seconds > 40.0
    hits = []
    for seed in range(40):
        of = errors(20_000 + seed, 4, 1, seconds, common=0.5)
        larger = {
            law: [e * (1.0 if law == "law_0" else 1.1) for e in logs] for law, logs in of.items()
        }
        hits.append("law_1" in worse(compared(larger)))
    assert np.mean(hits) >= 0.55


def test_short_logs_give_a_value_without_interval() -> None:
    ratio = compared(errors(0, 3, 2, 9.0)).ratios("law_0")["law_1"]
    assert (ratio.low, ratio.high, ratio.p, ratio.detectable) == (None,) * 4
    assert ratio.value > 0.0


def test_equal_predictions_are_equal() -> None:
    of = errors(0, 1, 1, 80.0)
    found = compared(of | {"copy": of["law_0"]})
    ratio = found.ratios("copy")["law_0"]
    assert (ratio.value, ratio.low, ratio.high, ratio.p) == (1.0, 1.0, 1.0, 1.0)
    assert worse(found) == set()


def test_holms_adjustment() -> None:
    assert adjust_by_holm({"a": 0.01, "b": 0.04, "c": 0.03}) == {"a": 0.03, "b": 0.06, "c": 0.06}


def test_factor_on_p_grows_with_the_number_of_laws() -> None:
    assert [calibration(n, 5.0) for n in (1, 8, 16)] == [6.5, 6.5, 13.0]
    assert calibration(8, 50.0) == pytest.approx(5.15)
    of = errors(0, 2, 1, 80.0, common=0.9)
    found = compared(of | {"law_1": [1.3 * e for e in of["law_1"]]})
    few, many = (found.ratios("law_0", family)["law_1"] for family in (8, 16))
    assert few.p is not None
    assert 0.0 < few.p < 0.5
    assert many.p == pytest.approx(2.0 * few.p)
    assert few.detectable is not None
    assert many.detectable is not None
    assert few.detectable < many.detectable


def test_the_interval_for_other_logs_contains_the_ratio_of_the_next_logs() -> None:
    """Logs whose errors have levels of their own; the interval for these logs is too narrow."""

    def logs(seed: int) -> LawErrors:
        rng = np.random.default_rng([seed, 1])
        of = errors(seed, 2, 4, 10.0, memory=0.5)
        return compared(
            {law: [np.exp(rng.normal(0.0, 0.1)) * e for e in own] for law, own in of.items()}
        )

    inside, narrower, draws = 0, 0, 200
    for seed in range(draws):
        found, after = (logs(k).ratios("law_1")["law_0"] for k in (2 * seed, 2 * seed + 1))
        assert found.others is not None
        assert found.low is not None
        assert found.high is not None
        inside += found.others[0] <= after.value <= found.others[1]
        narrower += found.low <= after.value <= found.high
    assert 0.93 * draws <= inside
    assert narrower < 0.9 * draws


def test_a_single_log_gives_no_interval_for_others() -> None:
    assert compared(errors(0, 2, 1, 60.0)).ratios("law_1")["law_0"].others is None
