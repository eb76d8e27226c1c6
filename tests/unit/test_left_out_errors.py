"""Errors on left-out rows: their ratios, and how well these are known."""

from collections.abc import Sequence

import numpy as np
import pytest
from left_out_rows import RATE, make_errors
from scipy.special import stdtrit

from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.support.arrays import Array

DRAWS = 400


def draw_errors(rng: np.random.Generator, rows: int, memory: float) -> Array:
    """Errors of a law on joints that are independent, of size 1, with a memory of some seconds."""
    width = max(round(memory * RATE), 1)
    sums = np.cumsum(rng.standard_normal((rows + width, DRAWS)), axis=0)
    return (sums[width:] - sums[:-width]) / np.sqrt(width)


def measure_coverage(log_count: int, seconds: float, memory: float, spread: float) -> float:
    """Share of joints whose interval contains the true ratio, 1, of two laws.

    Parts of both laws' errors are common; the laws differ from log to log by `spread`.
    """
    rng = np.random.default_rng(4)
    rows = round(seconds * RATE)
    errors: dict[str, list[Array]] = {"a": [], "b": []}
    for _ in range(log_count):
        common = draw_errors(rng, rows, memory)
        ratio = np.exp(spread * rng.standard_normal(DRAWS))
        for law_name, factor in (("a", ratio), ("b", 1.0)):
            own = draw_errors(rng, rows, memory)
            errors[law_name].append(factor * (0.8 * common + 0.6 * own))
    table = make_errors(errors)
    covered = 0
    for j in range(DRAWS):
        freedom = table.degrees_of_freedom("a", "b", j)
        margin = float(stdtrit(freedom, 0.975)) * table.standard_error("a", "b", j)
        covered += abs(table.log_ratio("a", "b", j)) <= margin
    return covered / DRAWS


@pytest.mark.parametrize(
    ("log_count", "seconds", "memory", "spread", "lowest"),
    [
        (1, 40.0, 0.0, 0.0, 0.92),
        (1, 80.0, 0.5, 0.0, 0.92),
        (1, 80.0, 2.0, 0.0, 0.85),  # as long as a block: the correction for one lag is too small
        (4, 20.0, 0.2, 0.05, 0.93),
        (8, 20.0, 0.0, 0.05, 0.93),
    ],
    ids=["independent", "correlated", "slow", "four logs that differ", "eight logs that differ"],
)
def test_intervals_contain_the_true_ratio(
    log_count: int, seconds: float, memory: float, spread: float, lowest: float
) -> None:
    coverage = measure_coverage(log_count, seconds, memory, spread)
    assert lowest <= coverage <= 0.99


def test_an_interval_is_not_wider_than_needed() -> None:
    """The standard error of independent errors is known: those of 2,000 rows."""
    rng = np.random.default_rng(1)
    table = make_errors({name: [rng.standard_normal((2000, DRAWS))] for name in "ab"})
    ratios = [table.log_ratio("a", "b", j) for j in range(DRAWS)]
    stated = [table.standard_error("a", "b", j) for j in range(DRAWS)]
    true = 1.0 / np.sqrt(2000)  # each log RMSE has 1 / sqrt(2 N)
    assert np.std(ratios) == pytest.approx(true, rel=0.12)
    assert np.median(stated) == pytest.approx(true, rel=0.12)


def test_rmse_and_ratio_are_those_of_all_judged_rows() -> None:
    rng = np.random.default_rng(2)
    logs = {
        "a": [rng.normal(size=500), 3.0 * rng.normal(size=900)],
        "b": [np.ones(500), np.ones(900)],
    }
    table = make_errors(logs)
    expected = np.sqrt(np.mean(np.concatenate(logs["a"]) ** 2))
    assert table.rmse("a", 0) == pytest.approx(expected)
    assert table.rmse("b", 0) == pytest.approx(1.0)
    assert table.log_ratio("a", "b", 0) == pytest.approx(np.log(expected))
    assert table.log_ratio("b", "a", 0) == pytest.approx(-np.log(expected))
    by_fold = [table.rmse("a", 0, fold) for fold in range(5)]
    assert table.worst_fold("a", "b", 0) == pytest.approx(max(by_fold))
    assert table.laws == ("a", "b")
    assert table.fold_count == 5
    assert table.seconds == pytest.approx((498 + 900) / RATE)


def make_differing_logs(log_count: int, log_names: Sequence[str] | None = None) -> LeftOutErrors:
    """Errors of 0.8 and 1.2 of those of another law in turn, on logs of 100 s."""
    factors = [(0.8, 1.2)[k % 2] for k in range(log_count)]
    rows = round(100.0 * RATE)
    errors = {"a": [np.full(rows, f) for f in factors], "b": [np.ones(rows)] * log_count}
    return make_errors(errors, log_names=log_names)


def test_differences_between_logs_count_from_four_logs_on() -> None:
    """With 50 blocks per log their number hides how few logs there are."""
    few = make_differing_logs(3)
    logs = make_differing_logs(4)
    assert few.standard_error("a", "b", 0) < 0.6 * logs.standard_error("a", "b", 0)
    # The influence of a log is its part of the squared error less its part of the rows.
    squares = np.array([0.64, 1.44, 0.64, 1.44])
    influences = 0.5 * (squares / squares.sum() - 0.25)
    expected = np.sqrt(4.0 / 3.0 * np.sum(influences**2))
    assert logs.standard_error("a", "b", 0) == pytest.approx(expected, rel=1e-6)
    assert logs.degrees_of_freedom("a", "b", 0) == 3
    assert few.degrees_of_freedom("a", "b", 0) > 100


def test_parts_of_one_log_are_one_log() -> None:
    parts = make_differing_logs(4, ["one", "one", "other", "other"])
    assert parts.degrees_of_freedom("a", "b", 0) > 100


def test_folds_that_do_not_reverse_a_joint_do_not_count() -> None:
    """A law explodes on the first fold, whose training never reverses the joint."""
    errors = np.ones(2000)
    errors[:400] = 50.0
    counts = np.array([[False], *[[True]] * 4])
    table = make_errors({"a": [errors], "b": [np.ones(2000)]}, counts=counts)
    assert table.rmse("a", 0) == pytest.approx(1.0)
    assert table.worst_fold("a", "b", 0) == pytest.approx(1.0)
    assert np.isnan(table.rmse("a", 0, 0))
    assert table.fold_counts(0) == 4
    assert table.moving_seconds(0) == pytest.approx(16.0, rel=0.05)
    every = make_errors({"a": [errors], "b": [np.ones(2000)]})
    assert every.rmse("a", 0) > 20.0
    assert every.worst_fold("a", "b", 0) == pytest.approx(50.0)


def test_without_rows_nothing_is_known() -> None:
    counts = np.zeros((5, 1), dtype=bool)
    table = make_errors({"a": [np.ones(500)], "b": [np.ones(500)]}, counts=counts)
    assert np.isnan(table.rmse("a", 0))
    assert np.isnan(table.friction_size(0))
    assert table.standard_error("a", "b", 0) == np.inf
    assert (table.fold_counts(0), table.block_count(0), table.moving_seconds(0)) == (0, 0, 0)


def test_the_size_of_friction_is_that_of_judged_rows() -> None:
    tau = np.r_[np.zeros(400), np.tile([-3.0, 3.0], 800)]
    counts = np.array([[False], *[[True]] * 4])
    errors = {"a": [np.ones(2000)]}
    assert make_errors(errors, tau=[tau], counts=counts).friction_size(0) == pytest.approx(3.0)


@pytest.mark.parametrize("sizes", [(1.0, 1.1, 1.2, 1.3, 1.4), (2.0, 2.0, 2.0, 2.0, 2.0)])
def test_the_error_of_a_mean_over_joints_is_that_over_folds(sizes: Sequence[float]) -> None:
    own = np.repeat(sizes, 400)
    table = make_errors({"a": [own], "b": [np.ones(2000)]})
    expected = np.std(np.log(sizes), ddof=1) / np.sqrt(5)
    assert table.mean_standard_error("a", "b", [0]) == pytest.approx(expected, abs=1e-12)
    assert isinstance(table, LeftOutErrors)
