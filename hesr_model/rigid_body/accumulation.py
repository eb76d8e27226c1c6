"""Identification motion by motion, with bounded memory.

Least squares needs only triangular factors (Golub and Van Loan, Matrix Computations, sec. 5.3 and
6.5): the estimate is that of `identification.identify`. Its covariance needs the motions twice
again; that of a sample of them is conservative.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np
from threadpoolctl import threadpool_limits

from hesr_model.inference.covariance import BLOCKS, Covariance, Gradients, covariance_of_parts
from hesr_model.logs.long_log import LongLog
from hesr_model.logs.rest import find_travelling
from hesr_model.logs.robot_log import require_travel
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body import identification, least_squares, observations
from hesr_model.rigid_body.base_parameters import unknown_columns
from hesr_model.rigid_body.least_squares import Factor, Solution
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Mask, find_independent_columns


class StreamedProblem:
    """The growing stacked problem of a robot.

    Rows slower than `min_speeds` (n,) [rad/s] are dropped, which depend on all motions: check
    `is_consistent`.
    """

    def __init__(self, robot: Robot, min_speeds: Array | None = None) -> None:
        self._robot = robot
        self._base = unknown_columns(robot)
        self._friction = observations.friction_columns(robot, self._base)
        if min_speeds is None:
            min_speeds = np.full(robot.n, observations.SLOW)
        self._used_min_speeds = min_speeds
        self._peaks = np.zeros(robot.n)
        column_count = len(self._base) + int(np.sum(self._friction))
        self._factors = [Factor(triangle=np.zeros((0, column_count + 1)))] * robot.n
        self._logs: dict[str, None] = {}
        self.rows = 0

    @property
    def min_speeds(self) -> Array:
        """Speeds (n,) below which rows should be dropped, by the motions so far."""
        return observations.slow_speeds(self._peaks)

    @property
    def is_consistent(self) -> bool:
        """Whether those rows were dropped; otherwise add the motions again."""
        return np.array_equal(self.min_speeds, self._used_min_speeds)

    def add(self, motion: Motion) -> None:
        """Add the rows of a motion."""
        self._peaks = np.maximum(self._peaks, observations.peak_speeds([motion], self._robot))
        self._logs[motion.name] = None
        self.rows += len(motion.t)
        with threadpool_limits(1):
            for first in range(0, len(motion.t), identification.ROWS_AT_ONCE):
                chunk = motion.rows(slice(first, first + identification.ROWS_AT_ONCE))
                blocks = self._build_blocks([chunk])
                rows = zip(self._factors, blocks, strict=True)
                self._factors = [factor.add_rows(block) for factor, block in rows]

    def _find_determined_friction(self) -> Mask:
        """Return the columns of `observations.find_determined_friction` for all motions."""
        # Triangular factors have the products of the columns.
        first = len(self._base)
        is_determined = self._friction.copy()
        ends = first + np.cumsum(np.sum(self._friction, axis=1))
        for j, factor in enumerate(self._factors):
            columns = factor.triangle[:, ends[j] - np.sum(self._friction[j]) : ends[j]]
            is_determined[j, self._friction[j]] = find_independent_columns(columns)
        return is_determined

    def _hold_friction(self, is_determined: Mask) -> None:
        """Leave the other columns of friction out."""
        is_used = np.concatenate(
            [np.ones(len(self._base), dtype=bool), is_determined[self._friction], [True]]
        )
        self._factors = [
            replace(factor, triangle=factor.triangle[:, is_used]) for factor in self._factors
        ]
        self._friction = is_determined

    def body(
        self, motions: Sequence[Motion] | Callable[[], Iterable[Motion]], where: str
    ) -> identification.RigidBody:
        """Return the rigid body, with the covariance of some or all `motions`; raises FitError."""
        robot = self._robot
        base = self._base
        self._hold_friction(self._find_determined_friction())
        friction = self._friction
        identification.require_samples(where, self.rows, len(base) + int(np.sum(friction)))
        identification.require_speed(
            where, self._peaks, robot, np.full(robot.n, identification.MIN_PEAK_SPEED)
        )
        scale = identification.compute_scale(robot, base, friction, self._peaks)
        with threadpool_limits(1):
            is_loose = identification.find_loose_columns(robot, base, friction)
            factors = self._factors
            solution = least_squares.solve_factors(
                factors, scale=scale, weighted=True, is_loose=is_loose
            )
            identification.warn_of_ridge(where, solution)
            if callable(motions):
                covariance = self._estimate_covariance(motions, solution)
            else:
                blocks = self._build_blocks(motions)
                labels = observations.label_samples(motions)
                covariance = least_squares.estimate_covariance(blocks, solution, labels)
        return identification.build_body(
            solution,
            covariance,
            robot,
            base,
            friction,
            rows=self.rows,
            logs=tuple(self._logs),
            method="stacked",
            weighting="wls",
        )

    def _build_blocks(self, motions: Sequence[Motion]) -> list[least_squares.Block]:
        reduced_motions = observations.remove_known_torque(motions, self._robot)
        return observations.stack_blocks(
            reduced_motions, self._robot, self._base, self._friction, self._used_min_speeds
        )

    def _estimate_covariance(
        self, motions: Callable[[], Iterable[Motion]], solution: Solution
    ) -> Covariance:
        prior = np.diag(solution.pull**2)
        weighted_factors = zip(self._factors, solution.weights, strict=True)
        rows = np.concatenate(
            [weight * factor.triangle[:, :-1] for factor, weight in weighted_factors]
        )
        hessian = rows.T @ rows + prior
        parts = partial(self._compute_parts, motions, solution, hessian)
        return covariance_of_parts(("",) * len(hessian), parts, hessian, prior_hessian=prior)

    def _compute_parts(
        self, motions: Callable[[], Iterable[Motion]], solution: Solution, hessian: Array
    ) -> Iterator[Gradients]:
        logs = list(self._logs)
        first_row = 0
        for motion in motions():
            for first in range(0, len(motion.t), identification.ROWS_AT_ONCE):
                chunk = motion.rows(slice(first, first + identification.ROWS_AT_ONCE))
                labels = (first_row + np.arange(len(chunk.t))) * BLOCKS // self.rows
                if len(logs) > 1:
                    labels = np.full(len(chunk.t), logs.index(motion.name))
                blocks = self._build_blocks([chunk])
                yield from least_squares.compute_gradients(blocks, solution, labels, hessian)
                first_row += len(chunk.t)


def identify_long(logs: Sequence[LongLog], robot: Robot) -> identification.RigidBody:
    """Identify as `identification.identify` by the stacked method, with bounded memory."""
    log_names = dict.fromkeys(log.checked_pieces[0].where for log in logs)
    travel: Array = np.array([log.travel for log in logs]).max(axis=0)
    pieces = []
    for log in logs:
        pieces += [piece.q for piece in log.checked_pieces]
    is_travelling = find_travelling(pieces, travel)
    require_travel(", ".join(log_names), travel, robot.description.joints, is_travelling)

    def motions() -> Iterator[Motion]:
        return chain.from_iterable(log.motions() for log in logs)

    min_speeds = None
    while True:
        problem = StreamedProblem(robot, min_speeds)
        for motion in motions():
            problem.add(motion)
        if problem.is_consistent:
            break
        min_speeds = problem.min_speeds
    body = problem.body(motions, "log " + ", ".join(log.checked_pieces[0].name for log in logs))
    return replace(body, sentence="Rigid body: free, as from all logs that are read in pieces.")
