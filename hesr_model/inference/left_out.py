"""Errors of laws on left-out rows: what each law predicts where neither it nor the body was fitted.

The standard error of the log ratio of two RMSEs comes from the influence of blocks of time, with a
correction for the correlation of neighbouring blocks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from hesr_model.support.arrays import Array, Integers, Mask

_MIN_BLOCK = 0.25  # [s]
_MAX_BLOCK = 2.0  # [s]
_BLOCK_COUNT = 40  # blocks of all logs, unless they become too short or too long
_MAX_CORRELATION = 0.8  # of neighbouring blocks; estimates above it are not reliable
_MIN_LOGS = 4  # from which differences between logs are known well enough to count
_MIN_SQUARE = 1e-300


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOutErrors:
    """Errors of laws on the rows that each fold left out.

    Attributes
    ----------
    joints : names.
    t : by log, (N,) [s].
    log_names : by log; parts of a log between gaps share a name.
    fold_of_row : by log, (N,) number of the fold that judges each row.
    errors : by law and log, predicted less measured friction at friction coordinates,
        (N, n) [N.m].
    joint_errors : the same at joints; equal to `errors` for uncoupled joints.
    tau : by log, measured friction (N, n) [N.m] that `errors` refer to.
    dq, tau_load : by log, velocity [rad/s] and load [N.m] of these rows, (N, n).
    counts : (folds, n) whether a fold judges a joint: its training part reverses the joint, at
        more than one speed.
    failed : reasons of laws that cannot be fitted in a fold, by law.
    """

    joints: tuple[str, ...]
    t: tuple[Array, ...]
    log_names: tuple[str, ...]
    fold_of_row: tuple[Integers, ...]
    errors: Mapping[str, tuple[Array, ...]]
    joint_errors: Mapping[str, tuple[Array, ...]]
    tau: tuple[Array, ...]
    dq: tuple[Array, ...]
    tau_load: tuple[Array, ...]
    counts: Mask
    failed: Mapping[str, str]

    @property
    def laws(self) -> tuple[str, ...]:
        """Laws that could be fitted in every fold."""
        return tuple(self.errors)

    @property
    def fold_count(self) -> int:
        """Number of folds."""
        return len(self.counts)

    @cached_property
    def seconds(self) -> float:
        """Duration of all logs [s]."""
        return sum(float(t[-1] - t[0]) for t in self.t)

    @cached_property
    def _blocks(self) -> list[tuple[int, slice, int, float]]:
        """Log, rows, fold and duration [s] of every block."""
        length = max(_MIN_BLOCK, min(_MAX_BLOCK, self.seconds / _BLOCK_COUNT))
        blocks = []
        for log, (t, folds) in enumerate(zip(self.t, self.fold_of_row, strict=True)):
            block_of_row = np.floor((t - t[0]) / length)
            changes = (np.diff(block_of_row) > 0) | (np.diff(folds) != 0)
            edges = [0, *(np.flatnonzero(changes) + 1), len(t)]
            for start, stop in pairwise(edges):
                seconds = float(t[stop - 1] - t[start])
                blocks.append((log, slice(start, stop), int(folds[start]), seconds))
        return blocks

    @cached_property
    def _block_rows(self) -> Array:
        return np.array([rows.stop - rows.start for _, rows, _, _ in self._blocks], dtype=float)

    @cached_property
    def _squares(self) -> dict[str, Array]:
        """Sums of squared errors by law, (blocks, n)."""
        squares: dict[str, Array] = {}
        for law_name, law_errors in self.errors.items():
            block_sums = [
                (law_errors[log][rows] ** 2).sum(axis=0) for log, rows, _, _ in self._blocks
            ]
            squares[law_name] = np.stack(block_sums)
        return squares

    @cached_property
    def _is_counted(self) -> Mask:
        """Whether each block counts for each joint, (blocks, n)."""
        return np.stack([self.counts[fold] for _, _, fold, _ in self._blocks])

    def fold_counts(self, j: int) -> int:
        """Return the number of folds that judge a joint."""
        return int(np.count_nonzero(self.counts[:, j]))

    def block_count(self, j: int) -> int:
        """Return the number of blocks that are judged on a joint."""
        return int(np.count_nonzero(self._is_counted[:, j]))

    def judged_rows(self, j: int) -> list[Mask]:
        """Return by log the rows (N,) that a fold judges on a joint."""
        return [self.counts[fold_numbers, j] for fold_numbers in self.fold_of_row]

    def rmse(self, law_name: str, j: int, fold: int | None = None) -> float:
        """Return the RMSE [N.m] of a law on a joint over all folds that judge it, or over one.

        It is NaN without such rows.
        """
        is_counted = self._is_counted[:, j]
        if fold is not None:
            is_counted = is_counted & (self._folds == fold)
        row_count = self._block_rows[is_counted].sum()
        if not row_count:
            return float("nan")
        return float(np.sqrt(self._squares[law_name][is_counted, j].sum() / row_count))

    @cached_property
    def _folds(self) -> Integers:
        return np.array([fold for _, _, fold, _ in self._blocks])

    def log_ratio(self, law_name: str, other: str, j: int) -> float:
        """Return the logarithm of the ratio of two laws' RMSEs on a joint."""
        squares = [max(self.rmse(name, j) ** 2, _MIN_SQUARE) for name in (law_name, other)]
        return 0.5 * float(np.log(squares[0] / squares[1]))

    def standard_error(self, law_name: str, other: str, j: int) -> float:
        """Return the standard error of `log_ratio`; infinite with fewer than three blocks.

        From four logs on it is at least that of the differences between logs.
        """
        return max(self._standard_errors(law_name, other, j))

    def degrees_of_freedom(self, law_name: str, other: str, j: int) -> int:
        """Return those of Student's t for an interval of `log_ratio`.

        They are those of logs if differences between logs decide, else those of blocks.
        """
        within, between = self._standard_errors(law_name, other, j)
        if between > within:
            return self._count_logs(j) - 1
        return max(self.block_count(j) - 1, 1)

    def _standard_errors(self, law_name: str, other: str, j: int) -> tuple[float, float]:
        """Return the standard errors from blocks and from logs; 0 from fewer than four logs."""
        is_counted = self._is_counted[:, j]
        count = int(np.count_nonzero(is_counted))
        if count < 3:
            return float("inf"), 0.0
        rows = self._block_rows[is_counted]
        mean_rows = rows.mean()
        influences = np.zeros(count)
        for name, sign in ((law_name, 0.5), (other, -0.5)):
            squares = self._squares[name][is_counted, j]
            total = max(squares.sum(), _MIN_SQUARE)
            influences += sign * (squares / total * count - rows / mean_rows)
        correlation = _correlate_neighbours(influences)
        widening = (1.0 + correlation) / (1.0 - correlation)
        within = float(np.sqrt(np.var(influences, ddof=1) / count * widening))
        return within, self._error_between_logs(influences, is_counted)

    def _count_logs(self, j: int) -> int:
        is_counted = self._is_counted[:, j]
        pairs = zip(self._blocks, is_counted, strict=True)
        return len({self.log_names[log] for (log, *_), counted in pairs if counted})

    def _error_between_logs(self, influences: Array, is_counted: Mask) -> float:
        logs = [
            self.log_names[log]
            for (log, *_), counted in zip(self._blocks, is_counted, strict=True)
            if counted
        ]
        names = sorted(set(logs))
        if len(names) < _MIN_LOGS:
            return 0.0
        log_of_block = np.array([names.index(name) for name in logs])
        sums = np.bincount(log_of_block, weights=influences) / len(influences)
        return float(np.sqrt(len(names) / (len(names) - 1.0) * np.sum(sums**2)))

    def mean_standard_error(self, law_name: str, other: str, joint_indices: Sequence[int]) -> float:
        """Return the standard error, over folds, of the mean log ratio of some joints."""
        fold_means = []
        for fold in range(self.fold_count):
            ratios = [
                np.log(self.rmse(law_name, j, fold) / self.rmse(other, j, fold))
                for j in joint_indices
                if self.counts[fold, j]
            ]
            if ratios:
                fold_means.append(float(np.mean(ratios)))
        if len(fold_means) < 2:
            return float("inf")
        return float(np.std(fold_means, ddof=1) / np.sqrt(len(fold_means)))

    def worst_fold(self, law_name: str, other: str, j: int) -> float:
        """Return the largest ratio of two laws' RMSEs on a joint among the folds."""
        ratios = [
            self.rmse(law_name, j, fold) / max(self.rmse(other, j, fold), _MIN_SQUARE)
            for fold in range(self.fold_count)
            if self.counts[fold, j] and np.isfinite(self.rmse(other, j, fold))
        ]
        return max(ratios, default=float("nan"))

    def friction_size(self, j: int) -> float:
        """Return the standard deviation [N.m] of the measured friction over judged rows."""
        judged = [
            tau[self.counts[folds, j], j]
            for tau, folds in zip(self.tau, self.fold_of_row, strict=True)
        ]
        rows = np.concatenate(judged)
        if not len(rows):
            return float("nan")
        return float(np.std(rows))

    def moving_seconds(self, j: int) -> float:
        """Return the duration [s] of the rows that are judged on a joint."""
        pairs = zip(self._blocks, self._is_counted[:, j], strict=True)
        return sum(seconds for (*_, seconds), is_counted in pairs if is_counted)


def _correlate_neighbours(influences: Array) -> float:
    """Return the correlation of neighbouring blocks, from 0 to `_MAX_CORRELATION`."""
    variance = float(np.sum(influences**2))
    if variance <= 0.0:
        return 0.0
    correlation = float(np.sum(influences[1:] * influences[:-1])) / variance
    return min(max(correlation, 0.0), _MAX_CORRELATION)
