"""Samples of a log file, independent of its format."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.logs.log_format import LogFormat
from hesr_model.support.arrays import Array, some_rows


@dataclass(frozen=True, kw_only=True, eq=False)
class LogSamples:
    """Samples (N,) and (N, n) in the file's units; messages name `time` and `place`."""

    t: Array
    q: Array
    dq: Array | None
    effort: Array
    is_current: bool
    time: str
    place: Callable[[int], str]
    temperature: Array | None = None
    q_link: Array | None = None
    q_cmd: Array | None = None
    dq_cmd: Array | None = None

    def arranged(self, log: LogFormat, after: float = -np.inf) -> "LogSamples":
        """Sort rows by time, and drop rows that lack a number or repeat a stamp, or `after`."""
        columns = ("t", "q", "dq", "effort", "temperature", "q_link", "q_cmd", "dq_cmd")
        parts = [part for name in columns if (part := getattr(self, name)) is not None]
        rows, drop = np.arange(len(self.t)), log.missing == "drop"
        if drop:
            rows = np.flatnonzero(np.all(np.isfinite(np.column_stack(parts)), axis=1))
        if log.sort:
            rows = rows[np.argsort(self.t[rows], kind="stable")]
        if drop or log.duplicates == "first":
            rows = rows[np.diff(self.t[rows], prepend=after) != 0.0]
        return replace(some_rows(self, columns, rows), place=lambda k: self.place(int(rows[k])))
