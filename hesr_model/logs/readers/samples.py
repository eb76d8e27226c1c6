"""Samples of a log file, independent of its format."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.logs.log_format import LogFormat
from hesr_model.support.arrays import Array, get_arrays, select_rows


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
