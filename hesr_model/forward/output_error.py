"""Refinement of friction, or of body and friction, by output error over short windows.

The cost is the position error; the torque error determines the directions that hardly change it
(DIDIM: Gautier, Janot and Vandanjon 2013, IEEE Trans. Control Syst. Technol. 21(2); here with
friction that has a state).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.audit.certificate import proven
from hesr_model.forward import simulation
from hesr_model.forward.simulation import Simulator, Windows
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.stops.form import OLDEST
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, rms

LENGTH = 0.5  # [s] windows
LONG = 2.0  # [s] further windows without gravity, and the blocks of left-out windows
MOST_TORQUE = 1.02  # largest allowed ratio of a joint's torque error to that before
MOST_COEFFICIENTS = 64  # of laws that are refined
_STEP = 1e-3  # finite-difference step, relative
_TORQUE = 0.5  # weight of the mean square torque error
_TORQUE_OF_ONE = 0.05  # of one joint: its noisy acceleration favours too small a mass
_DAMPING = (1e-3, 1e-2, 1e-1, 1.0, 1e1)  # damping of each round, relative to the curvature
_MOST = 0.7  # largest change of a parameter, relative or logarithmic
_SPREAD = 0.15  # relative spread of further starts
_LEAST = 1e-3  # smallest relative gain of a round
_SHARES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)  # shares of the way to the optimum tried at the end


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """Refined body and friction, or the original ones, ratio 1, if left-out windows are worse."""

    body: RigidBody
    friction: FrictionModel
    ratio: float  # RMS of the position errors over those before
    before: Array  # position errors on left-out windows, by length and joint [rad; m]
    left_out: Array  # those with the refined friction

    @property
    def size(self) -> float:
        """Geometric mean of the errors on left-out windows; infinite without windows."""
        with np.errstate(all="ignore"):
            found = float(np.exp(np.mean(np.log(self.left_out))))
        return found if np.isfinite(found) else np.inf


def refine(
    robot: Robot,
    body: RigidBody,
    model: FrictionModel,
    motions: Sequence[Motion],
    *,
    with_body: bool = True,
    rounds: int = 6,
    starts: int = 3,
    seed: int = 0,
) -> Refined:
    """Refine friction, and the body unless it is fixed, by output error.

    The best of several random starts continues for `rounds` damped Gauss-Newton steps. Every other
    block of `LONG` is left out in turn; the result counts if these improve. Without gravity, whole
    logs in open loop must not become worse. Laws proven passive remain so. Raises SimulationError
    if a log is too short.
    """
    records = [motion_records(motion, robot, body) for motion in motions]
    sets = [simulation.windows_of(records, LENGTH)]
    longest = max(
        float(joint_records[0].t[-1] - joint_records[0].t[0]) for joint_records in records
    )
    free = simulation.weightless(records, robot, body)
    if free and longest >= simulation.RUN_IN + 4.0 * LONG:
        sets.append(simulation.windows_of(records, LONG))
    problem = _Problem(robot, body, model, motions, records, sets, with_body=with_body)
    halves = [problem.of_blocks(k) for k in range(2)]
    before = after = np.full((len(sets), robot.n), np.nan)
    if all(len(windows.t) for half in halves for windows in half.sets):
        changes = [half.solved(rounds, starts, seed) for half in halves]
        before = rms(np.array([half.position_sizes for half in halves]))
        pairs = zip(halves, reversed(changes), strict=True)
        after = rms(np.array([half.sizes(change) for half, change in pairs]))
    if not rms(after / before, axis=None) < 1.0:
        return Refined(body=body, friction=model, ratio=1.0, before=before, left_out=before)
    problem.whole = [simulation.whole(joint_records) for joint_records in records] if free else []
    return problem.refined(problem.solved(rounds, starts, seed), before, after)


class _Problem:
    def __init__(
        self,
        robot: Robot,
        body: RigidBody,
        friction: FrictionModel,
        motions: Sequence[Motion],
        logs: simulation.Logs,
        sets: Sequence[Windows],
        *,
        with_body: bool,
    ) -> None:
        self._robot = robot
        self._body = body
        self._friction = friction
        self._logs = logs
        self.sets = sets
        self.whole: list[Windows] = []  # logs whose open loop must not become worse
        self._proven = [proven(law) for law in friction.laws]
        self.columns = [k for k in body.base if with_body and body.parameters[k] != 0.0]
        self._names = [
            (joint, number)
            for joint, law in enumerate(friction.laws)
            for number, (name, value) in enumerate(law.values.items())
            # P is a limit of the training, and networks have too many coefficients.
            if value != 0.0 and name != OLDEST.name and len(law.values) <= MOST_COEFFICIENTS
        ]
        self.size = len(self.columns) + len(self._names)
        self._loads = [
            robot.regressor(motion.q, motion.dq, motion.ddq)[:, :, self.columns]
            * body.parameters[self.columns]
            for motion in motions
        ]
        still = np.zeros(self.size)
        self.position_sizes = self.sizes(still)
        self._torque_sizes = rms(self._torque(still))

    def of_blocks(self, k: int) -> "_Problem":
        """Return the problem with the windows of every other block of time."""
        half = copy(self)
        half.sets = [w.some(w.blocks(LONG) % 2 == k) for w in self.sets]
        half.position_sizes = half.sizes(np.zeros(self.size))
        return half

    def solved(self, rounds: int, starts: int, seed: int) -> Array:
        """Return the best change that is allowed."""
        moved = np.random.default_rng(seed).normal(scale=_SPREAD, size=(starts - 1, self.size))
        # Only friction varies: least squares determine the body much better.
        moved[:, : len(self.columns)] = 0.0
        theta = np.vstack([np.zeros((1, self.size)), moved])
        found = self.costs(theta)
        best = theta[int(np.argmin(found))]
        cost = float(found.min())
        for _ in range(rounds):
            residuals, slopes = self.linearise(best)
            gradient = slopes.T @ residuals
            curvature = slopes.T @ slopes
            scale = np.diag(np.diag(curvature) + 1e-12 * np.trace(curvature))
            steps = [np.linalg.solve(curvature + d * scale, gradient) for d in _DAMPING]
            tried = np.clip(best - np.array(steps), -_MOST, _MOST)
            found = self.costs(tried)
            if not found.min() < (1.0 - _LEAST) * cost:
                break
            best = tried[int(np.argmin(found))]
            cost = float(found.min())
        return self._allowed(best)

    def costs(self, theta: Array) -> Array:
        with np.errstate(all="ignore"):
            found = [np.sum(np.square(row)) for row in self._rows(theta)]
        return np.where(np.isfinite(found), found, np.inf)

    def linearise(self, theta: Array) -> tuple[Array, Array]:
        rows = np.array(self._rows(np.vstack([theta, theta + _STEP * np.eye(self.size)])))
        return rows[0], (rows[1:] - rows[0]).T / _STEP

    def _allowed(self, theta: Array) -> Array:
        """Return the largest change that keeps torque errors, and the proof of each moved joint."""
        still = np.zeros_like(theta)
        open_loop = self._open_loop(still)
        for share in _SHARES:
            change = share * theta
            laws = self._moved(change).laws
            lost = {j for j, was in enumerate(self._proven) if was and not proven(laws[j])}
            of_joints = [joint for joint, _ in self._names]
            change[len(self.columns) :][[joint in lost for joint in of_joints]] = 0.0
            ratio = rms(self.sizes(change) / self.position_sizes, axis=None)
            enough = rms(self._torque(change)) <= MOST_TORQUE * self._torque_sizes
            if np.all(enough) and ratio < 1.0 and self._open_loop(change) <= open_loop:
                return change
        return still

    def _open_loop(self, change: Array) -> float:
        """Return the RMS position error over whole logs, relative to that over windows."""
        body = self._moved_body(change)
        model = self._moved(change)
        one = Simulator(robot=self._robot, parameters=body.parameters, friction=model)
        errors = [(one.run(w) - w.q) / self.position_sizes[0] for w in self.whole]
        found = float(rms(np.concatenate(errors, axis=1), axis=None)) if errors else 0.0
        return found if np.isfinite(found) else np.inf

    def refined(self, change: Array, before: Array, left_out: Array) -> Refined:
        """Return body and friction after a change."""
        torque = rms(self._torque(change))
        known = self._friction.left_out_rmse or ()
        model = replace(
            self._moved(change),
            training_rmse=tuple(torque.tolist()),
            left_out_rmse=tuple((known * torque / self._torque_sizes).tolist()) if known else (),
        )
        return Refined(
            body=self._moved_body(change),
            friction=model,
            ratio=float(rms(self.sizes(change) / self.position_sizes, axis=None)),
            before=before,
            left_out=left_out,
        )

    def sizes(self, change: Array) -> Array:
        """Return the RMS position errors by length and joint [rad; m]."""
        return np.array([rms(part[0], axis=(0, 1)) for part in self._position(change[None])])

    def _rows(self, theta: Array) -> list[Array]:
        positions = zip(*self._position(theta), strict=True)
        return [self._residuals(own, change) for own, change in zip(positions, theta, strict=True)]

    def _residuals(self, positions: Sequence[Array], theta: Array) -> Array:
        scaled = [
            (part / sizes).ravel() / np.sqrt(part.size * len(positions))
            for part, sizes in zip(positions, self.position_sizes, strict=True)
        ]
        torque = (self._torque(theta) / self._torque_sizes).ravel()
        weight = _TORQUE if self._robot.n > 1 else _TORQUE_OF_ONE
        return np.concatenate([*scaled, np.sqrt(weight / torque.size) * torque])

    def _position(self, theta: Array) -> list[Array]:
        """Return the position errors (M, W, K + 1, n) of (M, P) changes by length."""
        friction = [self._moved(change) for change in theta]
        numbers = [[list(law.values.values()) for law in model.laws] for model in friction]
        bodies = np.array([self._moved_body(change).parameters for change in theta])
        errors = []
        for windows in self.sets:
            count = len(windows.t)
            states = [windows.states(model) for model in friction]
            simulator = Simulator(
                robot=self._robot,
                parameters=np.repeat(bodies, count, axis=0),
                friction=self._friction,
            )
            found = simulator.run(
                simulation.joined([windows] * len(theta)),
                values=[
                    np.repeat(np.array(of_law).T, count, axis=1)
                    for of_law in zip(*numbers, strict=True)
                ],
                states=[np.concatenate(of_law, axis=1) for of_law in zip(*states, strict=True)],
            )
            errors.append(found.reshape(len(theta), *windows.q.shape) - windows.q)
        return errors

    def _torque(self, theta: Array) -> Array:
        model = self._moved(theta)
        found = []
        for log, loads in zip(self._logs, self._loads, strict=True):
            more = loads @ theta[: len(self.columns)]
            joint_records = [
                replace(record, tau_load=record.tau_load + more[:, k])
                for k, record in enumerate(log)
            ]
            found.append(
                model.predict(joint_records)
                + more
                - np.column_stack([record.tau for record in log])
            )
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
                covariance=None,
            )
            for law, own in zip(self._friction.laws, values, strict=True)
        ]
        return replace(self._friction, laws=tuple(laws))
