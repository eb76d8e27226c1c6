"""Folds: each leaves out a part of the logs, on which what the rest determines is judged."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hesr_model.logs.signals import Motion, resting_speeds, reversals
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
        return any(
            len(reversals(piece.dq[:, j], float(self.resting_speeds[j]))) > 0
            for piece in self.training
        )


def split_into_folds(motions: Sequence[Motion], count: int = FOLD_COUNT) -> list[Fold]:
    """Split motions into folds, of which each row is judged by exactly one.

    With at least `count` logs, whole logs are left out in turn; otherwise equal blocks of time
    over all logs. Parts of a log between gaps have its name.

    Parameters
    ----------
    motions : smoothed logs, or their parts between gaps.
    count : number of folds.
    """
    names = list(dict.fromkeys(motion.name for motion in motions))
    if len(names) >= count:
        fold_of_log = {name: index % count for index, name in enumerate(names)}
        fold_of_rows = [np.full(len(motion.t), fold_of_log[motion.name]) for motion in motions]
    else:
        fold_of_rows = _number_blocks(motions, count)
    folds = []
    for number in range(count):
        judged = tuple(fold_numbers == number for fold_numbers in fold_of_rows)
        pairs = zip(motions, judged, strict=True)
        training = tuple(piece for pair in pairs for piece in _cut_out(*pair))
        folds.append(Fold(training=training, judged=judged))
    return folds


def _number_blocks(motions: Sequence[Motion], count: int) -> list[Array]:
    """Return the number of the block of each row, by motion."""
    durations = [float(motion.t[-1] - motion.t[0]) for motion in motions]
    block_length = sum(durations) / count
    starts = np.cumsum([0.0, *durations[:-1]])
    return [
        np.minimum((start + motion.t - motion.t[0]) // block_length, count - 1)
        for motion, start in zip(motions, starts, strict=True)
    ]


def _cut_out(motion: Motion, is_judged: Mask) -> Iterator[Motion]:
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
    return motion if stride < 2 else motion.rows(slice(None, None, stride))
