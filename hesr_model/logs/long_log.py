"""Logs that are read in pieces, with memory that does not grow with the rows."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs import robot_log
from hesr_model.logs.readers.formats import read_sample_pieces
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Grid, Motion, filter_log
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array, join_records
from hesr_model.support.files import sha256

PIECE_ROWS = 2**14  # rows of a piece
_MAX_DISTINCT_STEPS = 2**20
_STEP_DIGITS = 2.0**16  # most steps kept exactly; digits of more
_OVERLAP_PERIODS = 10.0  # overlap in periods of the cut-off; transients decay to 1e-19
_SPLINE_MARGIN = 100  # rows after which the ends of a spline do not matter
_MAX_STRETCHES = 8  # most pieces kept for checks


class StepCounts:
    """Distinct time steps [s] of a log, and how often they occur."""

    def __init__(self) -> None:
        self.values: Array = np.empty(0)
        self._counts: Array = np.empty(0)

    def add(self, steps: Array) -> None:
        """Add steps (N,)."""
        counts = np.concatenate([self._counts, np.ones(len(steps))])
        values = np.concatenate([self.values, steps])
        if len(values) > _MAX_DISTINCT_STEPS:
            mantissa, exponent = np.frexp(values)
            values = np.ldexp(np.rint(mantissa * _STEP_DIGITS) / _STEP_DIGITS, exponent)
        self.values, places = np.unique(values, return_inverse=True)
        self._counts = np.bincount(places, counts).astype(float)

    def _find_by_rank(self, *ranks: int) -> Array:
        return self.values[np.searchsorted(np.cumsum(self._counts), ranks, side="right")]

    @property
    def period(self) -> float:
        """Median [s]."""
        count = int(self._counts.sum())
        return float(np.mean(self._find_by_rank((count - 1) // 2, count // 2)))

    @property
    def longest(self) -> float:
        """Step [s] above which there is a gap, as `Log.longest_step`."""
        (usual_step,) = self._find_by_rank(int(robot_log.USUAL_SHARE * (self._counts.sum() - 1)))
        return robot_log.MIN_GAP_STEPS * max(self.period, self.mean(usual_step))

    def mean(self, longest: float) -> float:
        """Mean [s] of the steps up to `longest` [s]."""
        is_usual = self.values <= longest
        return float(np.average(self.values[is_usual], weights=self._counts[is_usual]))


@dataclass(kw_only=True)
class _Part:
    """Rows `first` to `last` of a log, without gaps."""

    first: int
    start: float
    last: int = 0
    end: float = 0.0
    steps: StepCounts = field(default_factory=StepCounts)

    @property
    def grid(self) -> Grid:
        return Grid(period=self.steps.period, start=self.start, end=self.end)


class LongLog:
    """A log that is read in pieces of at most `rows` rows, several times; errors as `Log.read`.

    Formats that cannot be read in pieces are held in memory. `stretches` are up to eight of the
    pieces, without `gaps`; `travel` (n,) is the range of the positions [rad, m].
    """

    def __init__(self, source: Log | Path, robot: RobotDescription, rows: int = PIECE_ROWS) -> None:
        robot.require_one_per_joint()
        self._robot = robot
        self._rows = rows
        self._sha256 = ""
        if isinstance(source, Path):
            in_pieces = not robot.log.sort and next(read_sample_pieces(source, robot, rows), None)
            self._sha256 = sha256(source)
            source = source if in_pieces else Log.read(source, robot)
        self._source = source
        self._time = ""
        self._state = _read_state(source)
        self.stretches: list[Log] = []
        self.travel: Array = np.empty(0)
        self._dropped = 0
        parts = self._split(self._survey_pieces(), np.inf)
        robot_log.require_rows(self._where, parts[0].last if parts else 0)
        (whole_part,) = parts
        longest = whole_part.steps.longest
        if isinstance(source, Path):
            location = f"{self._where}: {self._time}"
            robot_log.require_rate(
                location, whole_part.steps.period, whole_part.steps.mean(longest), robot
            )
        if whole_part.steps.values[-1] > longest:
            parts = self._split(self._read_pieces(), longest)
            pieces = (log.split(longest) for log in self.stretches)
            self.stretches = [max(logs, key=lambda piece: len(piece.t)) for logs in pieces]
        self.stretches = [
            replace(log, dropped=0 if k else self._dropped) for k, log in enumerate(self.stretches)
        ]
        self.gaps = len(parts) - 1
        self.longest_step = float(whole_part.steps.values[-1])
        shortest = robot_log.SHORTEST_PART
        self._parts = [p for p in parts if p is whole_part or p.end - p.start >= shortest]
        if not self._parts:
            raise robot_log.no_parts_error(self._where, len(parts) - 1, longest)
        for part in self._parts:
            cutoff = robot.log.filter_cutoff
            part.grid.require_filter(self._where, part.last - part.first, cutoff)

    @property
    def _where(self) -> str:
        return str(self._source) if isinstance(self._source, Path) else self._source.where

    @property
    def starts(self) -> set[float]:
        """First time stamps [s] of the parts between gaps."""
        return {part.start for part in self._parts}

    def motions(self) -> Iterator[Motion]:
        """Yield the smooth motion piece by piece, as `signals.smoothed` of the whole log."""
        cutoff = self._robot.log.filter_cutoff
        parts = list(self._parts)
        held_log = None
        done = 0
        at = 0  # rows held from number `at`
        for log in self._read_pieces():
            held_log = join_records([held_log, log]) if held_log else log
            end_held = at + len(held_log.t)
            margin = 0
            while parts:
                part = parts[0]
                grid = parts[0].grid
                margin = int(np.ceil(_OVERLAP_PERIODS / (cutoff * grid.period))) + _SPLINE_MARGIN
                complete = end_held >= part.last
                first = max(done, part.first)
                last = part.last if complete else end_held - margin
                if last <= first:
                    break
                window_first = max(part.first, first - margin)
                window_end = min(part.last, last + margin)
                window = held_log.rows(slice(window_first - at, window_end - at))
                yield filter_log(window, cutoff, grid).rows(
                    slice(first - window_first, last - window_first)
                )
                done = last
                if not complete:
                    break
                parts.pop(0)
            if not parts:
                return
            first_needed = max(done - margin, min(parts[0].first, end_held), at)
            held_log, at = held_log.rows(slice(first_needed - at, None)), first_needed

    def _survey_pieces(self) -> Iterator[Log]:
        """Yield the pieces, and keep stretches, travel and the number of rows left out."""
        lowest = np.array(np.inf)
        highest = np.array(-np.inf)
        stride = 1
        for k, log in enumerate(self._read_pieces()):
            self._dropped += log.dropped
            lowest, highest = (
                np.minimum(lowest, log.q.min(axis=0)),
                np.maximum(highest, log.q.max(axis=0)),
            )
            self.travel = highest - lowest
            if k % stride == 0 and (k == 0 or 2 * len(log.t) > self._rows):  # checks need many rows
                self.stretches.append(log)
            if len(self.stretches) > _MAX_STRETCHES:
                self.stretches, stride = self.stretches[::2], 2 * stride
            yield log

    def _split(self, pieces: Iterable[Log], longest: float) -> list[_Part]:
        """Split the rows of all pieces at steps above `longest` [s]."""
        parts: list[_Part] = []
        rows = 0
        for log in pieces:
            steps = np.diff(log.t, prepend=parts[-1].end if parts else log.t[0])
            starts = {*np.flatnonzero(steps > longest).tolist(), *([] if parts else [0])}
            for first, last in pairwise(sorted({0, *starts, len(log.t)})):
                is_new = first in starts
                if is_new:
                    parts.append(_Part(first=rows + first, start=float(log.t[first])))
                part = parts[-1]
                part.steps.add(steps[first + is_new : last])
                part.last = rows + last
                part.end = float(log.t[last - 1])
            rows += len(log.t)
        return parts

    def _read_pieces(self) -> Iterator[Log]:
        source = self._source
        if isinstance(source, Log):
            for first in range(0, len(source.t), self._rows):
                yield source.rows(slice(first, first + self._rows))
            return
        last: Log | None = None
        for samples_read in read_sample_pieces(source, self._robot, self._rows):
            samples = samples_read.sort_samples(
                self._robot.log, after=last.t[-1] if last else -np.inf
            )
            if not len(samples.t):
                continue
            log = robot_log.convert_samples(source, samples, self._robot)
            dropped = len(samples_read.t) - len(samples.t)
            log = replace(log, sha256=self._sha256, dropped=dropped, q_cmd=None, dq_cmd=None)
            self._time = samples.time
            checked = log if last is None else join_records([last, log])
            robot_log.require_increase(checked, samples, before=len(checked.t) - len(log.t))
            last = log.rows(slice(-1, None))
            yield log
        if _read_state(source) != self._state:
            raise LogError(
                f"{source}: was changed while it was read; read it when it is complete.",
                code="log.changed",
                where=source,
            )


def _read_state(source: Log | Path) -> tuple[int, int]:
    """Return size [B] and time of the last change [ns] of a file."""
    status = source.stat() if isinstance(source, Path) else None
    return (status.st_size, status.st_mtime_ns) if status else (0, 0)
