"""Stamps of rows that arrive in bursts become those of an even source; other stamps stay."""

import numpy as np
import pytest

from hesr_model.logs.bursts import find_period, has_bursts, spread_bursts
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.readers.samples import LogSamples

PERIOD = 0.01
TRUE = PERIOD * np.arange(2000)


def stamp_bursts(true: np.ndarray, sizes: np.ndarray, step: float = 0.0) -> np.ndarray:
    """Stamp each row when the last one of its burst was taken, and `step` after the row before."""
    bursts = np.repeat(np.arange(len(sizes)), sizes)[: len(true)]
    lasts = np.append(np.flatnonzero(np.diff(bursts)), len(true) - 1)
    firsts = np.concatenate([[0], lasts[:-1] + 1])
    return true[lasts][bursts] + step * (np.arange(len(true)) - firsts[bursts])


@pytest.mark.parametrize("step", [0.0, 1e-5, 5e-4])
@pytest.mark.parametrize("size", [2, 5, 20, 90])
def test_even_bursts_give_the_true_steps(size: int, step: float) -> None:
    stamps = stamp_bursts(TRUE, np.full(2000, size), step)
    assert has_bursts(stamps)
    assert find_period(stamps) == pytest.approx(PERIOD, rel=0.1)
    np.testing.assert_allclose(np.diff(spread_bursts(stamps)), PERIOD, rtol=0.02)


def test_uneven_bursts_give_the_true_steps() -> None:
    sizes = np.random.default_rng(1).integers(2, 9, 2000)
    np.testing.assert_allclose(np.diff(spread_bursts(stamp_bursts(TRUE, sizes))), PERIOD, rtol=1e-9)


def test_a_pause_stays_a_gap() -> None:
    true = TRUE + 7.0 * (np.arange(2000) >= 1000)
    spread = spread_bursts(stamp_bursts(true, np.full(2000, 5)))
    steps = np.diff(spread)
    assert np.argmax(steps) == 999
    assert steps[999] == pytest.approx(7.0, abs=2 * PERIOD)
    np.testing.assert_allclose(np.delete(steps, 999), PERIOD, rtol=1e-6)


@pytest.mark.parametrize("kind", ["even", "jitter", "random", "pause", "falling"])
def test_other_stamps_have_no_bursts(kind: str) -> None:
    random = np.random.default_rng(2)
    stamps = {
        "even": TRUE,
        "jitter": TRUE + 0.3 * PERIOD * random.uniform(-1.0, 1.0, 2000),
        "random": np.cumsum(random.exponential(PERIOD, 2000)),
        "pause": TRUE + 900.0 * (np.arange(2000) >= 1000),
        "falling": np.where(TRUE < 7.0, TRUE, TRUE - 7.0),
    }[kind]
    assert not has_bursts(stamps)
    if kind == "falling":
        np.testing.assert_array_equal(spread_bursts(stamps), stamps)


def test_rows_without_a_stamp_do_not_count() -> None:
    stamps = stamp_bursts(TRUE, np.full(2000, 5))
    stamps[7] = np.nan
    samples = LogSamples(
        t=stamps, q=None, dq=None, effort=stamps[:, None], is_current=False, time="t", place=str
    )
    spread = samples.continue_time(LogFormat(duplicates="spread", missing="drop")).t
    assert np.isnan(spread[7])
    np.testing.assert_allclose(np.diff(np.delete(spread, 7)), PERIOD, rtol=1e-3)
