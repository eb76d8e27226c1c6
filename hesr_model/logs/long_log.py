"""Logs that are read in pieces, with memory that does not grow with the rows."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs import robot_log
from hesr_model.logs.readers.formats import sample_pieces
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Grid, Motion, filtered
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array, joined
from hesr_model.support.files import sha256

ROWS = 2**14  # rows of a piece
_DISTINCT = 2**20
_DIGITS = 2.0**16  # most steps kept exactly; digits of more
_SETTLED = 10.0  # overlap in periods of the cut-off; transients decay to 1e-19
_SPLINE = 100  # rows after which the ends of a spline do not matter
_STRETCHES = 8  # most pieces kept for checks


class StepCounts:
    """Distinct time steps [s] of a log, and how often they occur."""

    def __init__(self) -> None:
        self.values: Array = np.empty(0)
        self._counts: Array = np.empty(0)

    def add(self, steps: Array) -> None:
        """Add steps (N,)."""
        counts = np.concatenate([self._counts, np.ones(len(steps))])
        values = np.concatenate([self.values, steps])
        if len(values) > _DISTINCT:
            mantissa, exponent = np.frexp(values)
            values = np.ldexp(np.rint(mantissa * _DIGITS) / _DIGITS, exponent)
        self.values, places = np.unique(values, return_inverse=True)
        self._counts = np.bincount(places, counts).astype(float)

    def _at(self, *places: int) -> Array:
        return self.values[np.searchsorted(np.cumsum(self._counts), places, side="right")]

    @property
    def period(self) -> float:
        """Median [s]."""
        count = int(self._counts.sum())
        return float(np.mean(self._at((count - 1) // 2, count // 2)))

    @property
    def longest(self) -> float:
        """Step [s] above which there is a gap, as `Log.longest_step`."""
        (most,) = self._at(int(robot_log.USUAL * (self._counts.sum() - 1)))
        return robot_log.LONGEST_GAP * max(self.period, self.mean(most))

    def mean(self, longest: float) -> float:
        """Mean [s] of the steps up to `longest` [s]."""
        usual = self.values <= longest
        return float(np.average(self.values[usual], weights=self._counts[usual]))


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

    def __init__(self, source: Log | Path, robot: RobotDescription, rows: int = ROWS) -> None:
        robot.require_one_per_joint()
        self._robot = robot
        self._rows = rows
        self._sha256 = ""
        if isinstance(source, Path):
            in_pieces = not robot.log.sort and next(sample_pieces(source, robot, rows), None)
            self._sha256 = sha256(source)
            source = source if in_pieces else Log.read(source, robot)
        self._source = source
        self._time = ""
        self._state = _state(source)
        self.stretches: list[Log] = []
        self.travel: Array = np.empty(0)
        self._dropped = 0
        parts = self._split(self._survey_pieces(), np.inf)
        robot_log.require_rows(self._where, parts[0].last if parts else 0)
        (whole,) = parts
        longest = whole.steps.longest
        if isinstance(source, Path):
            place = f"{self._where}: {self._time}"
            robot_log.require_rate(place, whole.steps.period, whole.steps.mean(longest), robot)
        if whole.steps.values[-1] > longest:
            parts = self._split(self._pieces(), longest)
            pieces = (log.split(longest) for log in self.stretches)
            self.stretches = [max(logs, key=lambda piece: len(piece.t)) for logs in pieces]
        self.stretches = [
            replace(log, dropped=0 if k else self._dropped) for k, log in enumerate(self.stretches)
        ]
        self.gaps = len(parts) - 1
        self.longest_step = float(whole.steps.values[-1])
        shortest = robot_log.SHORTEST_PART
        self._parts = [p for p in parts if p is whole or p.end - p.start >= shortest]
        if not self._parts:
            raise robot_log.without_parts(self._where, len(parts) - 1, longest)
        for part in self._parts:
            cutoff = robot.log.filter_cutoff
            part.grid.require(self._where, part.last - part.first, cutoff)

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
        held = None
        done = 0
        at = 0  # rows held from number `at`
        for log in self._pieces():
            held = joined([held, log]) if held else log
            there = at + len(held.t)
            margin = 0
            while parts:
                part = parts[0]
                grid = parts[0].grid
                margin = int(np.ceil(_SETTLED / (cutoff * grid.period))) + _SPLINE
                complete = there >= part.last
                first = max(done, part.first)
                last = part.last if complete else there - margin
                if last <= first:
                    break
                low = max(part.first, first - margin)
                high = min(part.last, last + margin)
                window = held.rows(slice(low - at, high - at))
                yield filtered(window, cutoff, grid).rows(slice(first - low, last - low))
                done = last
                if not complete:
                    break
                parts.pop(0)
            if not parts:
                return
            keep = max(done - margin, min(parts[0].first, there), at)
            held, at = held.rows(slice(keep - at, None)), keep

    def _survey_pieces(self) -> Iterator[Log]:
        """Yield the pieces, and keep stretches, travel and the number of rows left out."""
        low = np.array(np.inf)
        high = np.array(-np.inf)
        every = 1
        for k, log in enumerate(self._pieces()):
            self._dropped += log.dropped
            low, high = np.minimum(low, log.q.min(axis=0)), np.maximum(high, log.q.max(axis=0))
            self.travel = high - low
            if k % every == 0 and (k == 0 or 2 * len(log.t) > self._rows):  # checks need many rows
                self.stretches.append(log)
            if len(self.stretches) > _STRETCHES:
                self.stretches, every = self.stretches[::2], 2 * every
            yield log

    def _split(self, pieces: Iterable[Log], longest: float) -> list[_Part]:
        """Split the rows of all pieces at steps above `longest` [s]."""
        parts: list[_Part] = []
        rows = 0
        for log in pieces:
            steps = np.diff(log.t, prepend=parts[-1].end if parts else log.t[0])
            starts = {*np.flatnonzero(steps > longest).tolist(), *([] if parts else [0])}
            for first, last in pairwise(sorted({0, *starts, len(log.t)})):
                new = first in starts
                if new:
                    parts.append(_Part(first=rows + first, start=float(log.t[first])))
                part = parts[-1]
                part.steps.add(steps[first + new : last])
                part.last = rows + last
                part.end = float(log.t[last - 1])
            rows += len(log.t)
        return parts

    def _pieces(self) -> Iterator[Log]:
        source = self._source
        if isinstance(source, Log):
            for first in range(0, len(source.t), self._rows):
                yield source.rows(slice(first, first + self._rows))
            return
        last: Log | None = None
        for read in sample_pieces(source, self._robot, self._rows):
            samples = read.sort_samples(self._robot.log, after=last.t[-1] if last else -np.inf)
            if not len(samples.t):
                continue
            log = robot_log.log_of(source, samples, self._robot)
            dropped = len(read.t) - len(samples.t)
            log = replace(log, sha256=self._sha256, dropped=dropped, q_cmd=None, dq_cmd=None)
            self._time = samples.time
            checked = log if last is None else joined([last, log])
            robot_log.require_increase(checked, samples, before=len(checked.t) - len(log.t))
            last = log.rows(slice(-1, None))
            yield log
        if _state(source) != self._state:
            raise LogError(
                f"{source}: was changed while it was read; read it when it is complete.",
                code="log.changed",
                where=source,
            )


def _state(source: Log | Path) -> tuple[int, int]:
    """Return size [B] and time of the last change [ns] of a file."""
    about = source.stat() if isinstance(source, Path) else None
    return (about.st_size, about.st_mtime_ns) if about else (0, 0)
