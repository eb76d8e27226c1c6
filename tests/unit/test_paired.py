"""Comparisons of two predictions: units, intervals, probabilities, and how many there are."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hesr_model.inference.paired_test import DRAWS, ENOUGH, compare_errors, holm, units


def errors(
    seed: int, logs: int, rows: int, *, size: float = 1.0, memory: float = 0.9
) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    scale = size * np.sqrt(1.0 - memory**2)
    return [lfilter([scale], [1.0, -memory], rng.normal(size=rows)) for _ in range(logs)]


def test_blocks_stand_in_logs_and_are_eight_seconds_long_or_more() -> None:
    """Logs of 20, 8 and 3 s at 10 ms have 2, 1 and 1 blocks."""
    logs = [np.arange(n, dtype=float) for n in (2000, 800, 300)]
    white = [np.random.default_rng(0).normal(size=len(log)) for log in logs]
    sums, _ = units(white, white, [0.01] * 3)
    expected = [white[0][:1000], white[0][1000:], white[1], white[2]]
    np.testing.assert_allclose(sums, [e @ e for e in expected], rtol=1e-12)


def test_blocks_are_as_long_as_errors_hang_together() -> None:
    """A memory of .998 at 10 ms is one of 10 s: blocks of 40 s."""
    slow, quick = (errors(0, 1, 200_00, memory=m) for m in (0.998, 0.0))
    assert len(units(quick, quick, [0.01])[0]) == 25
    assert 3 <= len(units(quick, slow, [0.01])[0]) <= 9


def test_many_logs_are_units_of_their_own() -> None:
    of = errors(0, ENOUGH, 3000)
    sums, _ = units(of, of, [0.01] * ENOUGH)
    np.testing.assert_allclose(sums, [e @ e for e in of])
    assert len(units(of[:-1], of[:-1], [0.01] * (ENOUGH - 1))[0]) == 3 * (ENOUGH - 1)


@pytest.mark.parametrize(("logs", "rows"), [(2, 4000), (10, 800)])
def test_intervals_hold_the_truth_and_equals_are_seldom_told_apart(logs: int, rows: int) -> None:
    held, found = [], []
    for seed in range(1000, 1080):
        both = errors(seed, 2 * logs, rows)
        a, b = both[:logs], both[logs:]
        one = compare_errors([0.8 * e for e in a], b, [0.01] * logs)
        assert one.low is not None
        assert one.high is not None
        held.append(one.low <= 0.8 <= one.high)
        found.append(compare_errors(a, b, [0.01] * logs).p < 0.05)
    # Of 80, at 95 and 5 %: three standard deviations of chance.
    assert np.mean(held) >= 0.87
    assert np.mean(found) <= 0.13


def test_the_probability_counts_all_exchanges() -> None:
    """Four blocks, of which each is better: 2 of 16 exchanges are as far from 1."""
    a, b = np.full(3200, 0.5), np.ones(3200)
    b[::2] = -1.0  # an error without memory
    a[::2] = -0.5
    one = compare_errors([a], [b], [0.01])
    assert one.p == 2.0 / 16.0
    assert one.value == pytest.approx(0.5)
    assert (one.low, one.high) == (pytest.approx(0.5), pytest.approx(0.5))


def test_one_block_tells_nothing() -> None:
    a, b = errors(0, 1, 500), errors(1, 1, 500)
    one = compare_errors(a, b, [0.01])
    assert (one.low, one.high, one.p) == (None, None, 1.0)


def test_equal_predictions_are_equal() -> None:
    a = errors(0, 1, 40_000)
    one = compare_errors(a, a, [0.01])
    assert (one.value, one.low, one.high, one.p) == (1.0, 1.0, 1.0, 1.0)


def test_a_clear_difference_over_many_blocks_is_as_sure_as_draws_tell() -> None:
    a, b = errors(0, 1, 40_000, size=0.5), errors(1, 1, 40_000)
    assert compare_errors(a, b, [0.01]).p == pytest.approx(1.0 / (DRAWS + 1))


def test_probabilities_are_adjusted_for_how_many_there_are() -> None:
    """Holm's example by hand: the least times 4, the next times 3, never falling, at most 1."""
    assert holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005}) == pytest.approx(
        {"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02}
    )
    assert holm({"a": 0.6, "b": 0.7}) == {"a": 1.0, "b": 1.0}
    assert holm({}) == {}
