"""The least-squares problem of one hidden layer and its iterations, against their definitions."""

import numpy as np
import pytest

from hesr.extras.laws import mlp
from hesr.extras.laws.mlp import _Problem, train_path

DECAY = 1e-3


@pytest.fixture
def data() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    z = rng.normal(size=(60, 3))
    y = np.tanh(z @ [1.0, -0.5, 0.3] + 0.2) + 0.3 * z[:, 0] + 0.05 * rng.normal(size=60)
    return z, y, rng.normal(size=(4, 2))


def cost(z: np.ndarray, y: np.ndarray, point: np.ndarray) -> float:
    """Mean squared residual plus the squares of all weights except the offset."""
    theta = point[3:].reshape(4, 2)
    found = point[0] + np.tanh(np.column_stack([np.ones(60), z]) @ theta) @ point[1:3]
    return float(np.mean((found - y) ** 2) + DECAY * np.sum(point[1:] ** 2))


def jacobian(problem: _Problem, point: np.ndarray) -> np.ndarray:
    """Derivatives of the output by differences."""

    def output(p: np.ndarray) -> np.ndarray:
        return p[0] + np.tanh(problem.x @ p[3:].reshape(4, 2)) @ p[1:3]

    steps = 1e-6 * np.eye(11)
    return np.stack([(output(point + s) - output(point - s)) / 2e-6 for s in steps], axis=1)


def test_cost_and_normal_equations_follow_from_the_output(data: tuple) -> None:
    z, y, theta = data
    problem = _Problem(z, y, 2)
    point = np.concatenate([[0.3, -0.7, 1.1], theta.ravel()])
    shrinkage = problem._shrinkage(DECAY, 11)
    np.testing.assert_array_equal(shrinkage, [0.0, *[DECAY] * 10])
    assert problem._cost(point, shrinkage) == pytest.approx(cost(z, y, point), rel=1e-12, abs=0.0)
    gram, half = problem._normal_equations(point, shrinkage)
    slopes = jacobian(problem, point)
    np.testing.assert_allclose(gram, slopes.T @ slopes / 60 + np.diag(shrinkage), atol=1e-8)
    steps = 1e-5 * np.eye(11)
    gradient = [(cost(z, y, point + s) - cost(z, y, point - s)) / 2e-5 for s in steps]
    np.testing.assert_allclose(2.0 * half, gradient, rtol=1e-6, atol=1e-9)


def test_the_initial_output_layer_is_optimal(data: tuple) -> None:
    z, y, theta = data
    problem = _Problem(z, y, 2)
    point = problem.start(theta, DECAY)
    np.testing.assert_array_equal(point[3:], theta.ravel())
    _, half = problem._normal_equations(point, problem._shrinkage(DECAY, 11))
    np.testing.assert_allclose(half[:3], 0.0, atol=1e-14)


def iterations(problem: _Problem, point: np.ndarray, count: int) -> np.ndarray:
    """Levenberg-Marquardt with an initial damping of a hundredth of the diagonal."""
    shrinkage, damping = problem._shrinkage(DECAY, 11), 1e-2
    for _ in range(count):
        gram, gradient = problem._normal_equations(point, shrinkage)
        step = np.linalg.solve(gram + damping * np.diag(np.diag(gram)), gradient)
        if problem._cost(point - step, shrinkage) < problem._cost(point, shrinkage):
            point, damping = point - step, max(damping / 5.0, 1e-9)
        else:
            damping *= 4.0
    return point


@pytest.mark.parametrize("count", [1, 2, 7, 15])
def test_iterations_follow_levenberg_marquardt(
    data: tuple, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    z, y, theta = data
    problem = _Problem(z, y, 2)
    start = np.concatenate([problem.start(theta, DECAY)[:3], 3.0 * theta.ravel()])
    monkeypatch.setattr(mlp, "CONVERGED", 0.0)
    if count < mlp.ITERATIONS:
        monkeypatch.setattr(mlp, "ITERATIONS", count)
    assert count == mlp.ITERATIONS
    point, found = problem.train(start, DECAY)
    expected = iterations(problem, start, count)
    np.testing.assert_allclose(point, expected, rtol=1e-9, atol=1e-12)
    assert found == pytest.approx(cost(z, y, expected), rel=1e-9)


def test_iterations_end_at_a_gain_of_a_hundred_thousandth(data: tuple) -> None:
    z, y, theta = data
    problem = _Problem(z, y, 2)
    start = 1.02 * iterations(problem, problem.start(theta, DECAY), 200)
    costs = [cost(z, y, iterations(problem, start, k)) for k in range(16)]
    gains = -np.diff(costs) / costs[:-1]
    last = int(np.argmax((gains < 1e-5) & (gains > 0.0))) + 1
    assert 1 < last < 15
    assert problem.train(start, DECAY)[1] == pytest.approx(costs[last], rel=1e-12, abs=0.0)


def test_each_decay_starts_at_the_end_of_the_previous_one(data: tuple) -> None:
    z, y, theta = data
    problem = _Problem(z, y, 2)
    point = problem.start(theta, 1e-2)
    for decay, network in zip((1e-2, 1e-4), train_path(z, y, theta, [1e-2, 1e-4]), strict=True):
        point, found = problem.train(point, decay)
        assert network.cost == pytest.approx(found, rel=1e-12, abs=0.0)
        np.testing.assert_allclose([network.bias, *network.gains], point[:3], rtol=1e-10)
        np.testing.assert_allclose(network.theta.ravel(), point[3:], rtol=1e-10)
        hidden = np.tanh(np.column_stack([np.ones(60), z]) @ network.theta)
        np.testing.assert_allclose(network.output(z), hidden @ point[1:3] + point[0], rtol=1e-12)
