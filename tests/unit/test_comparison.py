"""Comparison of laws on the same logs: size, intervals, power and minimum duration."""

import numpy as np
import pytest
from other_days import calibrate_tables, draw_table
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
    return {law for law, ratio in ratios.items() if ratio.verdict == "worse"}


def test_the_ratio_is_the_rmse_ratio_over_all_rows() -> None:
    of = errors(0, 2, 3, 17.3)
    rmse = [np.sqrt(np.mean(np.concatenate(logs) ** 2)) for logs in of.values()]
    ratio = compared(of).ratios("law_1")["law_0"]
    assert ratio.value == pytest.approx(rmse[0] / rmse[1], rel=1e-12, abs=0.0)
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
    """On a single log; the printed p is not adjusted and belongs to the interval."""
    assert [calibration(n, 5.0) for n in (1, 8, 16)] == [6.5, 6.5, 13.0]
    assert calibration(8, 50.0) == pytest.approx(5.15)
    of = errors(0, 2, 1, 80.0, common=0.9)
    found = compared(of | {"law_1": [1.3 * e for e in of["law_1"]]})
    few, many = (found.ratios("law_0", family)["law_1"] for family in (8, 16))
    assert (few.p, few.adjusted_p) == (many.p, many.adjusted_p)
    assert few.p is not None
    assert few.adjusted_p == pytest.approx(calibration(1, found.degrees) * few.p)
    assert few.detectable is not None
    assert many.detectable is not None
    assert few.detectable < many.detectable


@pytest.mark.parametrize("logs", [1, 2, 4])
def test_an_interval_excludes_one_where_its_p_is_below_5_percent(logs: int) -> None:
    rng = np.random.default_rng(logs)
    significant = 0
    for _ in range(20):
        table = draw_table(rng, 5, logs, "flat", seconds=40.0, spreads=(0.2,))
        for ratio in table.ratios("law_0").values():
            assert ratio.low is not None
            assert ratio.high is not None
            assert ratio.p is not None
            assert (ratio.p < SIGNIFICANCE) == (ratio.low > 1.0 or ratio.high < 1.0)
            assert ratio.on_other_logs == (logs > 1)
            significant += ratio.p < SIGNIFICANCE
    assert significant


@pytest.mark.parametrize(("laws", "kind"), [(2, "peaked"), (6, "slow"), (16, "flat")])
def test_statements_hold_on_logs_of_other_days(laws: int, kind: str) -> None:
    """Laws differ by 2 to 5 % from log to log; `tests/benchmarks` has more draws and cases."""
    rng = np.random.default_rng([laws, 3])
    found = calibrate_tables([draw_table(rng, laws, 4, kind) for _ in range(60)])
    # 60 draws: limits are 2.5 standard errors beyond 5, 93 and 80 %.
    assert found.worse_than_best <= 0.12
    assert found.not_alike <= 0.12
    assert found.coverage >= 0.85
    assert found.width <= 1.7
    assert found.found is not None
    assert 0.67 <= found.found <= 0.98


def test_a_log_that_holds_most_of_the_error_leaves_little_certainty() -> None:
    """Its own ratio is that of all rows, so that differences from it say little of other logs."""
    of = errors(2, 2, 4, 20.0, common=0.5)
    alike = compared(of)
    loud = compared({law: [10.0 * logs[0], *logs[1:]] for law, logs in of.items()})
    assert alike.between_degrees == pytest.approx(3.0, abs=0.01)
    assert loud.between_degrees < 1.6
    widths = [
        np.log(ratio.high / ratio.low)
        for ratio in (found.ratios("law_0")["law_1"] for found in (alike, loud))
        if ratio.low and ratio.high
    ]
    assert widths[1] > 2.0 * widths[0]


def test_parts_of_one_log_say_nothing_of_other_logs() -> None:
    of = errors(3, 3, 4, 20.0)
    parts = law_errors(of, [PERIOD] * 4, log_names=["a"] * 4)
    assert (parts.between_degrees, parts.is_between.sum()) == (0.0, 0)
    assert not parts.ratios("law_0")["law_1"].on_other_logs
    logs = law_errors(of, [PERIOD] * 4, log_names=["a", "a", "b", "b"])
    assert logs.is_between.sum() == 1
    assert len(logs.rows) == len(parts.rows) == len(compared(of).rows)
    assert logs.ratios("law_0")["law_1"].on_other_logs


def test_few_logs_give_wide_intervals() -> None:
    widths = []
    for logs in (2, 3, 4, 8):
        rng = np.random.default_rng(4)
        tables = [draw_table(rng, 2, logs, "flat", seconds=24.0) for _ in range(20)]
        ratios = [table.ratios("law_0")["law_1"] for table in tables]
        widths.append(np.median([np.log(r.high / r.low) for r in ratios if r.low and r.high]))
    assert widths[0] > 2.0 * widths[1] > 2.0 * widths[2] > 2.0 * widths[3]


@pytest.mark.parametrize(("logs", "laws", "stated"), [(2, 6, False), (2, 2, False), (3, 6, True)])
def test_too_few_logs_state_no_detectable_difference(logs: int, laws: int, stated: bool) -> None:
    rng = np.random.default_rng(5)
    table = draw_table(rng, laws, logs, "flat", seconds=30.0)
    ratio = table.ratios("law_0")["law_1"]
    assert (ratio.detectable is not None) == stated
    assert ratio.low is not None  # the interval is wide, but known


def test_many_short_logs_are_compared_by_their_differences() -> None:
    """A single longer log among them adds one degree of freedom within, which decides nothing."""
    rng = np.random.default_rng(6)
    logs = [[scale * rng.normal(size=600) for scale in (1.0, 1.3)] for _ in range(8)]
    logs.append([scale * rng.normal(size=900) for scale in (1.0, 1.3)])
    errors_of_laws = {law: [log[k] for log in logs] for k, law in enumerate(("a", "b"))}
    assert compared(errors_of_laws).ratios("a")["b"].verdict == "worse"
