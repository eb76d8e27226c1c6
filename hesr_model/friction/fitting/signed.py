"""Least squares with signs on normal equations: on all rows, and with folds left out in turn."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import nnls

from hesr_model.equations.over_log import Array
from hesr_model.friction.fitting.samples import Rows

_RIDGE = 1e-9  # of each column's own square: columns may be each other's sums


class Normal:
    """Normal equations of columns whose coefficients are non-negative, but for the last ones.

    Parameters
    ----------
    columns, tau : (N, K) and (N,), in any units.
    folds : (N,) masks of the rows that are left out in turn.
    weights : (N,) 1 for rows that count, 0 for others.
    free : how many of the last columns may have any sign.
    """

    def __init__(
        self, columns: Array, tau: Array, folds: Sequence[Rows], weights: Array, *, free: int
    ) -> None:
        self._columns, self._tau, self._folds = weights[:, None] * columns, weights * tau, folds
        self._free = free
        self._parts = [_products(self._columns[fold], self._tau[fold]) for fold in folds]
        self.gram = np.sum([gram for gram, _ in self._parts], axis=0)
        self.moment = np.sum([moment for _, moment in self._parts], axis=0)

    def solve(self) -> Array:
        """Return the (K,) coefficients that explain all rows best."""
        return signed_least_squares(self.gram, self.moment, self._free)

    def left_out(self) -> Array:
        """Return the (N,) errors on each fold of coefficients solved on the other rows."""
        errors = np.empty_like(self._tau)
        for fold, (gram, moment) in zip(self._folds, self._parts, strict=True):
            x = signed_least_squares(self.gram - gram, self.moment - moment, self._free)
            errors[fold] = self._columns[fold] @ x - self._tau[fold]
        return errors


def _products(columns: Array, tau: Array) -> tuple[Array, Array]:
    return columns.T @ columns, columns.T @ tau


def signed_least_squares(gram: Array, moment: Array, free: int) -> Array:
    """Return the (K,) coefficients x >= 0, but for the last `free`, least in x G x / 2 - m x.

    Parameters
    ----------
    gram : (K, K) products of the columns.
    moment : (K,) products of columns and target.
    free : how many of the last ones may have any sign; they are eliminated.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    g, m = gram * scale * scale[:, None] + _RIDGE * np.eye(len(scale)), moment * scale
    signed = len(m) - free
    # Of the free ones, given the others: b - c x.
    both = np.linalg.solve(g[signed:, signed:], np.c_[m[signed:], g[signed:, :signed]])
    b, c = both[:, 0], both[:, 1:]
    root = np.linalg.cholesky(g[:signed, :signed] - g[:signed, signed:] @ c)
    target = np.linalg.solve(root, m[:signed] - g[:signed, signed:] @ b)
    # SciPy's own ends the program where there is nothing to solve for.
    x = nnls(root.T, target, maxiter=100 * len(scale))[0] if signed else np.zeros(0)
    return np.asarray(np.concatenate([x, b - c @ x]) * scale)


def blocks_of(dt: Array, begins: Rows, seconds: float = 8.0, least: int = 8) -> Any:
    """Return the (N,) number of each row's block of time, which ends with its record at the latest.

    Blocks are shorter where there would be fewer than `least`.
    """
    length = min(seconds, float(dt.sum()) / least)
    clock = np.cumsum(np.where(begins, 0.0, dt))
    since = clock - np.maximum.accumulate(np.where(begins, clock, 0.0))
    whole = np.floor(since / max(length, 1e-300)).astype(int)
    return np.cumsum(begins | (np.diff(whole, prepend=-1) > 0)) - 1


def pays(before: Array, after: Array, blocks: Any) -> bool:
    """Whether errors fall by more than one standard error of the gain over blocks of time.

    Parameters
    ----------
    before, after : (N,) errors on left-out rows.
    blocks : (N,) number of each row's block.
    """
    gains = np.bincount(blocks, weights=before**2 - after**2)
    return bool(gains.sum() > np.sqrt(len(gains)) * gains.std(ddof=1)) if len(gains) > 1 else False
