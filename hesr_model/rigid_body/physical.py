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
from hesr_model.rigid_body.base_parameters import at_random_states, dependence
from hesr_model.rigid_body.least_squares import Block, Solution, covariance_of
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Integers

# Cost of one unit of a coordinate, in residual standard deviations per square root of rows; 0.1 to
# 0.3 are equally good on measured logs left out in turn.
_PULL = 0.2
_WEAK = 1e-2  # share of the pull that chooses among equal torques
_TINY = 1e-12
_ROUNDING = 1e-9
_LEAST_PULL = 1e-4  # pull of unknown rotors, which makes them unique
_REWEIGHTINGS = 2
_SMALLEST_RADIUS = 5e-3  # radius of gyration [m] at the start
_UNKNOWN_LINK = np.array([1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01])
"""Start of a link without mass in the model file: 1 kg with radii of gyration of 0.1 m."""
_PLACES = (0, 1, 2, 3, 0, 0, 1, 0, 1, 2), (0, 1, 2, 3, 1, 2, 2, 3, 3, 3)  # of an upper triangle


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
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    out[:3, 3] = out[3, :3] = mx, my, mz
    out[3, 3] = m
    return out


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
    chart = _Chart.of(robot)
    count = sum(len(block.target) for block in blocks)
    size = robot.inertial
    x = chart.start
    for _ in range(_REWEIGHTINGS):
        weights = _weights(blocks, rmse, weighted)
        factor, free = _eliminate_parameters(blocks, weights, size)
        problem = _Problem(chart=chart, rows=free, pull=chart.pull * np.sqrt(count))
        x = scipy.optimize.least_squares(problem.residuals, x, jac=problem.slopes, method="lm").x
        inertial = chart.parameters(x)
        others = factor.shape[1] - size - 1
        freely = scipy.linalg.solve_triangular(
            factor[:others, :others], factor[:others, -1] - factor[:others, others:-1] @ inertial
        )
        every = np.concatenate([inertial, freely])
        rmse = np.array([np.sqrt(np.mean((b.target - b.matrix @ every) ** 2)) for b in blocks])
    slopes = np.eye(len(every), len(x) + others)
    slopes[:size, : len(x)] = chart.slopes(x)
    slopes[size:, len(x) :] = np.eye(others)
    moved = [
        Block(matrix=b.matrix @ slopes, target=b.target - b.matrix @ every, samples=b.samples)
        for b in blocks
    ]
    at = Solution(
        x=np.zeros(len(x) + others),
        condition=1.0,
        ridge=0.0,
        pull=np.concatenate([problem.pull, np.zeros(others)]),
        weights=weights,
        rmse=rmse,
    )
    standard = len(robot.parameter_names)
    to_base = dependence(robot, base) @ slopes[:standard]
    covariance = covariance_of(moved, at, labels)
    return PhysicalFit(
        parameters=every[:standard],
        friction=every[standard:],
        covariance=covariance.mapped([robot.parameter_names[k] for k in base], to_base),
        rmse=rmse,
    )


def is_possible(robot: Robot, parameters: Array) -> bool:
    """Return whether bodies can have these parameters (P,), without mass included."""
    links = parameters[: 10 * robot.links].reshape(-1, 10)
    least = [np.linalg.eigvalsh(p)[0] / max(np.trace(p), _TINY) for p in map(pseudo_inertia, links)]
    rotors = parameters[10 * robot.links : robot.inertial]
    return min(least) > -_ROUNDING and bool(np.all(rotors >= 0.0))


def nearest(robot: Robot, parameters: Array) -> tuple[Array, Array, Array]:
    """Return the physically consistent parameters (P,) with torques closest to those of others.

    Also returns the largest difference and the largest torque per joint, (n,) [N.m], at random
    states.
    """
    size = robot.inertial
    rows = at_random_states(robot)
    torque = (rows @ parameters).reshape(-1, robot.n)
    weights = np.tile(1.0 / np.maximum(np.std(torque, axis=0), _TINY), len(torque))[:, None]
    own = rows[:, :size]
    (factor,) = scipy.linalg.qr(weights * np.column_stack([own, own @ parameters[:size]]), mode="r")
    chart = _Chart.of(robot)
    scaled = factor[: size + 1] / np.sqrt(len(rows))
    task = _Problem(chart=chart, rows=scaled, pull=_WEAK * chart.pull)
    x = scipy.optimize.least_squares(task.residuals, chart.start, jac=task.slopes, method="lm").x
    found = np.concatenate([chart.parameters(x), parameters[size:]])
    off = np.abs((rows @ found).reshape(-1, robot.n) - torque)
    return found, off.max(axis=0), np.abs(torque).max(axis=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Chart:
    """Coordinates of physically consistent parameters: ten per link, one per rotor (r)."""

    factors: Array  # (n, 4, 4), upper triangular B
    start: Array  # (10 n + r,) of the model file
    pull: Array  # (10 n + r,) residual per unit and square root of rows

    @classmethod
    def of(cls, robot: Robot) -> Self:
        nominal = robot.nominal_parameters[: robot.inertial]
        links = 10 * robot.links
        factors = [_upper_factor(_start(link)) for link in nominal[:links].reshape(-1, 10)]
        rotors = nominal[links:]
        known = rotors > 0
        roots = np.sqrt(np.where(known, rotors, 1.0))
        of_rotors = np.where(known, 2 * _PULL / roots, _LEAST_PULL)
        return cls(
            factors=np.array(factors),
            start=np.concatenate([np.zeros(links), roots]),
            pull=np.concatenate([np.full(links, _PULL), of_rotors]),
        )

    def parameters(self, x: Array) -> Array:
        """Return the standard parameters (P,) at coordinates."""
        links = 10 * len(self.factors)
        b = self.factors
        u = _triangles(x[:links].reshape(-1, 10))
        own = link_parameters(b @ u @ u.mT @ b.mT)
        return np.concatenate([own.ravel(), x[links:] ** 2])

    def slopes(self, x: Array) -> Array:
        """Return the derivatives (P, 10 n + r) of the parameters."""
        links = 10 * len(self.factors)
        u = _triangles(x[:links].reshape(-1, 10))
        changes = np.zeros((len(self.factors), 10, 4, 4))
        changes[:, range(10), *_PLACES] = 1.0
        changes[:, range(4), range(4), range(4)] = u[:, range(4), range(4)]
        b, u = self.factors[:, None], u[:, None]
        half = b @ changes @ u.mT @ b.mT
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
    u[:, *_PLACES] = np.hstack([np.exp(x[:, :4]), x[:, 4:]])
    return u


def _upper_factor(matrix: Array) -> Array:
    return np.asarray(np.linalg.cholesky(matrix[::-1, ::-1])[::-1, ::-1])


def _start(link: Array) -> Array:
    pseudo = pseudo_inertia(link if link[0] > 0 else _UNKNOWN_LINK)
    m = pseudo[3, 3]
    centre = pseudo[:3, 3] / pseudo[3, 3]
    about_centre = pseudo[:3, :3] - m * np.outer(centre, centre)
    values, vectors = np.linalg.eigh(about_centre)
    values = np.maximum(values, m * _SMALLEST_RADIUS**2)
    pseudo[:3, :3] = (vectors * values) @ vectors.T + m * np.outer(centre, centre)
    return pseudo


def _weights(blocks: Sequence[Block], rmse: Array, weighted: bool) -> Array:
    if not weighted:
        counts = np.array([len(block.target) for block in blocks])
        rmse = np.full(len(blocks), np.sqrt(np.sum(counts * rmse**2) / np.sum(counts)))
    largest = max(float(np.max(rmse)), 1e-9)
    return np.asarray(1.0 / np.maximum(rmse, 1e-6 * largest))


def _eliminate_parameters(
    blocks: Sequence[Block], weights: Array, size: int
) -> tuple[Array, Array]:
    parts = [
        weight * np.column_stack([block.matrix[:, size:], block.matrix[:, :size], block.target])
        for weight, block in zip(weights, blocks, strict=True)
    ]
    (factor,) = scipy.linalg.qr(np.concatenate(parts), mode="r", check_finite=False)
    factor = np.asarray(factor[: factor.shape[1]])
    others = factor.shape[1] - size - 1
    return factor, factor[others:, others:]
