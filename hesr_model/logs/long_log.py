"""Logs that are read in pieces, with memory that does not grow with the rows."""

from collections import Counter
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
_MAX_CHECKED_PIECES = 8


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
        self.values, value_indices = np.unique(values, return_inverse=True)
        self._counts = np.bincount(value_indices, counts).astype(float)

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

    Formats that cannot be read in pieces are held in memory. `checked_pieces` are up to eight of
    the pieces, without `gaps`; `travel` (n,) is the range of the positions [rad, m], `short_rows`
    the number of rows in parts that are too short to use.
    """

    def __init__(
        self, source: Log | Path, description: RobotDescription, max_rows: int = PIECE_ROWS
    ) -> None:
        description.require_one_per_joint()
        self._description = description
        self._rows = max_rows
        self._sha256 = ""
        self._source = self._open(source)
        self._time = ""
        self._state = _read_state(self._source)
        self.checked_pieces: list[Log] = []
        self.travel: Array = np.empty(0)
        self._left_out = Counter[str]()
        whole_part = self._survey()
        longest = whole_part.steps.longest
        parts = [whole_part]
        if whole_part.steps.values[-1] > longest:
            parts = self._split(self._read_pieces(), longest)
            self._keep_longest_parts(longest)
        self._note_left_out_rows()
        self.gaps = len(parts) - 1
        self.longest_step = float(whole_part.steps.values[-1])
        shortest = robot_log.SHORTEST_PART
        self._parts = [
            part for part in parts if part is whole_part or part.end - part.start >= shortest
        ]
        if not self._parts:
            raise robot_log.no_parts_error(self._where, self.gaps, longest)
        used_rows = sum(part.last - part.first for part in self._parts)
        self.short_rows = sum(part.last - part.first for part in parts) - used_rows
        for part in self._parts:
            cutoff = description.log.filter_cutoff
            part.grid.require_filter(self._where, part.last - part.first, cutoff)

    def _open(self, source: Log | Path) -> Log | Path:
        """Return the source, read as a whole if its format has no pieces."""
        if not isinstance(source, Path):
            return source
        first_piece = None
        if not self._description.log.needs_all_rows:
            first_piece = next(read_sample_pieces(source, self._description, self._rows), None)
        self._sha256 = sha256(source)
        if first_piece is None:
            return Log.read(source, self._description)
        return source

    def _survey(self) -> _Part:
        """Return the rows of the whole log, as one part; raise LogError for a wrong rate."""
        parts = self._split(self._survey_pieces(), np.inf)
        row_count = parts[0].last if parts else 0
        robot_log.require_rows(self._where, row_count, self._left_out)
        (whole_part,) = parts
        if isinstance(self._source, Path):
            steps = whole_part.steps
            location = f"{self._where}: {self._time}"
            mean_period = steps.mean(steps.longest)
            robot_log.require_rate(location, steps.period, mean_period, self._description)
        return whole_part

    def _keep_longest_parts(self, longest: float) -> None:
        """Keep of each piece to check the longest part between gaps, of more than `longest` [s]."""
        for k, piece in enumerate(self.checked_pieces):
            self.checked_pieces[k] = max(piece.split(longest), key=lambda part: len(part.t))

    def _note_left_out_rows(self) -> None:
        """State the rows that were left out with the first piece to check, once for all pieces."""
        pieces = [replace(piece, dropped=0, left_out={}) for piece in self.checked_pieces]
        left_out = dict(self._left_out)
        pieces[0] = replace(pieces[0], dropped=self._left_out.total(), left_out=left_out)
        self.checked_pieces = pieces

    @property
    def _where(self) -> str:
        return str(self._source) if isinstance(self._source, Path) else self._source.where

    @property
    def starts(self) -> set[float]:
        """First time stamps [s] of the parts between gaps."""
        return {part.start for part in self._parts}

    def motions(self) -> Iterator[Motion]:
        """Yield the smooth motion piece by piece, as `signals.smooth` of the whole log."""
        cutoff = self._description.log.filter_cutoff
        parts = list(self._parts)
        held_log = None
        next_row = 0
        first_held = 0  # number of the first row in `held_log`
        for log in self._read_pieces():
            held_log = join_records([held_log, log]) if held_log else log
            held_end = first_held + len(held_log.t)
            margin = 0
            while parts:
                part = parts[0]
                grid = parts[0].grid
                margin = int(np.ceil(_OVERLAP_PERIODS / (cutoff * grid.period))) + _SPLINE_MARGIN
                is_complete = held_end >= part.last
                first = max(next_row, part.first)
                last = part.last if is_complete else held_end - margin
                if last <= first:
                    break
                window_first = max(part.first, first - margin)
                window_last = min(part.last, last + margin)
                window_log = held_log.rows(
                    slice(window_first - first_held, window_last - first_held)
                )
                yield filter_log(window_log, cutoff, grid).rows(
                    slice(first - window_first, last - window_first)
                )
                next_row = last
                if not is_complete:
                    break
                parts.pop(0)
            if not parts:
                return
            first_needed = max(next_row - margin, min(parts[0].first, held_end), first_held)
            held_log = held_log.rows(slice(first_needed - first_held, None))
            first_held = first_needed

    def _survey_pieces(self) -> Iterator[Log]:
        """Yield the pieces, and keep pieces to check and the travel."""
        lowest = np.array(np.inf)
        highest = np.array(-np.inf)
        stride = 1
        for k, log in enumerate(self._read_pieces()):
            lowest = np.minimum(lowest, log.q.min(axis=0))
            highest = np.maximum(highest, log.q.max(axis=0))
            self.travel = highest - lowest
            if k % stride == 0 and (k == 0 or 2 * len(log.t) > self._rows):  # checks need many rows
                self.checked_pieces.append(log)
            if len(self.checked_pieces) > _MAX_CHECKED_PIECES:
                self.checked_pieces = self.checked_pieces[::2]
                stride *= 2
            yield log

    def _split(self, logs: Iterable[Log], longest: float) -> list[_Part]:
        """Split the rows of all pieces at steps above `longest` [s]."""
        parts: list[_Part] = []
        row_count = 0
        for log in logs:
            steps = np.diff(log.t, prepend=parts[-1].end if parts else log.t[0])
            starts = {*np.flatnonzero(steps > longest).tolist(), *([] if parts else [0])}
            for first, last in pairwise(sorted({0, *starts, len(log.t)})):
                is_new = first in starts
                if is_new:
                    parts.append(_Part(first=row_count + first, start=float(log.t[first])))
                part = parts[-1]
                part.steps.add(steps[first + is_new : last])
                part.last = row_count + last
                part.end = float(log.t[last - 1])
            row_count += len(log.t)
        return parts

    def _read_pieces(self) -> Iterator[Log]:
        source = self._source
        self._left_out = Counter(source.left_out if isinstance(source, Log) else {})
        if isinstance(source, Log):
            for first in range(0, len(source.t), self._rows):
                yield source.rows(slice(first, first + self._rows))
            return
        last_log: Log | None = None
        for file_samples in read_sample_pieces(source, self._description, self._rows):
            samples = file_samples.sort_samples(
                self._description.log, previous_stamp=last_log.t[-1] if last_log else -np.inf
            )
            self._left_out.update(samples.left_out)
            if not len(samples.t):
                continue
            log = robot_log.convert_samples(source, samples, self._description)
            log = replace(log, sha256=self._sha256, q_cmd=None, dq_cmd=None)
            self._time = samples.time
            if samples.q is None and last_log is not None:
                log = _continue_integral(last_log, log)
            joined_log = log if last_log is None else join_records([last_log, log])
            robot_log.require_increase(
                joined_log, samples, rows_before=len(joined_log.t) - len(log.t)
            )
            last_log = log.rows(slice(-1, None))
            yield log
        if _read_state(source) != self._state:
            raise LogError(
                f"{source}: was changed while it was read; read it when it is complete.",
                code="log.changed",
                where=source,
            )


def _continue_integral(last_log: Log, log: Log) -> Log:
    """Return a piece whose integrated position continues from the row before it."""
    assert last_log.dq is not None
    assert log.dq is not None
    stamps = np.concatenate([last_log.t[-1:], log.t[:1]])
    speeds = np.concatenate([last_log.dq[-1:], log.dq[:1]])
    return replace(log, q=log.q + last_log.q[-1] + robot_log.integrate_velocity(stamps, speeds)[-1])


def _read_state(source: Log | Path) -> tuple[int, int]:
    """Return size [B] and time of the last change [ns] of a file."""
    if not isinstance(source, Path):
        return 0, 0
    status = source.stat()
    return status.st_size, status.st_mtime_ns
