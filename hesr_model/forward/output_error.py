"""Joint refinement of body and friction by output error.

The cost is the position error over short windows; the torque error determines the other directions
(DIDIM: Gautier, Janot and Vandanjon 2013, "A new closed-loop output error method for parameter
identification of robot dynamics", IEEE Trans. Control Syst. Technol. 21(2); here with friction that
has a state).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.forward.simulation import Simulator
from hesr_model.forward.windows import joined, windows_of
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

WINDOW = 0.5  # length of the windows [s]
MOST_TORQUE = 1.02  # largest allowed ratio of a joint's torque error to that before
_STEP = 1e-3  # finite-difference step, relative
_TORQUE = 0.5  # weight of the mean square torque error
_DAMPING = (1e-3, 1e-2, 1e-1, 1.0, 1e1)  # damping of each round, relative to the curvature
_MOST = 0.7  # largest change of a parameter, relative or logarithmic
_SPREAD = 0.15  # relative spread of further starts
_LEAST = 1e-3  # smallest relative gain of a round
_SHARES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)  # shares of the way to the optimum tried at the end


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """Refined body and friction, or the original ones with ratio 1 if nothing is better.

    `ratio` is the RMS ratio of the position errors to those before.
    """

    body: RigidBody
    friction: FrictionModel
    ratio: float


def refine(
    robot: Robot,
    body: RigidBody,
    friction: FrictionModel,
    motions: Sequence[Motion],
    *,
    rounds: int = 6,
    starts: int = 3,
    seed: int = 0,
) -> Refined:
    """Refine body and friction jointly by output error.

    The best of several random starts continues for `rounds` damped Gauss-Newton steps. Raises
    SimulationError if a log is too short.
    """
    problem = _Problem(robot, body, friction, motions)
    moved = np.random.default_rng(seed).normal(scale=_SPREAD, size=(starts - 1, problem.size))
    # Only friction varies: least squares determine the body much better.
    moved[:, : len(problem.columns)] = 0.0
    theta = np.vstack([np.zeros((1, problem.size)), moved])
    found = problem.costs(theta)
    best = theta[int(np.argmin(found))]
    cost = float(found.min())
    for _ in range(rounds):
        residuals, slopes = problem.linearised(best)
        gradient, curvature = slopes.T @ residuals, slopes.T @ slopes
        scale = np.diag(np.diag(curvature) + 1e-12 * np.trace(curvature))
        tried = np.array(
            [best - np.linalg.solve(curvature + d * scale, gradient) for d in _DAMPING]
        )
        tried = np.clip(tried, -_MOST, _MOST)
        found = problem.costs(tried)
        if not found.min() < (1.0 - _LEAST) * cost:
            break
        best, cost = tried[int(np.argmin(found))], float(found.min())
    return problem.accepted(best)


class _Problem:
    def __init__(
        self, robot: Robot, body: RigidBody, friction: FrictionModel, motions: Sequence[Motion]
    ) -> None:
        self._robot, self._body, self._friction, self._motions = robot, body, friction, motions
        self._logs = [motion_records(motion, robot, body) for motion in motions]
        self._windows = windows_of(self._logs, WINDOW)
        self.columns = [k for k in body.base if body.parameters[k] != 0.0]
        self._names = [
            (joint, number)
            for joint, law in enumerate(friction.laws)
            for number, value in enumerate(law.values.values())
            if value != 0.0
        ]
        self.size = len(self.columns) + len(self._names)
        self._loads = [
            robot.regressor(m.q, m.dq, m.ddq)[:, :, self.columns] * body.parameters[self.columns]
            for m in motions
        ]
        still = np.zeros(self.size)
        self._position_sizes = _sizes(self._position(still[None])[0].reshape(-1, robot.n))
        self._torque_sizes = _sizes(self._torque(still))

    def costs(self, theta: Array) -> Array:
        with np.errstate(all="ignore"):
            found = [np.sum(np.square(row)) for row in self._rows(theta)]
        return np.where(np.isfinite(found), found, np.inf)

    def linearised(self, theta: Array) -> tuple[Array, Array]:
        rows = np.array(self._rows(np.vstack([theta, theta + _STEP * np.eye(self.size)])))
        return rows[0], (rows[1:] - rows[0]).T / _STEP

    def accepted(self, theta: Array) -> Refined:
        """Return the largest change towards `theta` that no joint's torque error forbids."""
        for share in _SHARES:
            change = share * theta
            torque = _sizes(self._torque(change))
            position = _sizes(self._position(change[None])[0].reshape(-1, self._robot.n))
            ratio = float(np.sqrt(np.mean(np.square(position / self._position_sizes))))
            if np.all(torque <= MOST_TORQUE * self._torque_sizes) and ratio < 1.0:
                friction = replace(
                    self._moved(change), training_rmse=tuple(torque.tolist()), left_out_rmse=()
                )
                return Refined(body=self._moved_body(change), friction=friction, ratio=ratio)
        return Refined(body=self._body, friction=self._friction, ratio=1.0)

    def _rows(self, theta: Array) -> list[Array]:
        positions = zip(self._position(theta), theta, strict=True)
        return [self._residuals(position, change) for position, change in positions]

    def _residuals(self, position: Array, theta: Array) -> Array:
        scaled = (position / self._position_sizes).ravel()
        torque = (self._torque(theta) / self._torque_sizes).ravel()
        weight = np.sqrt(_TORQUE / torque.size)
        return np.concatenate([scaled / np.sqrt(scaled.size), weight * torque])

    def _position(self, theta: Array) -> Array:
        many, windows = len(theta), self._windows
        friction = [self._moved(change) for change in theta]
        count = len(windows.t)
        states = [windows.states(model) for model in friction]
        numbers = [[list(law.values.values()) for law in model.laws] for model in friction]
        bodies = np.array([self._moved_body(change).parameters for change in theta])
        simulator = Simulator(
            robot=self._robot, parameters=np.repeat(bodies, count, axis=0), friction=self._friction
        )
        found = simulator.run(
            joined([windows] * many),
            values=[
                np.repeat(np.array(of_law).T, count, axis=1)
                for of_law in zip(*numbers, strict=True)
            ],
            states=[np.concatenate(of_law, axis=1) for of_law in zip(*states, strict=True)],
        )
        return found.reshape(many, *windows.q.shape) - windows.q

    def _torque(self, theta: Array) -> Array:
        friction, found = self._moved(theta), []
        for log, loads in zip(self._logs, self._loads, strict=True):
            more = loads @ theta[: len(self.columns)]
            own = [replace(r, tau_load=r.tau_load + more[:, k]) for k, r in enumerate(log)]
            found.append(friction.predict(own) + more - np.column_stack([r.tau for r in log]))
        return np.concatenate(found)

    def _moved_body(self, theta: Array) -> RigidBody:
        parameters = self._body.parameters.copy()
        parameters[self.columns] *= 1.0 + theta[: len(self.columns)]
        return replace(self._body, parameters=parameters)

    def _moved(self, theta: Array) -> FrictionModel:
        values = [list(law.values.values()) for law in self._friction.laws]
        for (joint, number), change in zip(self._names, theta[len(self.columns) :], strict=True):
            values[joint][number] *= np.exp(change)  # keeps the sign
        laws = [
            replace(
                law,
                values=dict(zip(law.values, map(float, own), strict=True)),
                standard_errors={},  # these belong to another estimate
            )
            for law, own in zip(self._friction.laws, values, strict=True)
        ]
        return replace(self._friction, laws=tuple(laws))


def _sizes(errors: Array) -> Array:
    with np.errstate(all="ignore"):
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))
