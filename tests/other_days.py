"""Errors of laws on logs of other days: equal on average, 2 to 5 % apart from log to log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from hesr_model.inference.comparison import BIN_SECONDS, LawErrors, law_errors

KINDS = ("flat", "slow", "peaked")
SPREADS = (0.02, 0.05)  # standard deviation of a law's level from log to log, drawn by law
_MEMORY = 0.7  # correlation of errors from bin to bin
_SLOW_MEMORY = 0.99  # that of a slow amplitude
_PEAK_SECONDS = 3.0  # between reversals
_PEAK_ROWS = 4


def draw_table(
    rng: np.random.Generator,
    law_count: int,
    log_count: int,
    kind: str,
    *,
    seconds: float = 20.0,
    common: float = 0.5,
    spreads: Sequence[float] = SPREADS,
) -> LawErrors:
    """Return the table of laws of equal expected error.

    `common` is the share of the squared error that all laws have in common.
    """
    spread_of_law = rng.choice(spreads, law_count)
    logs = []
    for _ in range(log_count):
        row_count = round(seconds / BIN_SECONDS)
        amplitude = _draw_amplitude(rng, row_count, kind)
        shared = _draw_series(rng, (1, row_count), _MEMORY)
        own = _draw_series(rng, (law_count, row_count), _MEMORY)
        level = np.exp(spread_of_law * rng.normal(size=law_count) - spread_of_law**2)
        error = np.sqrt(common) * shared + np.sqrt(1.0 - common) * own
        logs.append(level[:, None] * amplitude * error)
    errors = {f"law_{i}": [log[i] for log in logs] for i in range(law_count)}
    return law_errors(errors, [BIN_SECONDS] * log_count)


def _draw_amplitude(rng: np.random.Generator, row_count: int, kind: str) -> np.ndarray:
    if kind == "slow":
        return np.exp(0.4 * _draw_series(rng, (row_count,), _SLOW_MEMORY))
    amplitude = np.ones(row_count)
    if kind == "peaked":
        amplitude *= 0.3
        for k in rng.integers(row_count, size=round(row_count * BIN_SECONDS / _PEAK_SECONDS)):
            amplitude[k : k + _PEAK_ROWS] += 3.0
    return amplitude


def _draw_series(rng: np.random.Generator, shape: tuple[int, ...], memory: float) -> np.ndarray:
    """Draw first-order autoregressive series of variance 1, stationary from the first row on."""
    noise = np.sqrt(1.0 - memory**2) * rng.normal(size=shape)
    noise[..., 0] /= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], noise))


@dataclass(frozen=True)
class Calibration:
    """Shares of tables of equal laws, and of pairs of laws."""

    worse_than_best: float  # tables that call any law worse than the best
    not_alike: float  # tables that call any law better or worse than the first
    coverage: float  # intervals that contain 1
    width: float  # median width of an interval over that with the known variance
    found: float | None  # stated differences that other logs show; None if none was stated


def calibrate_tables(tables: Sequence[LawErrors]) -> Calibration:
    """Return the calibration of tables that are drawn alike."""
    log_ratios = []
    half_widths = []
    held = []
    wrong_tables = []
    other_wrong_tables = []
    found = []
    for table, next_table in zip(tables, [*tables[1:], tables[0]], strict=True):
        best = table.laws[table.best]
        wrong_tables.append(is_any_different(table, best))
        other_wrong_tables.append(is_any_different(table, table.laws[0]))
        ratio = table.ratios("law_0")["law_1"]
        assert ratio.low is not None
        assert ratio.high is not None
        log_ratios.append(np.log(ratio.value))
        half_widths.append(0.5 * np.log(ratio.high / ratio.low))
        held.append(ratio.low <= 1.0 <= ratio.high)
        if ratio.detectable is not None:
            found.append(shows(next_table, "law_1", "law_0", ratio.detectable))
    exact = 1.96 * np.sqrt(np.mean(np.square(log_ratios)))
    return Calibration(
        worse_than_best=float(np.mean(wrong_tables)),
        not_alike=float(np.mean(other_wrong_tables)),
        coverage=float(np.mean(held)),
        width=float(np.median(half_widths) / exact),
        found=float(np.mean(found)) if found else None,
    )


def is_any_different(table: LawErrors, other: str) -> bool:
    """Return whether any law is called better or worse than another."""
    return any(ratio.verdict != "alike" for ratio in table.ratios(other).values())


def shows(table: LawErrors, law_name: str, other: str, ratio: float) -> bool:
    """Return whether a table shows that a law's errors are larger, if they are by `ratio`.

    The other laws are equal, so that the smallest p is that of this law: Holm's factor is their
    number.
    """
    log_rmse = table.log_rmse.copy()
    log_rmse[table.laws.index(law_name)] += np.log(ratio)
    larger = replace(table, log_rmse=log_rmse)
    return larger.ratios(other)[law_name].verdict == "worse"
