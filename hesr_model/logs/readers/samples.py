"""Samples of a log file, independent of its format."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hesr_model.logs.bursts import spread_bursts
from hesr_model.logs.log_format import LogFormat
from hesr_model.support.arrays import Array, Mask, get_arrays, select_rows
from hesr_model.support.text import join_with_and

_RESTART_GAP = 1.0  # time [s] between the parts before and after a restart, which is unknown
_RESTART_GAP_STEPS = 100.0  # and in usual steps
_MAX_MISSING_STEPS = 10.0  # between numbers that are interpolated, in usual steps of their column


@dataclass(frozen=True, kw_only=True, eq=False)
class LogSamples:
    """Samples (N,) and (N, n) in the file's units; messages name `time` and `place`.

    `q` is None if it is the integral of `dq`. `left_out` are the numbers of rows that the file has
    in addition, by cause, and `left_over` what else the file has.
    """

    t: Array
    q: Array | None
    dq: Array | None
    effort: Array
    is_current: bool
    time: str
    place: Callable[[int], str]
    temperature: Array | None = None
    q_link: Array | None = None
    q_cmd: Array | None = None
    dq_cmd: Array | None = None
    current_size: Array | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    left_over: tuple[str, ...] = ()

    def continue_time(self, log_format: LogFormat) -> "LogSamples":
        """Let time go on where a counter wraps (`log.wrap`), or after a gap where it restarts."""
        spreads = log_format.duplicates == "spread"
        if log_format.wrap is None and log_format.restart == "refuse" and not spreads:
            return self
        rows = np.flatnonzero(np.isfinite(self.t))
        t = np.array(self.t, dtype=float)
        if log_format.wrap is not None:
            size = abs(log_format.wrap * float(log_format.units.factors("t", 1)[0]))
            t[rows] = np.unwrap(t[rows], period=size)
        if log_format.restart == "gap":
            t[rows] = _continue_after_gaps(t[rows])
        if spreads:
            t[rows] = spread_bursts(t[rows])
        return replace(self, t=t)

    def sort_samples(self, log_format: LogFormat, previous_stamp: float = -np.inf) -> "LogSamples":
        """Sort rows by time; drop those that lack a number or repeat a stamp (`previous_stamp`)."""
        if log_format.missing == "interpolate":
            return self._interpolate_missing().sort_samples(
                log_format.model_copy(update={"missing": "drop"}), previous_stamp
            )
        rows = np.arange(len(self.t))
        left_out = dict(self.left_out)
        drops_missing = log_format.missing == "drop"
        if drops_missing:
            is_known = self._find_numbers()
            is_complete = np.logical_and.reduce(list(is_known.values()))
            rows = np.flatnonzero(is_complete)
            if len(rows) < len(is_complete):
                lacking = [name for name, known in is_known.items() if not np.all(known)]
                cause = f"lack a number of {join_with_and(lacking)}"
                left_out[cause] = len(is_complete) - len(rows)
        if log_format.sort:
            rows = rows[np.argsort(self.t[rows], kind="stable")]
        if drops_missing or log_format.duplicates == "first":
            is_new = np.diff(self.t[rows], prepend=previous_stamp) != 0.0
            rows = rows[is_new]
            if not np.all(is_new):
                left_out["repeat the time stamp of the row before"] = int(np.sum(~is_new))
        return replace(
            select_rows(self, rows),
            place=lambda k: self.place(int(rows[k])),
            left_out=left_out,
        )

    def _find_numbers(self) -> dict[str, Mask]:
        """Return whether each row (N,) has all numbers of a signal, by its name in messages."""
        names = {"effort": "current" if self.is_current else "tau"}
        return {
            names.get(name, name): np.isfinite(values.reshape(len(values), -1)).all(axis=1)
            for name, values in get_arrays(self).items()
        }

    def _interpolate_missing(self) -> "LogSamples":
        """Return the rows of the slowest column, with numbers of the others at their stamps."""
        arrays = get_arrays(self)
        columns = np.column_stack(list(arrays.values()))
        is_known = np.isfinite(columns) & np.isfinite(self.t)[:, None]
        rows = np.flatnonzero(is_known[:, np.argmin(is_known.sum(axis=0))])
        samples = replace(select_rows(self, rows), place=lambda k: self.place(int(rows[k])))
        filled: dict[str, Any] = {}
        is_used = np.isin(self.t, samples.t)
        for name, values in arrays.items():
            if name != "t":
                table = values.reshape(len(values), -1)
                filled_columns = []
                for column in table.T:
                    known = np.isfinite(column) & np.isfinite(self.t)
                    is_used |= known & find_neighbours(self.t, known, samples.t)
                    filled_columns.append(_interpolate(self.t, column, samples.t))
                filled[name] = np.column_stack(filled_columns).reshape(len(rows), *values.shape[1:])
        unused = count_unused(self.t, is_used, samples.t)
        left_out = {
            f"{cause} numbers of the slowest column": count for cause, count in unused.items()
        }
        changed: LogSamples = replace(samples, left_out={**self.left_out, **left_out}, **filled)
        return changed


def find_neighbours(stamps: NDArray[Any], known: Mask, times: NDArray[Any]) -> Mask:
    """Return which of the `known` stamps (N,) are next to one of some times, on either side."""
    indices = np.flatnonzero(known)
    indices = indices[np.argsort(stamps[indices], kind="stable")]
    after = np.searchsorted(stamps[indices], times)
    is_neighbour = np.zeros(len(stamps), dtype=bool)
    for positions in (after - 1, after):
        is_inside = (positions >= 0) & (positions < len(indices))
        is_neighbour[indices[positions[is_inside]]] = True
    return is_neighbour


def count_unused(stamps: NDArray[Any], is_used: Mask, times: NDArray[Any]) -> dict[str, int]:
    """Return how many stamps (N,) give no number at some times, by the begin of the cause."""
    if len(times) < 2:
        return {}
    first = times.min()
    last = times.max()
    # Of two topics with one period, one begins up to a step before the other.
    margin = 2.0 * float(np.median(np.abs(np.diff(times))))
    is_outside = (stamps < first - margin) | (stamps > last + margin)
    is_between = ~is_used & (stamps >= first) & (stamps <= last)
    counts = {
        "lie before or after the": int(np.sum(is_outside)),
        "lie between the": int(np.sum(is_between)),
    }
    return {cause: count for cause, count in counts.items() if count}


def _interpolate(t: Array, column: Array, times: Array) -> Array:
    """Return a column (N,) at `times` [s], without numbers where it has none near them."""
    known = np.flatnonzero(np.isfinite(column) & np.isfinite(t))
    known = known[np.argsort(t[known], kind="stable")]
    stamps = t[known]
    values = np.interp(times, stamps, column[known], left=np.nan, right=np.nan)
    if len(stamps) > 2:
        after = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
        steps = stamps[after] - stamps[after - 1]
        is_far = steps > _MAX_MISSING_STEPS * float(np.median(np.diff(stamps)))
        values[is_far & ~np.isin(times, stamps)] = np.nan
    return np.asarray(values)


def _continue_after_gaps(t: Array) -> Array:
    """Return stamps (N,) [s] that go on after a gap, wherever they fall."""
    steps = np.diff(t)
    is_fall = steps < 0.0
    usual_step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    # Longer than the steps of a part, and than what friction remembers.
    gap = max(_RESTART_GAP, _RESTART_GAP_STEPS * usual_step)
    return np.concatenate([t[:1], t[:1] + np.cumsum(np.where(is_fall, gap, steps))])
