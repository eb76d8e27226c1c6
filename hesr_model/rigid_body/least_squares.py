"""Weighted linear least squares over blocks of rows with different noise."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from hesr_model.inference import covariance
from hesr_model.inference.covariance import (
    Covariance,
    Gradients,
    covariance_of_parts,
    leave_out_rows,
)
from hesr_model.support.arrays import Array, Integers, Mask

_REWEIGHTINGS = 2
_HUGE_CONDITION = 1e3  # identification motions have some hundreds
_LOOSE_RIDGE = 1e-4  # likewise, of loose columns alone
_RIDGE = 3e-3  # over the largest singular value; best on poor logs


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Rows of equal noise, with sample numbers (N,) that blocks share."""

    matrix: Array
    target: Array
    samples: Integers = field(default_factory=lambda: np.zeros(0, dtype=int))


@dataclass(frozen=True, kw_only=True, eq=False)
class Factor:
    """Triangular factor (P + 1, P + 1) of [matrix, target]."""

    triangle: Array
    rows: int = 0

    def add_rows(self, block: Block) -> "Factor":
        """Return the factor with further rows."""
        block_rows = np.column_stack([block.matrix, block.target])
        stacked_rows = np.concatenate([self.triangle, block_rows])
        rows = self.rows + len(block_rows)
        (factor,) = scipy.linalg.qr(stacked_rows, mode="r", check_finite=False)
        return Factor(triangle=np.asarray(factor[: block_rows.shape[1]]), rows=rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Unknowns of a least-squares problem, and its conditioning."""

    x: Array
    condition: float  # of the weighted matrix, with columns divided by their scales
    ridge: float  # pull of the scaled unknowns towards zero over the largest singular value
    pull: Array  # (P,), cost of the ridge per unit of each unknown
    weights: Array  # of each block
    rmse: Array  # of each block


def solve(
    blocks: Sequence[Block], *, scale: Array, weighted: bool, is_loose: Mask | None = None
) -> Solution:
    """Solve least squares over all blocks, each divided by its residual's size if `weighted`.

    A ridge is added only if the condition number exceeds 1e3. The usual size `scale` (P,) of each
    column must not come from the data, which may hardly excite it. If the ridge were due to columns
    that are `is_loose` (P,), such as harmonics over a small angle, only these have a weaker one.
    """
    empty = Factor(triangle=np.zeros((0, len(scale) + 1)))
    factors = [empty.add_rows(block) for block in blocks]
    return solve_factors(factors, scale=scale, weighted=weighted, is_loose=is_loose)


def solve_factors(
    factors: Sequence[Factor], *, scale: Array, weighted: bool, is_loose: Mask | None = None
) -> Solution:
    """Solve as `solve` does, from factors."""
    weights = np.ones(len(factors))
    if is_loose is None:
        is_loose = np.zeros(len(scale), dtype=bool)
    solution = _solve(factors, weights, scale, is_loose)
    if not weighted:
        return solution
    for _ in range(_REWEIGHTINGS):
        # An exact fit must not get an infinite weight.
        floor = 1e-6 * float(np.max(solution.rmse)) or 1.0
        weights = 1.0 / np.maximum(solution.rmse, floor)
        solution = _solve(factors, weights, scale, is_loose)
    return solution


def estimate_covariance(
    blocks: Sequence[Block], solution: Solution, labels: Integers
) -> Covariance:
    """Return the covariance from residuals summed by sample; `labels` are log numbers."""
    labels = covariance.blocks_of_time(labels)
    prior_hessian = np.diag(solution.pull**2)
    hessian = prior_hessian
    for block, weight in zip(blocks, solution.weights, strict=True):
        hessian = hessian + weight**2 * block.matrix.T @ block.matrix
    parts = compute_gradients(blocks, solution, labels, hessian)
    names = ("",) * len(hessian)
    return covariance_of_parts(names, lambda: parts, hessian, prior_hessian=prior_hessian)


def compute_gradients(
    blocks: Sequence[Block], solution: Solution, labels: Integers, hessian: Array
) -> list[Gradients]:
    """Return gradients and Hessians of each log or block of time, given the `hessian` of all."""
    gradients = np.zeros((len(labels), len(solution.x)))
    distinct_labels = np.unique(labels)
    hessians = np.zeros((len(distinct_labels), *hessian.shape))
    for block, weight in zip(blocks, solution.weights, strict=True):
        rows = weight * block.matrix
        residual = weight * (block.target - block.matrix @ solution.x)
        gradients[block.samples] += rows * leave_out_rows(rows, residual, hessian)[:, None]
        row_labels = labels[block.samples]
        for k, label in enumerate(distinct_labels):
            label_rows = rows[row_labels == label]
            hessians[k] += label_rows.T @ label_rows
    pairs = zip(distinct_labels.tolist(), hessians, strict=True)
    return [(label, gradients[labels == label], label_hessian) for label, label_hessian in pairs]


def _solve(factors: Sequence[Factor], weights: Array, scale: Array, is_loose: Mask) -> Solution:
    triangles = [factor.triangle for factor in factors]
    weighted_triangles = zip(weights, triangles, strict=True)
    rows = np.concatenate([weight * triangle for weight, triangle in weighted_triangles])
    matrix = rows[:, :-1] / scale
    target = rows[:, -1]
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    loose_pull = np.zeros(len(scale))
    judged_values = s
    if is_loose.any() and s[0] > _HUGE_CONDITION * s[-1]:
        loose_pull[is_loose] = _LOOSE_RIDGE * s[0]
        # Whether all columns need a ridge is judged with loose ones pulled as much.
        full_pull = np.diag(loose_pull / _LOOSE_RIDGE * _RIDGE)
        judged_values = np.linalg.svd(np.vstack([matrix, full_pull]))[1]
        u, s, vt = np.linalg.svd(np.vstack([matrix, np.diag(loose_pull)]), full_matrices=False)
        target = np.concatenate([target, np.zeros(len(loose_pull))])
    smallest_value = max(judged_values[-1], np.finfo(float).eps * judged_values[0])
    condition = float(judged_values[0] / smallest_value)
    ridge = _RIDGE if condition > _HUGE_CONDITION else 0.0
    pull = ridge * s[0]
    x = vt.T @ (s / (s**2 + pull**2) * (u.T @ target)) / scale
    squares = [np.sum((triangle[:, -1] - triangle[:, :-1] @ x) ** 2) for triangle in triangles]
    return Solution(
        x=x,
        condition=condition,
        ridge=ridge,
        pull=np.hypot(pull, loose_pull) * scale,
        weights=np.asarray(weights),
        rmse=np.sqrt(squares / np.array([factor.rows for factor in factors])),
    )
