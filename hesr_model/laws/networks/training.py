"""Training of a network with one hidden tanh layer by Levenberg-Marquardt with weight decay."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.support.arrays import Array

ITERATIONS = 15  # per weight decay
CONVERGED = 1e-5  # relative gain of an iteration
_DAMPING = (1e-9, 1e-2)  # minimum and initial value


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """y = bias + gains . tanh(theta' (1, z)) on standardised data."""

    bias: float
    gains: Array  # (H,)
    theta: Array  # (4, H), the constant first
    cost: float  # mean squared residual on the training rows plus decay

    def output(self, z: Array) -> Array:
        """Return the (N,) output for inputs z, (N, 3), all standardised."""
        return np.asarray(np.tanh(z @ self.theta[1:] + self.theta[0]) @ self.gains + self.bias)


def path(z: Array, y: Array, theta: Array, decays: Sequence[float]) -> list[Network]:
    """Return the network of each decreasing weight decay, started from the previous one.

    `z` (N, 3) and `y` (N,) are standardised, `theta` (4, H) are initial hidden weights.
    """
    problem = _Problem(z, y, theta.shape[1])
    point = problem.start(theta, decays[0])
    networks = []
    for decay in decays:
        point, cost = problem.train(point, decay)
        bias, gains, trained = problem.split(point)
        networks.append(Network(bias=bias, gains=gains, theta=trained, cost=cost))
    return networks


class _Problem:
    """The least-squares problem of one size over (bias, gains, theta)."""

    def __init__(self, z: Array, y: Array, hidden: int) -> None:
        self.x = np.asfortranarray(np.column_stack([np.ones(len(z)), z]))
        self.y = y
        self.hidden = hidden

    def split(self, point: Array) -> tuple[float, Array, Array]:
        """Return offset, (H,) gains and (4, H) theta of a point."""
        ends = 1 + self.hidden
        return float(point[0]), point[1:ends], point[ends:].reshape(4, self.hidden)

    def start(self, theta: Array, decay: float) -> Array:
        """Return the point with the best output layer for given hidden weights."""
        columns = np.column_stack([np.ones(len(self.y)), np.tanh(self.x @ theta)])
        gram = columns.T @ columns / len(self.y) + np.diag(self._shrinkage(decay, columns.shape[1]))
        outer = np.linalg.solve(gram, columns.T @ self.y / len(self.y))
        return np.concatenate([outer, theta.ravel()])

    def train(self, point: Array, decay: float) -> tuple[Array, float]:
        """Return the point after Levenberg-Marquardt iterations, and its cost."""
        shrinkage = self._shrinkage(decay, len(point))
        least, damping = _DAMPING
        cost = self._cost(point, shrinkage)
        gram, gradient = self._normal_equations(point, shrinkage)
        for _ in range(ITERATIONS):
            trial = point - np.linalg.solve(gram + np.diag(damping * np.diag(gram)), gradient)
            trial_cost = self._cost(trial, shrinkage)
            if trial_cost < cost:
                converged = cost - trial_cost < CONVERGED * cost
                point, cost = trial, trial_cost
                if converged:
                    break
                damping = max(damping / 5.0, least)
                gram, gradient = self._normal_equations(point, shrinkage)
            else:
                damping *= 4.0
        return point, cost

    def _shrinkage(self, decay: float, count: int) -> Array:
        return np.concatenate([[0.0], np.full(count - 1, decay)])

    def _cost(self, point: Array, shrinkage: Array) -> float:
        bias, gains, theta = self.split(point)
        residual = np.tanh(self.x @ theta) @ gains + (bias - self.y)
        return float(residual @ residual / len(residual) + shrinkage @ point**2)

    def _normal_equations(self, point: Array, shrinkage: Array) -> tuple[Array, Array]:
        bias, gains, theta = self.split(point)
        rows, hidden = len(self.y), self.hidden
        jacobian = np.empty((rows, len(point)), order="F")
        jacobian[:, 0] = 1.0
        value = np.tanh(self.x @ theta, out=jacobian[:, 1 : 1 + hidden])
        residual = value @ gains + (bias - self.y)
        slope = (1.0 - value**2) * gains
        for i in range(4):
            first = 1 + (i + 1) * hidden
            np.multiply(slope, self.x[:, i, None], out=jacobian[:, first : first + hidden])
        gram = jacobian.T @ jacobian / rows + np.diag(shrinkage)
        return gram, jacobian.T @ residual / rows + shrinkage * point
