"""Least squares with signs on normal equations: on all rows, and with folds left out in turn."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Self

import numpy as np
from scipy.optimize import nnls

from hesr_model.fitting.joint_rows import in_one_piece
from hesr_model.fitting.ties import ROUND_OFF
from hesr_model.support.arrays import Array, Mask

_RIDGE = 1e-9  # of each column's own square: columns may be each other's sums


class Normal:
    """Normal equations of columns whose coefficients are non-negative, but for the last ones.

    Parameters
    ----------
    blocks : of columns (N, k), in any units, which are weighted already.
    products : of these columns and the target.
    free : how many of the last columns may have any sign.
    """

    @classmethod
    def of(
        cls, columns: Array, tau: Array, folds: Sequence[Mask], weights: Array, *, free: int
    ) -> Self:
        """Return the equations of columns (N, K) and (N,) `tau`; see `Products` for the others."""
        return cls([weights[:, None] * columns], Products(tau, folds, weights), free=free)

    def __init__(self, blocks: Sequence[Array], products: "Products", *, free: int) -> None:
        self._blocks, self._products, self._free = blocks, products, free
        places = np.cumsum([0, *(block.shape[1] for block in blocks)])
        self._places = [slice(a, b) for a, b in pairwise(places)]
        folds = len(products.folds)
        self._grams, self._moments = (
            np.empty((folds, places[-1], *more)) for more in ((places[-1],), ())
        )
        for i, a in enumerate(self._places):
            self._moments[:, a] = products.of(blocks[i], products.tau)[:, :, 0]
            for j, b in enumerate(self._places[: i + 1]):
                found = products.of(blocks[i], blocks[j])
                self._grams[:, a, b], self._grams[:, b, a] = found, found.swapaxes(1, 2)
        self.gram, self.moment = self._grams.sum(axis=0), self._moments.sum(axis=0)

    def solve(self) -> Array:
        """Return the (K,) coefficients that explain all rows best."""
        return signed_least_squares(self.gram, self.moment, self._free)

    def left_out(self) -> Array:
        """Return the (N,) errors on each fold of coefficients solved on the other rows."""
        errors = -self._products.tau[:, 0]
        rest = zip(self.gram - self._grams, self.moment - self._moments, strict=True)
        for fold, (gram, moment) in zip(self._products.folds, rest, strict=True):
            x = signed_least_squares(gram, moment, self._free)
            for block, place in zip(self._blocks, self._places, strict=True):
                errors[fold] += block[fold] @ x[place]
        return errors


class Products:
    """Products of columns with each other over each fold, computed once for each pair.

    Parameters
    ----------
    tau : (N,) in any unit.
    folds : (N,) masks of the rows that are left out in turn.
    weights : (N,) 1 for rows that count, 0 for others.
    """

    def __init__(self, tau: Array, folds: Sequence[Mask], weights: Array) -> None:
        self.tau: Array = (weights * tau)[:, None]
        self.folds = [in_one_piece(fold) for fold in folds]
        # Arrays are known by their identity: they are kept, so that no other can have it.
        self._known: dict[tuple[int, int], tuple[Array, Array, Array]] = {}

    def of(self, a: Array, b: Array) -> Array:
        """Return (folds, k, l) products of two blocks (N, k) and (N, l)."""
        key = id(a), id(b)
        if key not in self._known:
            found = np.array([a[fold].T @ b[fold] for fold in self.folds])
            self._known[key] = a, b, found
        return self._known[key][2]


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


def blocks_of(dt: Array, begins: Mask, seconds: float = 8.0, least: int = 8) -> Any:
    """Return the (N,) number of each row's block of time, which ends with its record at the latest.

    Blocks are shorter where there would be fewer than `least`.
    """
    length = min(seconds, float(dt.sum()) / least)
    clock = np.cumsum(np.where(begins, 0.0, dt))
    since = clock - np.maximum.accumulate(np.where(begins, clock, 0.0))
    whole = np.floor(since / max(length, 1e-300)).astype(int)
    return np.cumsum(begins | (np.diff(whole, prepend=-1) > 0)) - 1


def pays(before: Array, after: Array, blocks: Any) -> bool:
    """Return whether errors fall by more than a standard error of the gain over blocks of time.

    A gain of round-off does not count.

    Parameters
    ----------
    before, after : (N,) errors on left-out rows.
    blocks : (N,) number of each row's block.
    """
    gains = np.bincount(blocks, weights=before**2 - after**2)
    if len(gains) < 2:
        return False
    least = np.sqrt(len(gains)) * gains.std(ddof=1) + ROUND_OFF * float(before @ before)
    return bool(gains.sum() > least)
