"""Numeric condition of the certificate: lagging ripple against viscous friction v f(v).

It is f(v) >= sum_k A_k min(n_k c, 2 / |v|), where c is the mean time between the angle of the
ripple and that at the end of a step (derivation: `docs/methods.md`, *Ripple*).
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from hesr_model.support.arrays import Array

SPEEDS = np.concatenate([[0.0], np.geomspace(1e-4, 1e6, 241)])
"""[rad/s] for the condition in a fit; in between all terms are monotonic"""


def distance(lag: float, window: float) -> float:
    """Return c [s]: the largest mean of |lag - u| over u in (0, h), for any h up to the window."""
    if window <= 0.0:
        return abs(lag)
    if lag <= 0.0 or lag >= window:
        at_end = abs(lag - window / 2.0)
    else:
        at_end = (lag**2 + (window - lag) ** 2) / (2.0 * window)
    return max(abs(lag), at_end)


def needed(frequencies: Sequence[int], lag: float, window: float) -> Array:
    """Return (S, K): smallest f at each of `SPEEDS` per N.m of each wave [s/rad]."""
    speeds = np.maximum(SPEEDS, 1e-300)[:, None]
    return np.asarray(np.minimum(np.asarray(frequencies) * distance(lag, window), 2.0 / speeds))


def constrained(
    gram: Array, moment: Array, x: Array, viscous: Array, waves: Array, *, free: int
) -> Array:
    """Return the least-squares coefficients that satisfy the condition, a cone problem.

    The last `free` of the unconstrained solution `x` have any sign and end in cosines and sines;
    those of `viscous` (S, V) precede them. `waves` (S, W) is the result of `needed`.
    """
    # Bounds between neighbouring speeds: all columns are monotonic, and waves fall.
    viscous, waves = np.minimum(viscous[:-1], viscous[1:]), waves[:-1]
    first = len(x) - free
    f, a = slice(first - viscous.shape[1], first), slice(len(x) - 2 * waves.shape[1], len(x))

    def sides(y: Array) -> tuple[Array, Array]:
        return viscous @ y[f], waves @ np.hypot(*y[a].reshape(-1, 2).T)

    def margin(y: Array) -> Array:
        found, required = sides(y)
        return found - required

    def share(y: Array) -> float:
        found, required = sides(y)
        return max(float(np.min(found / np.maximum(required, 1e-300))), 0.0)

    if margin(x).min() >= 0.0:
        return x
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    # Start at half the allowed ripple: the root is differentiable there.
    start = x.copy()
    start[a] *= 0.5 * share(x)

    def slope(y: Array) -> Array:
        found = np.zeros((len(viscous), len(y)))
        found[:, f] = viscous
        pairs = y[a].reshape(-1, 2)
        unit = pairs / np.maximum(np.hypot(*pairs.T), 1e-12)[:, None]
        found[:, a] = -(waves[:, :, None] * unit).reshape(len(viscous), -1)
        return found

    size = max(float(x @ gram @ x), np.finfo(float).tiny)
    best = minimize(
        lambda z: float(scale * z @ gram @ (scale * z) / 2.0 - moment @ (scale * z)) / size,
        start / scale,
        jac=lambda z: scale * (gram @ (scale * z) - moment) / size,
        bounds=[(0.0, None)] * first + [(None, None)] * free,
        constraints={
            "type": "ineq",
            "fun": lambda z: margin(scale * z),
            "jac": lambda z: slope(scale * z) * scale,
        },
        method="SLSQP",
        options={"maxiter": 200, "ftol": 1e-10},
    )
    y = np.asarray(scale * best.x)
    y[:first] = np.maximum(y[:first], 0.0)
    y[a] *= min(1.0, share(y)) * (1.0 - 1e-9)
    return y
