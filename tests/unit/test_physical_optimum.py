"""The physically consistent fit against a general solver on its published objective."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from hesr_model.inference.covariance import covariance, leave_out_rows
from hesr_model.rigid_body.base_parameters import base_columns, dependence
from hesr_model.rigid_body.least_squares import Block
from hesr_model.rigid_body.physical import _Chart, _compute_weights, fit, link_parameters
from hesr_model.robots.robot import Robot

FRICTION = np.array([3.0, -1.0])


def blocks(model: Robot) -> list[Block]:
    """Three random joints with different noise and row counts, and two friction columns."""
    rng = np.random.default_rng(4)
    q, dq, ddq = rng.uniform(-2.0, 2.0, (3, 30, 3))
    regressor = model.regressor(q, dq, ddq)
    made, first = [], 0
    for joint, (rows, noise) in enumerate(((30, 2.0), (20, 0.5), (10, 0.1))):
        matrix = np.hstack([regressor[:rows, joint], rng.standard_normal((rows, 2))])
        truth = np.concatenate([1.2 * model.nominal_parameters, FRICTION])
        target = matrix @ truth + noise * rng.standard_normal(rows)
        samples = np.arange(first, first + rows)
        first += rows
        made.append(Block(matrix=matrix, target=target, samples=samples))
    return made


@pytest.mark.parametrize("weighted", [True, False])
def test_the_fit_minimises_residuals_plus_pull(weighted: bool, arm_model: Robot) -> None:
    """Solved twice, the second time weighted by the residuals of the first.

    A coordinate of a link costs 0.2 standard deviations per square root of rows. A relative
    change of a rotor's square root costs twice as much, because the square is the parameter.
    """
    given, chart = blocks(arm_model), _Chart.from_robot(arm_model)
    base = base_columns(arm_model)
    roots = np.sqrt(arm_model.nominal_parameters[30:])
    pull = np.sqrt(60) * np.concatenate([np.full(30, 0.2), 0.4 / roots])
    rmse, point = np.array([1.0, 0.4, 0.2]), np.concatenate([chart.start, [0.0, 0.0]])
    for _ in range(2):
        pooled = np.sqrt(np.sum([30, 20, 10] * rmse**2) / 60)
        scale = rmse if weighted else np.full(3, pooled)

        def residuals(x: np.ndarray, scale: np.ndarray = scale) -> np.ndarray:
            every = np.concatenate([chart.parameters(x[:33]), x[33:]])
            parts = [(b.matrix @ every - b.target) / s for b, s in zip(given, scale, strict=True)]
            return np.concatenate([*parts, pull * (x[:33] - chart.start)])

        found = least_squares(residuals, point, jac="3-point", x_scale="jac", xtol=1e-14)
        point, parts = found.x, np.split(residuals(found.x)[:60], [30, 50])
        rmse = np.array([s * np.sqrt(np.mean(p**2)) for s, p in zip(scale, parts, strict=True)])
    labels = np.arange(60) % 3
    body = fit(given, arm_model, base, labels, rmse=np.array([1.0, 0.4, 0.2]), weighted=weighted)
    np.testing.assert_allclose(body.parameters, chart.parameters(point[:33]), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(body.friction, point[33:], rtol=1e-4)
    np.testing.assert_allclose(body.rmse, rmse, rtol=1e-5)
    spread = dependence(arm_model, base) @ chart.slopes(point[:33])
    spread = np.hstack([spread, np.zeros((len(base), 2))])
    jacobian, residual = found.jac[:60], residuals(found.x)[:60]
    known = np.diag(np.concatenate([pull**2, np.zeros(2)]))
    hessians = [jacobian[labels == k].T @ jacobian[labels == k] for k in range(3)]
    expected = covariance(
        ("",) * 35,
        jacobian * leave_out_rows(jacobian, residual, found.jac.T @ found.jac)[:, None],
        hessians,
        labels,
        prior_hessian=known,
    ).transform(("",) * len(base), spread)
    np.testing.assert_allclose(np.diag(body.covariance.within), np.diag(expected.within), rtol=3e-3)
    inverse = np.linalg.inv(found.jac.T @ found.jac)
    carried = spread @ inverse @ known @ inverse @ spread.T
    np.testing.assert_allclose(np.diag(body.covariance.carried), np.diag(carried), rtol=3e-3)


def test_weights_are_bounded_inverse_residuals() -> None:
    rows = [Block(matrix=np.zeros((n, 1)), target=np.zeros(n)) for n in (1, 3, 4)]
    found = _compute_weights(rows, np.array([2.0, 0.5, 0.0]), weighted=True)
    np.testing.assert_allclose(found, [0.5, 2.0, 0.5e6])
    np.testing.assert_allclose(_compute_weights(rows[:1], np.zeros(1), weighted=True), [1e15])
    pooled = np.sqrt((1 * 2.0**2 + 3 * 0.5**2) / 8)
    found = _compute_weights(rows, np.array([2.0, 0.5, 0.0]), weighted=False)
    np.testing.assert_allclose(found, 1.0 / pooled)


def test_defaults_of_unknown_links_and_rotors(arm_model: Robot) -> None:
    """Radii of gyration are 0.1 m; thin bodies get 5 mm and keep their centre and mass."""
    arm_model.nominal_parameters[:10] = 0.0
    arm_model.nominal_parameters[20:30] = [2.0, 0.2, 0.0, 0.4, 0, 0, 0, 0, 0, 0]
    arm_model.nominal_parameters[30] = 0.0
    chart = _Chart.from_robot(arm_model)
    expected = [1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01]
    np.testing.assert_allclose(chart.parameters(chart.start)[:10], expected, atol=1e-15)
    centre = np.array([0.1, 0.0, 0.2])
    pseudo = np.zeros((4, 4))
    # The inertia about the origin is given as zero, so it is negative about the centre.
    values, vectors = np.linalg.eigh(-2.0 * np.outer(centre, centre))
    about = (vectors * np.maximum(values, 2.0 * 5e-3**2)) @ vectors.T
    pseudo[:3, :3] = about + 2.0 * np.outer(centre, centre)
    pseudo[:3, 3] = pseudo[3, :3] = 2.0 * centre
    pseudo[3, 3] = 2.0
    np.testing.assert_allclose(
        chart.parameters(chart.start)[20:30], link_parameters(pseudo), atol=1e-12
    )
    np.testing.assert_allclose(chart.start[30:], [1.0, *np.sqrt([0.3, 0.1])])
    np.testing.assert_allclose(chart.pull, [*np.full(30, 0.2), 1e-4, *(0.4 / np.sqrt([0.3, 0.1]))])
