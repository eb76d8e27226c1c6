"""Error of a rigid body at joint positions that the logs did not visit.

Rows of the same motion cannot show it: where a log repeats one ellipse, or moves two joints as one,
masses and friction stand for each other, and a body that predicts all of its rows may be wrong
elsewhere. Two figures are estimated at random positions, with speeds and accelerations of the logs:

- the standard error of the torque, from the covariance of the parameters;
- the error over that of the model file. A body corrects the torque of the model file. A joint whose
  correction lowers the error on left-out rows by its own size is trusted elsewhere; one whose
  correction lowers nothing counts as an error elsewhere.

On 40 draws of a twin with wrong masses these tell the three bodies that are two to three times
worse than the model file on other motions from all others (`tests/benchmarks/test_body_draws.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import transform_motion
from hesr_model.support.arrays import Array

_STATE_COUNT = 400


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """Rows of logs, and the same speeds and accelerations at random positions, (N, n) each."""

    visited_q: Array
    random_q: Array
    dq: Array
    ddq: Array

    @classmethod
    def from_motions(cls, motions: Sequence[Motion], robot: Robot) -> "States":
        """Return rows spread evenly over all motions, and random positions within the reach."""
        q = np.concatenate([motion.q for motion in motions])
        dq = np.concatenate([motion.dq for motion in motions])
        ddq = np.concatenate([motion.ddq for motion in motions])
        rows = np.unique(np.linspace(0, len(q) - 1, _STATE_COUNT).astype(int))
        lower, upper, _ = robot.reach
        random_q = np.random.default_rng(0).uniform(lower, upper, (len(rows), robot.n))
        return cls(visited_q=q[rows], random_q=random_q, dq=dq[rows], ddq=ddq[rows])


def compute_standard_errors(bodies: Sequence[RigidBody], robot: Robot, states: States) -> Array:
    """Return the standard errors (n,) [N.m] of the torque at random positions.

    They are RMS values over the states, at friction coordinates.

    Parameters
    ----------
    bodies : identified without one fold each; the median of their errors counts. Joints of bodies
        whose covariance is unknown have no error.
    """
    regressor = robot.regressor(states.random_q, states.dq, states.ddq)
    if robot.description.coupling is not None:
        regressor = robot.description.coupling.torque(regressor)
    errors = []
    for body in bodies:
        if body.covariance is None:
            errors.append(np.zeros(robot.n))
            continue
        columns = regressor[:, :, list(body.base)]
        variance = np.sum((columns @ body.covariance.matrix) * columns, axis=2)
        errors.append(np.sqrt(np.mean(np.maximum(variance, 0.0), axis=0)))
    return np.asarray(np.median(errors, axis=0))


def estimate_ratios(
    bodies: Sequence[RigidBody],
    given_bodies: Sequence[RigidBody],
    rmse: Array,
    given_rmse: Array,
    robot: Robot,
    states: States,
) -> Array:
    """Return the error of a body at random positions over that of the model file, (n,).

    Parameters
    ----------
    bodies : identified without one fold each.
    given_bodies : with the masses of the model file, without the same folds.
    rmse, given_rmse : of both on left-out rows, (n,) [N.m] at friction coordinates.
    """
    visited_squares = []
    other_squares = []
    for body, given_body in zip(bodies, given_bodies, strict=True):
        at_visited, at_others = _compute_correction(body, given_body, robot, states)
        visited_squares.append(at_visited)
        other_squares.append(at_others)
    visited = np.mean(visited_squares, axis=0)
    elsewhere = np.mean(other_squares, axis=0)
    gain = given_rmse**2 - rmse**2
    paid_share = np.clip(gain / np.maximum(visited, np.finfo(float).tiny), 0.0, 1.0)
    unpaid = (1.0 - paid_share) * elsewhere
    further = paid_share * np.maximum(elsewhere - visited, 0.0)
    return np.asarray(np.sqrt((rmse**2 + unpaid) / (given_rmse**2 + further)))


def _compute_correction(
    body: RigidBody, given_body: RigidBody, robot: Robot, states: States
) -> tuple[Array, Array]:
    """Return the mean squares (n,) of a correction, at visited and at random positions.

    What Coulomb, viscous and offset friction absorb of it on the visited rows is no correction.
    """
    coupling = robot.description.coupling
    differences = []
    for q in (states.visited_q, states.random_q):
        torque = robot.torque(body.parameters_for(robot), q, states.dq, states.ddq)
        given_torque = robot.torque(given_body.parameters_for(robot), q, states.dq, states.ddq)
        difference = torque - given_torque
        if coupling is not None:
            difference = coupling.torque(difference)
        differences.append(difference)
    visited, elsewhere = differences
    dq = transform_motion(coupling, states.dq)
    for j in range(robot.n):
        columns = np.column_stack([np.sign(dq[:, j]), dq[:, j], np.ones(len(dq))])
        friction = columns @ np.linalg.lstsq(columns, visited[:, j], rcond=None)[0]
        visited[:, j] -= friction
        elsewhere[:, j] -= friction
    return np.mean(visited**2, axis=0), np.mean(elsewhere**2, axis=0)
