"""Folds: each leaves out a part of the logs, on which what the rest determines is judged."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hesr_model.logs.signals import Motion, find_settled_rows, resting_speeds, reversals
from hesr_model.support.arrays import Array, Mask

FOLD_COUNT = 5
MIN_FOLDS = 3  # with fewer on a joint, nothing is chosen for it
_GUARD = 0.1  # [s] around judged rows, not trained on: smoothing and memory couple neighbours
_MIN_PIECE_SECONDS = 0.5
_MIN_PIECE_ROWS = 20
MAX_RATE = 200.0  # [Hz] of the rows that are fitted


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """Motions without the judged rows, and the judged rows.

    Attributes
    ----------
    training : pieces of the motions without the judged rows and 0.1 s around them.
    judged : by motion, mask (N,) of the rows that this fold judges.
    """

    training: tuple[Motion, ...]
    judged: tuple[Mask, ...]

    @cached_property
    def resting_speeds(self) -> Array:
        """Speeds (n,) [rad/s] at or below which joints rest."""
        return resting_speeds(self.training)

    def reverses(self, j: int) -> bool:
        """Return whether a joint reverses in the training pieces."""
        resting_speed = float(self.resting_speeds[j])
        for piece in self.training:
            settled_dq = piece.dq[find_settled_rows(piece.t), j]
            if len(reversals(settled_dq, resting_speed)):
                return True
        return False


def split_into_folds(motions: Sequence[Motion], count: int = FOLD_COUNT) -> list[Fold]:
    """Split motions into folds, of which each row is judged by exactly one.

    With at least `count` logs, whole logs are left out in turn; otherwise equal blocks of time
    over all logs. Parts of a log between gaps have its name.

    Parameters
    ----------
    motions : smoothed logs, or their parts between gaps.
    count : number of folds.
    """
    names = [motion.name for motion in motions]
    fold_of_rows = number_rows(names, [motion.t for motion in motions], count)
    folds = []
    for number in range(count):
        judged = tuple(fold_numbers == number for fold_numbers in fold_of_rows)
        training: list[Motion] = []
        for motion, is_judged in zip(motions, judged, strict=True):
            training += _remove_judged_rows(motion, is_judged)
        folds.append(Fold(training=tuple(training), judged=judged))
    return folds


def mask_rows(
    names: Sequence[str], times: Sequence[Array], number: int, count: int = FOLD_COUNT
) -> tuple[list[Mask], list[Mask]]:
    """Return masks of the rows that a fold judges, and of those it may fit, by log.

    They are those of `split_into_folds`, but for its pieces that are too short.

    Parameters
    ----------
    names : of each log; parts of a log have one name.
    times : (N,) [s] of each log.
    number, count : of the fold, from 0, and of all folds.
    """
    judged = [fold_numbers == number for fold_numbers in number_rows(names, times, count)]
    trained = []
    for t, is_judged in zip(times, judged, strict=True):
        judged_times = t[is_judged]
        if len(judged_times):
            is_before = t < judged_times[0] - _GUARD
            is_after = t > judged_times[-1] + _GUARD
            trained.append(is_before | is_after)
        else:
            trained.append(np.ones(len(t), dtype=bool))
    return judged, trained


def number_rows(names: Sequence[str], times: Sequence[Array], count: int) -> list[Array]:
    """Return the number of the fold of each row, by log."""
    distinct_names = list(dict.fromkeys(names))
    if len(distinct_names) < count:
        return _number_blocks(times, count)
    fold_of_log = {name: index % count for index, name in enumerate(distinct_names)}
    return [np.full(len(t), fold_of_log[name]) for name, t in zip(names, times, strict=True)]


def _number_blocks(times: Sequence[Array], count: int) -> list[Array]:
    """Return the number of the block of each row, by log."""
    durations = [float(t[-1] - t[0]) for t in times]
    block_length = sum(durations) / count
    starts = np.cumsum([0.0, *durations[:-1]])
    return [
        np.minimum((start + t - t[0]) // block_length, count - 1)
        for start, t in zip(starts, times, strict=True)
    ]


def _remove_judged_rows(motion: Motion, is_judged: Mask) -> Iterator[Motion]:
    """Yield the pieces of a motion that are left without judged rows and their guard."""
    if not is_judged.any():
        yield motion
        return
    judged_rows = np.flatnonzero(is_judged)
    first = motion.t[judged_rows[0]] - _GUARD
    last = motion.t[judged_rows[-1]] + _GUARD
    for rows in (motion.t < first, motion.t > last):
        count = int(np.count_nonzero(rows))
        if count >= _MIN_PIECE_ROWS and np.ptp(motion.t[rows]) >= _MIN_PIECE_SECONDS:
            yield motion.rows(rows)


def thin(motion: Motion) -> Motion:
    """Return every k-th row of a motion, such that its rate is at least `MAX_RATE`.

    Motions are smoothed to far lower frequencies, so that a faster rate adds cost only.
    """
    stride = int(1.0 / MAX_RATE / float(np.median(np.diff(motion.t))) + 1e-9)
    if stride < 2:
        return motion
    return motion.rows(slice(None, None, stride))
