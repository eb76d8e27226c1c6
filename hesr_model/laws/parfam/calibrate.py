"""Stage 1: candidates of (alpha, beta) without a structure."""

from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import prod

import numpy as np

from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.support.arrays import Array

GRID = (10, 10)  # cells of the profile
MAX_MEMORY = 1.0  # [s] longest 1 / alpha; slower states follow the load
STEEPNESS_RANGE = (1.0, 2000.0)  # of beta times the joint's typical speed
COURSE_ROWS = 200  # rows after a reversal


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One (alpha, beta) and the residual of a cubic surface over its features."""

    alpha: float
    beta: float
    cost: float


def bounds(features: HysteresisFeatures) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the bounds of alpha [1/s] and beta [s/rad] that the data can resolve."""
    speed = float(np.sqrt(np.mean(features.rows.dq**2)))
    return (
        (1.0 / MAX_MEMORY, features.alpha_limit),
        (STEEPNESS_RANGE[0] / speed, STEEPNESS_RANGE[1] / speed),
    )


def compute_profile(features: HysteresisFeatures) -> list[Cell]:
    """Return the cells of a logarithmic grid with the residuals of cubic surfaces, best first."""
    tau = features.rows.tau
    (alpha_low, alpha_high), (beta_low, beta_high) = bounds(features)
    cells = []
    # Without the upper end of alpha, where h has no memory.
    for alpha in np.geomspace(alpha_low, alpha_high, GRID[0] + 1)[:-1]:
        for beta in np.geomspace(beta_low, beta_high, GRID[1]):
            columns = _cubic_features(features.columns(alpha, beta))
            solution = np.linalg.lstsq(columns.T @ columns, columns.T @ tau, rcond=1e-12)[0]
            cost = float(np.sum((tau - columns @ solution) ** 2))
            cells.append(Cell(alpha=float(alpha), beta=float(beta), cost=cost))
    return sorted(cells, key=lambda cell: cell.cost)


def select_distinct(cells: list[Cell], count: int) -> list[Cell]:
    """Return the best `count` cells that are local minima first, then the next best."""
    from scipy.ndimage import minimum_filter  # slow to import

    alphas = sorted({cell.alpha for cell in cells})
    betas = sorted({cell.beta for cell in cells})
    costs = np.zeros((len(alphas), len(betas)))
    for cell in cells:
        costs[alphas.index(cell.alpha), betas.index(cell.beta)] = cell.cost
    lowest = minimum_filter(costs, size=3, mode="nearest")
    minima = {(alphas[i], betas[j]) for i, j in np.argwhere(costs <= lowest)}
    ranked = sorted(cells, key=lambda cell: ((cell.alpha, cell.beta) not in minima, cell.cost))
    return ranked[:count]


def estimate_from_loop(features: HysteresisFeatures) -> tuple[float, float]:
    """Return (alpha, beta) from the geometry of the loop, as in stage 1 of the paper.

    1 / alpha is the mean settling time after a reversal: area over height. beta is the slope of the
    torque over speed at its sign change, relative to the sliding level.
    """
    rows = features.rows
    (alpha_low, alpha_high), (beta_low, beta_high) = bounds(features)
    level = 0.5 * float(np.quantile(rows.tau, 0.9) - np.quantile(rows.tau, 0.1))
    courses = _extract_courses(features)
    slopes = [slope for _, slope in courses if slope is not None]
    slope = 0.0
    if slopes:
        slope = float(np.median(slopes))
    alpha = _settling_rate(features, [course for course, _ in courses])
    beta = beta_low
    if level > 0.0:
        beta = slope / level
    alpha = np.clip(alpha, alpha_low, 0.9 * alpha_high)
    return float(alpha), float(np.clip(beta, beta_low, beta_high))


def _extract_courses(features: HysteresisFeatures) -> list[tuple[Array, float | None]]:
    """Return the torque after each reversal, positive in the direction of motion, and its slope."""
    rows = features.rows
    tau = rows.tau - float(np.median(rows.tau))
    flips = np.flatnonzero((rows.dq[:-1] * rows.dq[1:] < 0.0) & ~rows.begins[1:])
    ends = np.flatnonzero(np.append(rows.begins[1:], True)) + 1
    courses: list[tuple[Array, float | None]] = []
    for k, following in zip(flips, np.append(flips[1:], len(tau) - 1), strict=True):
        stop = min(int(following), k + 1 + COURSE_ROWS, int(ends[np.searchsorted(ends, k + 1)]))
        after = np.sign(rows.dq[k + 1]) * tau[k + 1 : stop]
        crossing = np.flatnonzero(after >= 0.0)
        slope = None
        if len(crossing):
            i = k + 1 + int(crossing[0])
            step = rows.dq[i] - rows.dq[i - 1]
            if step:
                slope = abs(float((tau[i] - tau[i - 1]) / step))
        courses.append((after, slope))
    return courses


def _settling_rate(features: HysteresisFeatures, courses: list[Array]) -> float:
    """Return height over area [1/s] of the mean course; 0 without reversals."""
    rows = features.rows
    total = np.zeros(COURSE_ROWS)
    count = np.zeros(COURSE_ROWS)
    for course in courses:
        total[: len(course)] += course
        count[: len(course)] += 1.0
    is_counted = count >= max(1.0, 0.5 * count[0])
    mean = total[is_counted] / count[is_counted]
    if len(mean) < 10:
        return 0.0
    deviation = np.abs(mean - mean[-(len(mean) // 10) :].mean())
    start = int(np.argmax(deviation[: len(mean) // 4 + 1]))
    area = float(deviation[start:].sum() * np.median(rows.dt[~rows.begins]))
    if area > 0.0:
        return float(deviation[start]) / area
    return 0.0


def _cubic_features(features: Array) -> Array:
    """Return (N, 20) monomials of degree <= 3 of the standardised features."""
    x = features[:, 1:] / np.maximum(features[:, 1:].std(axis=0), 1e-12)
    monomials: list[Array] = [np.ones(len(x))]
    for degree in (1, 2, 3):
        monomials += [prod(factors) for factors in combinations_with_replacement(x.T, degree)]
    return np.stack(monomials, axis=1)
