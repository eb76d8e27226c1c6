"""Bounded local search for least squares, whose derivatives do not depend on round-off."""

from collections.abc import Callable

import numpy as np
import scipy

from hesr_model.support.arrays import Array

# Relative to the scale of a number, not to the number: SciPy's relative steps vanish where the
# number is almost 0 (a logarithm of a ratio of almost 1), and the differences are round-off.
_RELATIVE_STEP = 1e-6
# A difference below this share of the residual's terms is round-off of sums and of the linear
# coefficients. It has a random direction, which the search would follow as far as it may.
_ROUND_OFF_SHARE = 1e-12


def search_locally(
    residual: Callable[[Array], Array],
    start: Array,
    *,
    bounds: tuple[Array, Array],
    scale: Array,
    magnitude: float,
    evaluations: int | None = None,
) -> scipy.optimize.OptimizeResult:
    """Return the result of SciPy's `least_squares` from a start (K,) within bounds.

    A number that has no effect at a point is not moved there.

    Parameters
    ----------
    scale : (K,) size of a considerable change of each number.
    magnitude : norm of the terms of which the residual is the difference.
    evaluations : largest number of steps; SciPy's default if None.
    """
    lower, upper = bounds
    last_point = np.empty(0)
    last_residual = np.empty(0)

    def evaluate(point: Array) -> Array:
        nonlocal last_point, last_residual
        last_point = point.copy()
        last_residual = residual(point)
        return last_residual

    def slopes(point: Array) -> Array:
        base_residual = last_residual
        if not np.array_equal(point, last_point):
            base_residual = residual(point)
        columns = np.zeros((len(base_residual), len(point)))
        for k, step in enumerate(_RELATIVE_STEP * scale):
            moved_point = point.copy()
            moved_point[k] += step if point[k] + step <= upper[k] else -step
            difference = residual(moved_point) - base_residual
            if float(np.linalg.norm(difference)) > _ROUND_OFF_SHARE * magnitude:
                columns[:, k] = difference / (moved_point[k] - point[k])
        return columns

    return scipy.optimize.least_squares(
        evaluate,
        np.clip(start, lower, upper),
        jac=slopes,
        bounds=(lower, upper),
        x_scale=scale,
        max_nfev=evaluations,
    )
