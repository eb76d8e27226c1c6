"""Physically consistent inertial parameters: positive mass density everywhere.

A link is such a body if and only if its pseudo-inertia is positive definite (Wensing, Kim, Slotine
2018)::

    P = [[Sigma, h], [h', m]],    Sigma = tr(I)/2 1 - I = integral of r r' dm,    h = m c

The search uses P = B U U' B' (log-Cholesky, Rucker and Wensing 2022): B B' is the pseudo-inertia of
the model file, with a weak pull towards it, and U is upper triangular. Rotor inertias are squares.
Springs are free, as friction is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy

from hesr_model.inference.covariance import Covariance
from hesr_model.rigid_body.base_parameters import dependence, sample_regressor
from hesr_model.rigid_body.least_squares import Block, Solution, estimate_covariance
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Integers

# Cost of one unit of a coordinate, in residual standard deviations per square root of rows; 0.1 to
# 0.3 are equally good on measured logs left out in turn.
_PULL = 0.2
_WEAK_SHARE = 1e-2  # share of the pull that chooses among equal torques
_TINY = 1e-12
_ROUNDING = 1e-9
_MIN_PULL = 1e-4  # pull of unknown rotors, which makes them unique
_REWEIGHTINGS = 2
# Well determined bodies need 10. Others creep along a valley towards bodies without extent, where
# thousands of evaluations lower the cost by 0.2 %.
_MAX_EVALUATIONS = 300
_MIN_RADIUS = 5e-3  # radius of gyration [m] at the start
_UNKNOWN_LINK = np.array([1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01])
"""Start of a link without mass in the model file: 1 kg with radii of gyration of 0.1 m."""
_TRIANGLE_PLACES = (
    (0, 1, 2, 3, 0, 0, 1, 0, 1, 2),
    (0, 1, 2, 3, 1, 2, 2, 3, 3, 3),
)  # of an upper triangle


@dataclass(frozen=True, kw_only=True, eq=False)
class PhysicalFit:
    """Physically consistent parameters (P,), friction, and covariance with the pull as prior."""

    parameters: Array
    friction: Array
    covariance: Covariance
    rmse: Array


def pseudo_inertia(parameters: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a link's ten parameters."""
    m, mx, my, mz, ixx, ixy, iyy, ixz, iyz, izz = parameters
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    pseudo[:3, 3] = pseudo[3, :3] = mx, my, mz
    pseudo[3, 3] = m
    return pseudo


def link_parameters(pseudo: Array) -> Array:
    """Return the ten parameters (..., 10) of links from their pseudo-inertias (..., 4, 4)."""
    sigma = pseudo[..., :3, :3]
    inertia = np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - sigma
    first = (0, 0, 1, 0, 1, 2)
    second = (0, 1, 1, 2, 2, 2)
    parts = (pseudo[..., 3, 3:], pseudo[..., :3, 3], inertia[..., first, second])
    return np.concatenate(parts, axis=-1)


def fit(
    blocks: Sequence[Block],
    robot: Robot,
    base: tuple[int, ...],
    labels: Integers,
    *,
    rmse: Array,
    weighted: bool,
) -> PhysicalFit:
    """Fit physically consistent parameters by Levenberg-Marquardt, friction eliminated.

    `blocks` have all P standard columns, then friction columns; `labels` (samples,) is the log
    number of each sample, `rmse` (blocks,) [N.m] the residual of the unconstrained fit, for first
    weights.
    """
    chart = _Chart.from_robot(robot)
    row_count = sum(len(block.target) for block in blocks)
    inertial_count = robot.inertial
    x = chart.start
    for _ in range(_REWEIGHTINGS):
        weights = _compute_weights(blocks, rmse, weighted)
        triangle, inertial_rows = _eliminate_parameters(blocks, weights, inertial_count)
        problem = _Problem(chart=chart, rows=inertial_rows, pull=chart.pull * np.sqrt(row_count))
        x = scipy.optimize.least_squares(
            problem.residuals, x, jac=problem.slopes, method="lm", max_nfev=_MAX_EVALUATIONS
        ).x
        inertial = chart.parameters(x)
        free_count = triangle.shape[1] - inertial_count - 1
        remaining_torque = triangle[:free_count, -1] - (
            triangle[:free_count, free_count:-1] @ inertial
        )
        free_coefficients = scipy.linalg.solve_triangular(
            triangle[:free_count, :free_count], remaining_torque
        )
        all_coefficients = np.concatenate([inertial, free_coefficients])
        residuals = [block.target - block.matrix @ all_coefficients for block in blocks]
        rmse = np.array([np.sqrt(np.mean(residual**2)) for residual in residuals])
    slopes = np.eye(len(all_coefficients), len(x) + free_count)
    slopes[:inertial_count, : len(x)] = chart.slopes(x)
    slopes[inertial_count:, len(x) :] = np.eye(free_count)
    linearised_blocks = []
    for block, residual in zip(blocks, residuals, strict=True):
        linearised_blocks.append(
            Block(matrix=block.matrix @ slopes, target=residual, samples=block.samples)
        )
    local_solution = Solution(
        x=np.zeros(len(x) + free_count),
        condition=1.0,
        ridge=0.0,
        pull=np.concatenate([problem.pull, np.zeros(free_count)]),
        weights=weights,
        rmse=rmse,
    )
    parameter_count = len(robot.parameter_names)
    to_base = dependence(robot, base) @ slopes[:parameter_count]
    covariance = estimate_covariance(linearised_blocks, local_solution, labels)
    return PhysicalFit(
        parameters=all_coefficients[:parameter_count],
        friction=all_coefficients[parameter_count:],
        covariance=covariance.transform([robot.parameter_names[k] for k in base], to_base),
        rmse=rmse,
    )


def is_possible(robot: Robot, parameters: Array) -> bool:
    """Return whether bodies can have these parameters (P,), without mass included."""
    links = parameters[: 10 * robot.links].reshape(-1, 10)
    lowest_ratios = []
    for link in links:
        pseudo = pseudo_inertia(link)
        lowest_ratios.append(np.linalg.eigvalsh(pseudo)[0] / max(np.trace(pseudo), _TINY))
    rotors = parameters[10 * robot.links : robot.inertial]
    return min(lowest_ratios) > -_ROUNDING and bool(np.all(rotors >= 0.0))


def find_nearest(robot: Robot, parameters: Array) -> tuple[Array, Array, Array]:
    """Return the physically consistent parameters (P,) with torques closest to those of others.

    Also returns the largest difference and the largest torque per joint, (n,) [N.m], at random
    states.
    """
    inertial_count = robot.inertial
    rows = sample_regressor(robot)
    torque = (rows @ parameters).reshape(-1, robot.n)
    weights = np.tile(1.0 / np.maximum(np.std(torque, axis=0), _TINY), len(torque))[:, None]
    inertial_rows = rows[:, :inertial_count]
    inertial_torque = inertial_rows @ parameters[:inertial_count]
    weighted_rows = weights * np.column_stack([inertial_rows, inertial_torque])
    (triangle,) = scipy.linalg.qr(weighted_rows, mode="r")
    chart = _Chart.from_robot(robot)
    scaled_rows = triangle[: inertial_count + 1] / np.sqrt(len(rows))
    problem = _Problem(chart=chart, rows=scaled_rows, pull=_WEAK_SHARE * chart.pull)
    x = scipy.optimize.least_squares(
        problem.residuals, chart.start, jac=problem.slopes, method="lm"
    ).x
    consistent_parameters = np.concatenate([chart.parameters(x), parameters[inertial_count:]])
    difference = np.abs((rows @ consistent_parameters).reshape(-1, robot.n) - torque)
    return consistent_parameters, difference.max(axis=0), np.abs(torque).max(axis=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Chart:
    """Coordinates of physically consistent parameters: ten per link, one per rotor (r)."""

    factors: Array  # (n, 4, 4), upper triangular B
    start: Array  # (10 n + r,) of the model file
    pull: Array  # (10 n + r,) residual per unit and square root of rows

    @classmethod
    def from_robot(cls, robot: Robot) -> Self:
        nominal = robot.nominal_parameters[: robot.inertial]
        links = 10 * robot.links
        factors = [_upper_factor(_start_inertia(link)) for link in nominal[:links].reshape(-1, 10)]
        rotors = nominal[links:]
        is_known = rotors > 0
        roots = np.sqrt(np.where(is_known, rotors, 1.0))
        rotor_pulls = np.where(is_known, 2 * _PULL / roots, _MIN_PULL)
        return cls(
            factors=np.array(factors),
            start=np.concatenate([np.zeros(links), roots]),
            pull=np.concatenate([np.full(links, _PULL), rotor_pulls]),
        )

    def parameters(self, x: Array) -> Array:
        """Return the standard parameters (P,) at coordinates."""
        links = 10 * len(self.factors)
        b = self.factors
        u = _triangles(x[:links].reshape(-1, 10))
        parameters_by_link = link_parameters(b @ u @ u.mT @ b.mT)
        return np.concatenate([parameters_by_link.ravel(), x[links:] ** 2])

    def slopes(self, x: Array) -> Array:
        """Return the derivatives (P, 10 n + r) of the parameters."""
        links = 10 * len(self.factors)
        u = _triangles(x[:links].reshape(-1, 10))
        changes = np.zeros((len(self.factors), 10, 4, 4))
        changes[:, range(10), *_TRIANGLE_PLACES] = 1.0
        changes[:, range(4), range(4), range(4)] = u[:, range(4), range(4)]
        b = self.factors[:, None]
        half = b @ changes @ u[:, None].mT @ b.mT
        blocks = link_parameters(half + half.mT).transpose(0, 2, 1)
        return np.asarray(scipy.linalg.block_diag(*blocks, np.diag(2 * x[links:])))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    chart: _Chart
    rows: Array
    pull: Array

    def residuals(self, x: Array) -> Array:
        torque = self.rows[:, :-1] @ self.chart.parameters(x) - self.rows[:, -1]
        return np.concatenate([torque, self.pull * (x - self.chart.start)])

    def slopes(self, x: Array) -> Array:
        return np.vstack([self.rows[:, :-1] @ self.chart.slopes(x), np.diag(self.pull)])


def _triangles(x: Array) -> Array:
    u = np.zeros((len(x), 4, 4))
    u[:, *_TRIANGLE_PLACES] = np.hstack([np.exp(x[:, :4]), x[:, 4:]])
    return u


def _upper_factor(matrix: Array) -> Array:
    return np.asarray(np.linalg.cholesky(matrix[::-1, ::-1])[::-1, ::-1])


def _start_inertia(link: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a link of the model file, made positive definite."""
    if not link[0] > 0:
        link = _UNKNOWN_LINK
    pseudo = pseudo_inertia(link)
    m = pseudo[3, 3]
    centre = pseudo[:3, 3] / pseudo[3, 3]
    about_centre = pseudo[:3, :3] - m * np.outer(centre, centre)
    values, vectors = np.linalg.eigh(about_centre)
    values = np.maximum(values, m * _MIN_RADIUS**2)
    pseudo[:3, :3] = (vectors * values) @ vectors.T + m * np.outer(centre, centre)
    return pseudo


def _compute_weights(blocks: Sequence[Block], rmse: Array, weighted: bool) -> Array:
    if not weighted:
        counts = np.array([len(block.target) for block in blocks])
        rmse = np.full(len(blocks), np.sqrt(np.sum(counts * rmse**2) / np.sum(counts)))
    largest = max(float(np.max(rmse)), 1e-9)
    return np.asarray(1.0 / np.maximum(rmse, 1e-6 * largest))


def _eliminate_parameters(
    blocks: Sequence[Block], weights: Array, inertial_count: int
) -> tuple[Array, Array]:
    """Return the triangle of all rows, other unknowns first, and its rows of inertial ones."""
    weighted_rows = []
    for weight, block in zip(weights, blocks, strict=True):
        others = block.matrix[:, inertial_count:]
        inertial = block.matrix[:, :inertial_count]
        weighted_rows.append(weight * np.column_stack([others, inertial, block.target]))
    (triangle,) = scipy.linalg.qr(np.concatenate(weighted_rows), mode="r", check_finite=False)
    triangle = np.asarray(triangle[: triangle.shape[1]])
    free_count = triangle.shape[1] - inertial_count - 1
    return triangle, triangle[free_count:, free_count:]
