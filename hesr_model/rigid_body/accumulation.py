"""Identification motion by motion, with bounded memory.

Least squares needs only triangular factors (Golub and Van Loan, Matrix Computations, sec. 5.3 and
6.5): the estimate is that of `identification.identify`, with a conservative covariance.
"""

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from hesr_model.logs.signals import Motion
from hesr_model.rigid_body import identification, observations
from hesr_model.rigid_body.base_parameters import unknown_columns
from hesr_model.rigid_body.least_squares import Block, Factor, covariance_of, solve_factors
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array


class Streamed:
    """The growing stacked problem of a robot.

    Rows slower than `slow` (n,) [rad/s] are dropped, which depends on all motions: check `fits`.
    """

    def __init__(self, model: Robot, slow: Array | None = None) -> None:
        self._model, self._base = model, unknown_columns(model)
        self._friction = observations.friction_columns(model, self._base)
        self._used = np.full(model.n, observations.SLOW) if slow is None else slow
        self._peaks = np.zeros(model.n)
        columns = len(self._base) + int(np.sum(self._friction))
        self._factors = [Factor(triangle=np.zeros((0, columns + 1)))] * model.n
        self._logs: dict[str, None] = {}
        self.rows = 0

    @property
    def slow(self) -> Array:
        """Speeds (n,) below which rows should be dropped, by the motions so far."""
        return observations.slow_speeds(self._peaks)

    @property
    def fits(self) -> bool:
        """Whether those rows were dropped; otherwise add the motions again."""
        return np.array_equal(self.slow, self._used)

    def add(self, motion: Motion) -> None:
        """Add the rows of a motion."""
        self._peaks = np.maximum(self._peaks, observations.peak_speeds([motion], self._model))
        self._logs[motion.name] = None
        self.rows += len(motion.t)
        with threadpool_limits(1):
            for first in range(0, len(motion.t), identification.AT_ONCE):
                blocks = self._blocks([motion.rows(slice(first, first + identification.AT_ONCE))])
                rows = zip(self._factors, blocks, strict=True)
                self._factors = [factor.with_rows(block) for factor, block in rows]

    def body(self, sample: Sequence[Motion], where: str) -> identification.RigidBody:
        """Return the rigid body, its covariance from `sample`; raises FitError."""
        model, base, friction = self._model, self._base, self._friction
        identification.require_samples(where, self.rows, len(base) + int(np.sum(friction)))
        identification.require_speed(where, self._peaks, model)
        scale = identification.scale_of(model, base, friction)
        with threadpool_limits(1):
            loose = identification.loose_of(model, base, friction)
            solution = solve_factors(self._factors, scale=scale, weighted=True, loose=loose)
            identification.tell_ridge(where, solution)
            covariance = covariance_of(self._blocks(sample), solution, observations.logs_of(sample))
        return identification.body_of(
            solution,
            covariance,
            model,
            base,
            friction,
            rows=self.rows,
            logs=tuple(self._logs),
            method="stacked",
            weighting="wls",
        )

    def _blocks(self, motions: Sequence[Motion]) -> list[Block]:
        left = observations.without_known(motions, self._model)
        return observations.stacked(left, self._model, self._base, self._friction, self._used)
