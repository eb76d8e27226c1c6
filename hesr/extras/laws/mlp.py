"""MLP-H: a network with one hidden tanh layer, trained with weight decay."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hesr_model.equations.memory import Discretisation
from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.parfam import evolve, family
from hesr_model.laws.rbfnn import Costs, NetworkEstimator, NetworkInputs
from hesr_model.support.arrays import Array, Mask

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


def train_path(z: Array, y: Array, theta: Array, decays: Sequence[float]) -> list[Network]:
    """Return the network of each decreasing weight decay, started from the previous one.

    `z` (N, 3) and `y` (N,) are standardised, `theta` (4, H) are initial hidden weights.
    """
    problem = _Problem(z, y, theta.shape[1])
    point = problem.start(theta, decays[0])
    networks = []
    for decay in decays:
        point, cost = problem.train(point, decay)
        bias, gains, trained_theta = problem.split(point)
        networks.append(Network(bias=bias, gains=gains, theta=trained_theta, cost=cost))
    return networks


class _Problem:
    """The least-squares problem of one size over (bias, gains, theta)."""

    def __init__(self, z: Array, y: Array, hidden: int) -> None:
        self.x = np.asfortranarray(np.column_stack([np.ones(len(z)), z]))
        self.y = y
        self.hidden = hidden

    def split(self, point: Array) -> tuple[float, Array, Array]:
        """Return offset, (H,) gains and (4, H) theta of a point."""
        theta_start = 1 + self.hidden
        return float(point[0]), point[1:theta_start], point[theta_start:].reshape(4, self.hidden)

    def start(self, theta: Array, decay: float) -> Array:
        """Return the point with the best output layer for given hidden weights."""
        columns = np.column_stack([np.ones(len(self.y)), np.tanh(self.x @ theta)])
        gram = columns.T @ columns / len(self.y) + np.diag(self._shrinkage(decay, columns.shape[1]))
        outer = np.linalg.solve(gram, columns.T @ self.y / len(self.y))
        return np.concatenate([outer, theta.ravel()])

    def train(self, point: Array, decay: float) -> tuple[Array, float]:
        """Return the point after Levenberg-Marquardt iterations, and its cost."""
        shrinkage = self._shrinkage(decay, len(point))
        smallest_damping, damping = _DAMPING
        cost = self._cost(point, shrinkage)
        gram, gradient = self._normal_equations(point, shrinkage)
        for _ in range(ITERATIONS):
            trial = point - np.linalg.solve(gram + np.diag(damping * np.diag(gram)), gradient)
            trial_cost = self._cost(trial, shrinkage)
            if trial_cost < cost:
                has_converged = cost - trial_cost < CONVERGED * cost
                point = trial
                cost = trial_cost
                if has_converged:
                    break
                damping = max(damping / 5.0, smallest_damping)
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
        activation = np.tanh(self.x @ theta)
        slope = (1.0 - activation**2) * gains
        theta_columns = [slope * column[:, None] for column in self.x.T]
        jacobian = np.asfortranarray(
            np.column_stack([np.ones(len(activation)), activation, *theta_columns])
        )
        residual = jacobian[:, 1 : 1 + self.hidden] @ gains + (bias - self.y)
        gram = jacobian.T @ jacobian / len(activation) + np.diag(shrinkage)
        return gram, jacobian.T @ residual / len(activation) + shrinkage * point


MAX_HIDDEN = 16  # largest hidden layer
DECAYS = (3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
"""Weight decays on standardised data; each network starts from that of the previous decay."""
SEARCHED_ROWS = 1600
"""Rows for the comparison of choices; the chosen network is trained on all rows."""
_MIN_SCALE = 1e-12


@register
class MlpH(NetworkEstimator):
    """tau = c_0 + sum_k c_k tanh(theta_k . (1, dq, h, h')).

    Levenberg-Marquardt with weight decay trains networks. (alpha, beta), size and decay predict
    left-out logs best on average over the random starts; the best-fitting start is used.
    """

    name = "mlp_h"
    title = "MLP-H"
    order = 110
    key = "hidden"
    sizes = (1, MAX_HIDDEN)
    typical: ClassVar[Mapping[str, Any]] = {"hidden": 1}

    def __init__(
        self,
        *,
        hidden: Sequence[int] = (2, 4, 8, 16),
        cells: int = 3,
        starts: int = 2,
        discretisation: Discretisation = "exact",
    ) -> None:
        super().__init__(hidden, cells, discretisation)
        self.starts = starts

    @classmethod
    def form(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of {"hidden": size}: those of ParFam with as many units."""
        unit = {"g": "tanh", "arguments": list(family.FEATURES)}
        return family.form({"linear": ["1"], "units": [unit] * cls.size(structure)})

    def _search(
        self, rows: JointRows, rng: np.random.Generator
    ) -> tuple[Costs, Callable[..., FrictionLaw]]:
        mean_torque = float(rows.tau.mean())
        scale = max(float(rows.tau.std()), _MIN_SCALE)
        y = (rows.tau - mean_torque) / scale
        folds = rows.folds
        initial_layers: dict[int, list[Array]] = {}
        for hidden in self.tried_sizes:
            initial_layers[hidden] = [
                evolve.starting_points(rng, hidden, 4).T for _ in range(self.starts)
            ]

        def build_law(inputs: NetworkInputs, hidden: int, decay: int) -> FrictionLaw:
            decays = DECAYS[: decay + 1]
            networks = [
                train_path(inputs.z, y, theta, decays)[-1] for theta in initial_layers[hidden]
            ]
            best_network = min(networks, key=lambda network: network.cost)
            return self._build_network_law(inputs, best_network, mean_torque, scale)

        def compute_costs(inputs: NetworkInputs, hidden: int) -> Array:
            return cross_validate(inputs.z, y, folds, initial_layers[hidden])

        return compute_costs, build_law

    def _build_network_law(
        self, inputs: NetworkInputs, network: Network, mean_torque: float, scale: float
    ) -> FrictionLaw:
        gains = network.gains
        theta = network.theta
        # tanh is odd: positive gains, largest first, make the printed network unique.
        theta = np.where(gains < 0.0, -theta, theta)
        gains = np.abs(gains)
        order = np.argsort(-gains, kind="stable")
        slopes = theta[1:] / inputs.spread[:, None]
        arguments = np.vstack([theta[0] - inputs.mean @ slopes, slopes])
        values = {
            family.linear_name("1"): mean_torque + scale * network.bias,
            "alpha": inputs.cell.alpha,
            "beta": inputs.cell.beta,
        }
        for k, unit in enumerate(order, start=1):
            values[family.gain_name(k)] = float(scale * gains[unit])
            for x, value in zip(family.FEATURES, arguments[:, unit], strict=True):
                values[family.argument_name(k, x)] = float(value)
        return self._build_law(len(gains), values)


def cross_validate(
    z: Array, y: Array, folds: Sequence[Mask], initial_layers: Sequence[Array]
) -> Array:
    """Return (decays,) mean squares on left-out rows, relative to the variance of the torque.

    Standardised `z` (N, 3), `y` (N,); masks (N,) of left-out rows; hidden layers (4, H).
    """
    stride = max(1, len(y) // SEARCHED_ROWS)
    total = np.zeros(len(DECAYS))
    for fold in folds:
        training_rows = np.flatnonzero(~fold)[::stride]
        for theta in initial_layers:
            networks = train_path(z[training_rows], y[training_rows], theta, DECAYS)
            for decay_index, network in enumerate(networks):
                total[decay_index] += np.sum((network.output(z[fold]) - y[fold]) ** 2)
    return total / (len(y) * len(initial_layers))
