"""Least squares with sign constraints by normal equations, for all rows and cross-validation."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Self

import numpy as np
from scipy.optimize import nnls

from hesr_model.fitting.joint_rows import in_one_piece
from hesr_model.fitting.ties import ROUND_OFF
from hesr_model.support.arrays import Array, Mask

_RIDGE = 1e-9  # relative to each column's square; columns may be dependent


class Normal:
    """Normal equations of weighted blocks (N, k); all but the last `free` are non-negative."""

    @classmethod
    def of(
        cls, columns: Array, tau: Array, folds: Sequence[Mask], weights: Array, *, free: int
    ) -> Self:
        """Return the equations of columns (N, K)."""
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
        """Return the (K,) coefficients for all rows."""
        return signed_least_squares(self.gram, self.moment, self._free)

    def left_out(self) -> Array:
        """Return the (N,) errors of cross-validation."""
        errors = -self._products.tau[:, 0]
        rest = zip(self.gram - self._grams, self.moment - self._moments, strict=True)
        for fold, (gram, moment) in zip(self._products.folds, rest, strict=True):
            x = signed_least_squares(gram, moment, self._free)
            for block, place in zip(self._blocks, self._places, strict=True):
                errors[fold] += block[fold] @ x[place]
        return errors


class Products:
    """Products of columns over each fold, computed once per pair; `weights` (N,) are 1 or 0."""

    def __init__(self, tau: Array, folds: Sequence[Mask], weights: Array) -> None:
        self.tau: Array = (weights * tau)[:, None]
        self.folds = [in_one_piece(fold) for fold in folds]
        # Keys are identities of arrays, which are kept so that they stay unique.
        self._known: dict[tuple[int, int], tuple[Array, Array, Array]] = {}

    def of(self, a: Array, b: Array) -> Array:
        """Return (folds, k, l) products of two blocks (N, k) and (N, l)."""
        key = id(a), id(b)
        if key not in self._known:
            found = np.array([a[fold].T @ b[fold] for fold in self.folds])
            self._known[key] = a, b, found
        return self._known[key][2]


def signed_least_squares(gram: Array, moment: Array, free: int) -> Array:
    """Minimise x G x / 2 - m x over x (K,) with x >= 0, apart from the last `free` ones."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    g, m = gram * scale * scale[:, None] + _RIDGE * np.eye(len(scale)), moment * scale
    signed = len(m) - free
    both = np.linalg.solve(g[signed:, signed:], np.c_[m[signed:], g[signed:, :signed]])
    b, c = both[:, 0], both[:, 1:]
    root = np.linalg.cholesky(g[:signed, :signed] - g[:signed, signed:] @ c)
    target = np.linalg.solve(root, m[:signed] - g[:signed, signed:] @ b)
    # With no unknowns SciPy's nnls aborts the process.
    x = nnls(root.T, target, maxiter=100 * len(scale))[0] if signed else np.zeros(0)
    return np.asarray(np.concatenate([x, b - c @ x]) * scale)


def blocks_of(dt: Array, begins: Mask, seconds: float = 8.0, least: int = 8) -> Any:
    """Return the (N,) index of each row's block of `seconds`, or less to have `least` blocks."""
    length = min(seconds, float(dt.sum()) / least)
    clock = np.cumsum(np.where(begins, 0.0, dt))
    since = clock - np.maximum.accumulate(np.where(begins, clock, 0.0))
    whole = np.floor(since / max(length, 1e-300)).astype(int)
    return np.cumsum(begins | (np.diff(whole, prepend=-1) > 0)) - 1


def pays(before: Array, after: Array, blocks: Any) -> bool:
    """Return True if errors (N,) fall by more than one standard error of the gain over blocks."""
    gains = np.bincount(blocks, weights=before**2 - after**2)
    if len(gains) < 2:
        return False
    least = np.sqrt(len(gains)) * gains.std(ddof=1) + ROUND_OFF * float(before @ before)
    return bool(gains.sum() > least)
