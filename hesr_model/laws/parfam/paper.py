"""Stage 2 of the paper: basin hopping with L-BFGS-B on eq. 12, truncation, BFGS.

Features and torque are standardised, so that one L1 weight fits every coefficient and joint.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import basinhopping, minimize

from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import UNIT_FUNCTIONS, Candidate
from hesr_model.support.arrays import Array

GAMMA = 1e-3  # weight of L1; 1e-4 prunes nothing, 1e-2 all units
HOPS = 10  # per function g
STEP = 1.0  # largest displacement, in standardised coefficients
TRUNCATION = 0.02  # smaller ones are truncated: 2 % of the torque's spread


class Objective:
    """Eq. 12 for one unit g with its analytic gradient.

    `x` (N, 4) and `y` (N,) are standardised; `active` (9,) masks the c (4), gain, theta (4) that
    may differ from zero.
    """

    def __init__(self, g: str, x: Array, y: Array, gamma: float, active: Array) -> None:
        self.g, self.dg = UNIT_FUNCTIONS[g]
        self.x = np.asfortranarray(x)
        self.y = y
        self.gamma = gamma
        self.active = active

    def __call__(self, point: Array) -> tuple[float, Array]:
        """Return the objective and its gradient at c (4), gain, theta (4)."""
        point = np.where(self.active, point, 0.0)
        c, gain, theta = point[:4], point[4], point[5:]
        argument = self.x @ theta
        unit = self.g(argument)
        residual = self.x @ c
        residual += gain * unit
        residual -= self.y
        slope = self.dg(argument, unit) * residual
        gradient = np.empty(9)
        gradient[:4] = residual @ self.x
        gradient[4] = residual @ unit
        gradient[5:] = (gain * slope) @ self.x
        gradient *= 2.0 / len(self.y)
        gradient += self.gamma * np.sign(point)
        value = float(residual @ residual) / len(self.y) + self.gamma * float(np.abs(point).sum())
        return value, np.where(self.active, gradient, 0.0)


def search(cell: Cell, g: str, features: Array, tau: Array, rng: np.random.Generator) -> Candidate:
    """Return the law with one unit g by the search of the paper at one (alpha, beta)."""
    scale = np.concatenate([[1.0], np.maximum(features[:, 1:].std(axis=0), 1e-12)])
    level = max(float(tau.std()), 1e-12)
    x, y = features / scale, tau / level
    hopped = basinhopping(
        Objective(g, x, y, GAMMA, np.ones(9, bool)),
        rng.normal(size=9),
        niter=HOPS,
        stepsize=STEP,
        rng=rng,
        minimizer_kwargs={"method": "L-BFGS-B", "jac": True, "bounds": [(-50.0, 50.0)] * 9},
    )
    active = np.abs(hopped.x) >= TRUNCATION
    active[5:] &= active[4]
    active[4] &= active[5:].any()
    refined = minimize(
        Objective(g, x, y, 0.0, active), np.where(active, hopped.x, 0.0), jac=True, method="BFGS"
    ).x
    refined = np.where(active, refined, 0.0)
    has_unit = bool(active[4])
    candidate = Candidate(
        g=g if has_unit else None,
        alpha=cell.alpha,
        beta=cell.beta,
        c=refined[:4] * level / scale,
        gain=float(refined[4] * level),
        theta=refined[5:] / scale,
        c_active=active[:4],
        theta_active=active[5:] & has_unit,
        cost=0.0,
    )
    return replace(candidate, cost=float(np.mean((candidate.torque(features) - tau) ** 2)))
