"""Samples of a log file, independent of its format."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.logs.log_format import LogFormat
from hesr_model.support.arrays import Array, get_arrays, select_rows

_RESTART_GAP = 1.0  # time [s] between the parts before and after a restart, which is unknown
_RESTART_GAP_STEPS = 100.0  # and in usual steps


@dataclass(frozen=True, kw_only=True, eq=False)
class LogSamples:
    """Samples (N,) and (N, n) in the file's units; messages name `time` and `place`.

    `q` is None if it is the integral of `dq`.
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

    def continue_time(self, log_format: LogFormat) -> "LogSamples":
        """Let time go on where a counter wraps (`log.wrap`), or after a gap where it restarts."""
        if log_format.wrap is None and log_format.restart == "refuse":
            return self
        rows = np.flatnonzero(np.isfinite(self.t))
        t = np.array(self.t, dtype=float)
        if log_format.wrap is not None:
            size = abs(log_format.wrap * float(log_format.units.factors("t", 1)[0]))
            t[rows] = np.unwrap(t[rows], period=size)
        if log_format.restart == "gap":
            t[rows] = _continue_after_gaps(t[rows])
        return replace(self, t=t)

    def sort_samples(self, log_format: LogFormat, previous_stamp: float = -np.inf) -> "LogSamples":
        """Sort rows by time; drop those that lack a number or repeat a stamp (`previous_stamp`)."""
        rows = np.arange(len(self.t))
        drops_missing = log_format.missing == "drop"
        if drops_missing:
            is_finite = np.isfinite(np.column_stack(list(get_arrays(self).values())))
            rows = np.flatnonzero(np.all(is_finite, axis=1))
        if log_format.sort:
            rows = rows[np.argsort(self.t[rows], kind="stable")]
        if drops_missing or log_format.duplicates == "first":
            rows = rows[np.diff(self.t[rows], prepend=previous_stamp) != 0.0]
        return replace(select_rows(self, rows), place=lambda k: self.place(int(rows[k])))


def _continue_after_gaps(t: Array) -> Array:
    """Return stamps (N,) [s] that go on after a gap, wherever they fall."""
    steps = np.diff(t)
    is_fall = steps < 0.0
    usual_step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    # Longer than the steps of a part, and than what friction remembers.
    gap = max(_RESTART_GAP, _RESTART_GAP_STEPS * usual_step)
    return np.concatenate([t[:1], t[:1] + np.cumsum(np.where(is_fall, gap, steps))])
