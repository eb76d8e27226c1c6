"""Rows of all records of one joint, linear and sign-constrained least squares on them, and ties.

Round-off differs between processors: among candidates within a tolerance the first one, which
callers make the simplest, wins.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np
import scipy

from hesr_model.equations.functions import to_numpy_function
from hesr_model.equations.recurrence import recurrence
from hesr_model.errors import FitError
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import SETTLING
from hesr_model.inference.covariance import blocks_of_time
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import require_reversals
from hesr_model.support.arrays import Array, Integers, Mask


@dataclass(frozen=True, kw_only=True)
class JointRows:
    """Rows of several records of one joint in sequence."""

    dt: Array  # (N,) [s] since the previous row, 0 at the first of a record
    begins: Mask  # (N,) at the first row of a record
    log_index: Integers  # (N,) index of the log; parts of a log have the same one
    dq: Array
    q: Array
    tau_load: Array
    tau: Array
    gear_ratio: float | None = None  # turns of the motor per turn of the joint
    sliding: bool = False  # in m and N

    @property
    def folds(self) -> "list[Mask]":
        """(N,) masks of the rows left out in turn: logs, or blocks of time of a single log."""
        labels = blocks_of_time(self.log_index)
        return [np.asarray(labels == k) for k in range(int(labels.max()) + 1)]

    @classmethod
    def from_records(
        cls, joint_records: Sequence[FrictionRecord], *, coefficients: int
    ) -> "JointRows":
        """Join the records of one joint; raises FitError or LogError if they do not suffice."""
        row_count = sum(len(record.t) for record in joint_records)
        joint = joint_records[0].joint if joint_records else "?"
        if row_count < coefficients:
            raise FitError(
                f"joint '{joint}': {row_count} rows for {coefficients} coefficients; more data "
                "needed."
            )
        require_reversals(joint_records)
        return cls(
            dt=np.concatenate([np.diff(record.t, prepend=record.t[0]) for record in joint_records]),
            begins=np.concatenate([np.arange(len(record.t)) == 0 for record in joint_records]),
            log_index=log_of_rows(joint_records),
            dq=np.concatenate([record.dq for record in joint_records]),
            q=np.concatenate([record.q for record in joint_records]),
            tau_load=np.concatenate([record.tau_load for record in joint_records]),
            tau=np.concatenate([record.tau for record in joint_records]),
            gear_ratio=joint_records[0].gear_ratio,
            sliding=joint_records[0].sliding,
        )

    @cached_property
    def settling(self) -> Array:
        """(N,) share of the steady state in the initial state; used at first rows only."""
        return np.asarray(_settling_share(self.dq)[0])

    def recurrence(self, a: Array, c: Array, steady: Array) -> Array:
        """Solve x[k] = a[k] x[k-1] + c[k] (N,) along records that start from `steady` (N,)."""
        c = np.where(self.begins, self.settling * steady, c)
        return recurrence(np.where(self.begins, 0.0, a), c, float(c[0]))


_settling_share = to_numpy_function((DQ,), (SETTLING,))


def log_of_rows(joint_records: Sequence[FrictionRecord]) -> Integers:
    """Return the (N,) index of each row's log."""
    log_names = list(dict.fromkeys(record.log for record in joint_records))
    log_of_record = [log_names.index(record.log) for record in joint_records]
    row_counts = [len(record.t) for record in joint_records]
    return np.repeat(log_of_record, row_counts)


def to_slice(is_selected: Mask) -> Mask | slice:
    """Return a mask (N,) as a slice if its rows are consecutive; slices do not copy."""
    indices = np.flatnonzero(is_selected)
    if not len(indices) or indices[-1] - indices[0] + 1 != len(indices):
        return is_selected
    return slice(int(indices[0]), int(indices[-1]) + 1)


def least_squares(columns: Array, target: Array) -> Array:
    """Return the (K,) coefficients of least norm for (N, K) columns and a target."""
    return np.asarray(np.linalg.lstsq(columns, target)[0], dtype=np.float64)


def non_negative_least_squares(
    columns: Array, target: Array, *, non_negative: int
) -> tuple[Array, float]:
    """Return (K,) coefficients, the leading ones non-negative, and the sum of squared residuals.

    Negative ones are set to zero one by one, the worst first: exact for nearly orthogonal columns.
    """
    gram = columns.T @ columns
    moment = columns.T @ target
    scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    active = np.arange(columns.shape[1])
    while True:
        active_gram = gram[np.ix_(active, active)] / np.outer(scale[active], scale[active])
        solution = np.zeros(columns.shape[1])
        solution[active] = (
            np.linalg.lstsq(active_gram, moment[active] / scale[active])[0] / scale[active]
        )
        signed_solution = solution[:non_negative] * scale[:non_negative]
        if signed_solution.min(initial=0.0) >= 0.0:
            return solution, float(target @ target - moment @ solution)
        active = active[active != int(np.argmin(signed_solution))]


ROUND_OFF = 1e-9  # of a cost


def is_no_worse(cost: float, other_cost: float, tolerance: float = ROUND_OFF) -> bool:
    """Return whether a cost exceeds another one by no more than a relative tolerance."""
    # Without noise a cost is round-off, which may be negative.
    return cost <= other_cost + tolerance * abs(other_cost)


def find_first_best(costs: Sequence[float] | Array, tolerance: float = ROUND_OFF) -> int:
    """Return the index of the first cost that no other one undercuts beyond a tolerance."""
    lowest_cost = min(costs)
    return next(k for k, cost in enumerate(costs) if is_no_worse(cost, lowest_cost, tolerance))


_RELATIVE_RIDGE = 1e-9  # relative to each column's square; columns may be dependent


class NormalEquations:
    """Normal equations of weighted blocks (N, k); all but the last `free` are non-negative."""

    @classmethod
    def from_columns(
        cls, columns: Array, tau: Array, folds: Sequence[Mask], weights: Array, *, free: int
    ) -> Self:
        """Return the equations of columns (N, K)."""
        return cls([weights[:, None] * columns], FoldProducts(tau, folds, weights), free=free)

    def __init__(self, blocks: Sequence[Array], products: "FoldProducts", *, free: int) -> None:
        self._blocks = blocks
        self._products = products
        self._free = free
        column_ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
        self._places = [slice(a, b) for a, b in pairwise(column_ends)]
        fold_count = len(products.folds)
        column_count = column_ends[-1]
        self._grams = np.empty((fold_count, column_count, column_count))
        self._moments = np.empty((fold_count, column_count))
        for i, a in enumerate(self._places):
            self._moments[:, a] = products.multiply_blocks(blocks[i], products.tau)[:, :, 0]
            for j, b in enumerate(self._places[: i + 1]):
                product = products.multiply_blocks(blocks[i], blocks[j])
                self._grams[:, a, b] = product
                self._grams[:, b, a] = product.swapaxes(1, 2)
        self.gram = self._grams.sum(axis=0)
        self.moment = self._moments.sum(axis=0)

    def solve(self) -> Array:
        """Return the (K,) coefficients for all rows."""
        return signed_least_squares(self.gram, self.moment, self._free)

    def cross_validate(self) -> Array:
        """Return the (N,) errors of cross-validation."""
        errors = -self._products.tau[:, 0]
        for k, fold in enumerate(self._products.folds):
            # A sum, as a difference from the total is round-off where nearly all of a column is in
            # the fold, and its matrix need not be positive definite.
            gram = np.delete(self._grams, k, axis=0).sum(axis=0)
            moment = np.delete(self._moments, k, axis=0).sum(axis=0)
            coefficients = signed_least_squares(gram, moment, self._free)
            for block, place in zip(self._blocks, self._places, strict=True):
                errors[fold] += block[fold] @ coefficients[place]
        return errors


class FoldProducts:
    """Products of columns over each fold, computed once per pair; `weights` (N,) are 1 or 0."""

    def __init__(self, tau: Array, folds: Sequence[Mask], weights: Array) -> None:
        self.tau: Array = (weights * tau)[:, None]
        self.folds = [to_slice(fold) for fold in folds]
        # Keys are identities of arrays, which are kept so that they stay unique.
        self._cache: dict[tuple[int, int], tuple[Array, Array, Array]] = {}

    def multiply_blocks(self, a: Array, b: Array) -> Array:
        """Return (folds, k, l) products of two blocks (N, k) and (N, l)."""
        key = id(a), id(b)
        if key not in self._cache:
            products = np.array([a[fold].T @ b[fold] for fold in self.folds])
            self._cache[key] = (a, b, products)
        return self._cache[key][2]


def signed_least_squares(gram: Array, moment: Array, free: int) -> Array:
    """Minimise x G x / 2 - m x over x (K,) with x >= 0, apart from the last `free` ones."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    g = gram * scale * scale[:, None] + _RELATIVE_RIDGE * np.eye(len(scale))
    m = moment * scale
    signed_count = len(m) - free
    solution = np.linalg.solve(
        g[signed_count:, signed_count:], np.c_[m[signed_count:], g[signed_count:, :signed_count]]
    )
    free_part = solution[:, 0]
    coupling_part = solution[:, 1:]
    root = np.linalg.cholesky(
        g[:signed_count, :signed_count] - g[:signed_count, signed_count:] @ coupling_part
    )
    target = np.linalg.solve(root, m[:signed_count] - g[:signed_count, signed_count:] @ free_part)
    x = np.zeros(0)
    if signed_count:  # with no unknowns SciPy's nnls aborts the process
        x, _ = scipy.optimize.nnls(root.T, target, maxiter=100 * len(scale))
    return np.asarray(np.concatenate([x, free_part - coupling_part @ x]) * scale)


def divide_into_blocks(
    dt: Array, begins: Mask, max_seconds: float = 8.0, min_blocks: int = 8
) -> Any:
    """Return the index (N,) of each row's block: at most `max_seconds`, or `min_blocks` blocks."""
    length = min(max_seconds, float(dt.sum()) / min_blocks)
    clock = np.cumsum(np.where(begins, 0.0, dt))
    elapsed = clock - np.maximum.accumulate(np.where(begins, clock, 0.0))
    block_number = np.floor(elapsed / max(length, 1e-300)).astype(int)
    return np.cumsum(begins | (np.diff(block_number, prepend=-1) > 0)) - 1


def has_significant_gain(before: Array, after: Array, blocks: Any) -> bool:
    """Return True if errors (N,) fall by more than one standard error of the gain over blocks."""
    gains = np.bincount(blocks, weights=before**2 - after**2)
    if len(gains) < 2:
        return False
    min_gain = np.sqrt(len(gains)) * gains.std(ddof=1) + ROUND_OFF * float(before @ before)
    return bool(gains.sum() > min_gain)
