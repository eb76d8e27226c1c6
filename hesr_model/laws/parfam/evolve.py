"""Stage 2: variable projection from a batch of starts, or basin hopping as in the paper.

For fixed (alpha, beta) and g the torque is linear in c and the gain, so only theta is searched
(Golub and Pereyra 1973, with Kaufman's simplification of the Jacobian), by Levenberg-Marquardt.
The paper's search uses standardised data, so that one L1 weight fits every coefficient and joint.
"""

from dataclasses import replace

import numpy as np
import scipy

from hesr_model.fitting.joint_rows import least_squares
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import UNIT_FUNCTIONS, Candidate
from hesr_model.support.arrays import Array

ROWS = 600  # the last stage uses all
ROUNDS = ((6, 0.5), (6, 0.4), (12, 1.0))  # (iterations, share of starts kept)
ARGUMENT_LIMIT = 12.0  # of a standardised theta; beyond it g saturates or wraps


def fit_linear(cell: Cell, features: Array, tau: Array) -> Candidate:
    """Return the law without a unit g, linear in the (N, 4) features, for tau (N,) [N.m]."""
    return _candidate(cell, None, features, tau, np.zeros(4))


def search(
    cell: Cell, g: str, features: Array, tau: Array, starts: Array, keep: int
) -> list[Candidate]:
    """Return at most `keep` distinct laws with one unit g, best first, from `starts` (S, 4)."""
    thetas = search_arguments(g, features, features, tau, starts, keep)
    return [_candidate(cell, g, features, tau, theta) for theta in thetas]


def search_arguments(
    g: str,
    features: Array,
    linear: Array,
    tau: Array,
    starts: Array,
    keep: int,
    limit: float = ARGUMENT_LIMIT,
) -> list[Array]:
    """Return at most `keep` distinct arguments theta (F,) of a unit g added to a linear law.

    `features` (M, F) are those of the argument, the first one constant, `linear` (M, L) the columns
    of the linear law. `starts` (S, F) and `limit` are for standardised features.
    """
    scale = _feature_scale(features)
    problem = _ProjectedProblem(g, features / scale, linear, tau, limit)
    theta, cost = problem.minimise(starts.T.copy())
    chosen: list[int] = []
    for i in np.argsort(cost):
        if len(chosen) == keep or not np.isfinite(cost[i]):
            break
        if all(abs(cost[i] - cost[j]) > 1e-4 * cost[j] for j in chosen):
            chosen.append(int(i))
    return [theta[:, i] / scale for i in chosen]


def search_aliases(candidate: Candidate, features: Array, tau: Array) -> list[Candidate]:
    """Return the best law from the aliases of a periodic g; none for another g.

    While a joint slides, h is the sign of v. Then sin and cos of theta . x stay the same, but for
    the sign of the gain, if theta_h changes by half a turn, and if x is mirrored: (-theta_0,
    -theta_v, half a turn - theta_h). Only the rows after reversals tell these laws apart, where the
    law of a cell is the least accurate, so that stage 3 gets both.
    """
    if candidate.g not in ("sin", "cos"):
        return []
    scale = _feature_scale(features)
    offset, by_speed, by_state, by_rate = candidate.theta
    aliases = []
    for half_turn in (-np.pi, np.pi):
        mirrored = [-offset, -by_speed, half_turn - by_state]
        aliases += [
            [offset, by_speed, by_state + half_turn, by_rate],
            [*mirrored, by_rate],
            [*mirrored, -by_rate],
        ]
    cell = Cell(alpha=candidate.alpha, beta=candidate.beta, cost=np.nan)
    return search(cell, candidate.g, features, tau, np.array(aliases) * scale, keep=1)


def _feature_scale(features: Array) -> Array:
    """Return the standard deviation (F,) of each feature, 1 of the constant one."""
    return np.concatenate([[1.0], np.maximum(features[:, 1:].std(axis=0), 1e-12)])


def starting_points(rng: np.random.Generator, count: int, features: int) -> Array:
    """Return random starts of theta, shape (count, features), for standardised features."""
    starts = rng.normal(size=(count, features))
    return np.asarray(starts * rng.uniform(0.3, 2.0, size=(count, 1)))


def _candidate(cell: Cell, g: str | None, features: Array, tau: Array, theta: Array) -> Candidate:
    parts = [features]
    if g:
        parts.append(UNIT_FUNCTIONS[g][0](features @ theta))
    columns = np.column_stack(parts)
    solution = least_squares(columns, tau)
    cost = float(np.mean((tau - columns @ solution) ** 2))
    gain = 0.0
    if g:
        gain = float(solution[4])
    arguments = np.full(4, bool(g))
    if g == "exp":  # the gain has its offset
        gain *= float(np.exp(theta[0]))
        theta = theta * [0.0, 1.0, 1.0, 1.0]
        arguments[0] = False
    return Candidate(
        g=g,
        alpha=cell.alpha,
        beta=cell.beta,
        c=solution[:4],
        theta=theta,
        gain=gain,
        c_active=np.ones(4, bool),
        theta_active=arguments,
        cost=cost,
    )


class _ProjectedProblem:
    """The problem of one g with linear terms projected out."""

    def __init__(self, g: str, x: Array, linear: Array, tau: Array, limit: float) -> None:
        self.g, self.dg = UNIT_FUNCTIONS[g]
        self.x = x
        self.limit = limit
        self.q = np.linalg.qr(linear)[0]
        # Of each row: products of two features, and of a feature and a linear direction.
        self._squares = np.einsum("ml,mi->lim", x, x).reshape(-1, len(x))
        self._spanned = np.einsum("ml,mi->lim", self.q, x).reshape(-1, len(x))
        self.y = self._reject(tau[:, None])

    def _reject(self, columns: Array) -> Array:
        return np.asarray(columns - self.q @ (self.q.T @ columns))

    def evaluate(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return argument, g, the part of g outside the linear span, and the gain, per start."""
        argument = self.x @ theta
        value = self.g(argument)
        outside = self._reject(value)
        norm = np.maximum(np.einsum("ms,ms->s", outside, outside), 1e-9 * len(self.x))
        gain = (self.y.T @ outside)[0] / norm
        return argument, value, outside, gain

    def cost(self, theta: Array) -> Array:
        """Return the (S,) mean squared residuals."""
        _, _, outside, gain = self.evaluate(theta)
        return np.asarray(np.mean((self.y - gain * outside) ** 2, axis=0))

    def minimise(self, theta: Array) -> tuple[Array, Array]:
        """Return theta (4, S) and (S,) costs of the batch; each start has its own damping."""
        damping = np.full(theta.shape[1], 1e-2)
        cost = self.cost(theta)
        for iterations, share in ROUNDS:
            for _ in range(iterations):
                trial = np.clip(theta + self._step(theta, damping), -self.limit, self.limit)
                trial_cost = self.cost(trial)
                is_better = trial_cost < cost
                theta = np.where(is_better, trial, theta)
                cost = np.where(is_better, trial_cost, cost)
                damping = np.clip(np.where(is_better, damping / 5.0, damping * 4.0), 1e-10, 1e8)
            best = np.argsort(cost)[: int(np.ceil(share * len(cost)))]
            theta = theta[:, best]
            cost = cost[best]
            damping = damping[best]
        return theta, cost

    def _step(self, theta: Array, damping: Array) -> Array:
        gram, gradient = self._normal_equations(theta)
        diagonal = np.einsum("sii->si", gram)
        shift = damping[:, None] * (diagonal + 1e-12 * diagonal.max(axis=1, keepdims=True))
        damped = gram + np.eye(len(theta)) * (shift + 1e-300)[:, None, :]
        return np.asarray(np.linalg.solve(damped, gradient[:, :, None])[:, :, 0].T)

    def _normal_equations(self, theta: Array) -> tuple[Array, Array]:
        """Return the projected (S, F, F) Gram matrices and (S, F) gradients of theta."""
        argument, value, outside, gain = self.evaluate(theta)
        slope = gain * self.dg(argument, value)
        norm = np.maximum(np.einsum("ms,ms->s", outside, outside), 1e-9 * len(self.x))
        count = len(theta)
        full_gram = (self._squares @ slope**2).reshape(count, count, -1)
        inside = (self._spanned @ slope).reshape(-1, count, slope.shape[1])
        along = self.x.T @ (outside * slope)
        residual = self.x.T @ ((self.y - gain * outside) * slope)
        gram = full_gram - np.einsum("lis,ljs->ijs", inside, inside) - along[:, None] * along / norm
        outside_residual = np.einsum("ms,ms->s", outside, self.y - gain * outside)
        return gram.transpose(2, 0, 1), (residual - along * outside_residual / norm).T


GAMMA = 1e-3  # weight of L1; 1e-4 prunes nothing, 1e-2 all units
HOPS = 10  # per function g
STEP = 1.0  # largest displacement, in standardised coefficients
TRUNCATION = 0.02  # smaller ones are truncated: 2 % of the torque's spread


class Objective:
    """Eq. 12 for one unit g and its gradient; `active` (9,) masks c (4), gain and theta (4)."""

    def __init__(self, g: str, x: Array, y: Array, gamma: float, active: Array) -> None:
        self.g, self.dg = UNIT_FUNCTIONS[g]
        self.x = np.asfortranarray(x)
        self.y = y
        self.gamma = gamma
        self.active = active

    def __call__(self, point: Array) -> tuple[float, Array]:
        """Return the objective and its gradient at c (4), gain, theta (4)."""
        point = np.where(self.active, point, 0.0)
        c = point[:4]
        gain = point[4]
        theta = point[5:]
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


def search_of_paper(
    cell: Cell, g: str, features: Array, tau: Array, rng: np.random.Generator
) -> Candidate:
    """Return the law with one unit g by the search of the paper at one (alpha, beta)."""
    scale = _feature_scale(features)
    level = max(float(tau.std()), 1e-12)
    x = features / scale
    y = tau / level
    hopped = scipy.optimize.basinhopping(
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
    refined = scipy.optimize.minimize(
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
