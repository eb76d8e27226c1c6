"""Refinement of friction, or of body and friction, by output error over short windows.

The cost is the position error; the torque error determines the directions that hardly change it
(DIDIM: Gautier, Janot and Vandanjon 2013, IEEE Trans. Control Syst. Technol. 21(2); here with
friction that has a state).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.audit.certificate import has_proof
from hesr_model.forward import simulation
from hesr_model.forward.simulation import Simulator, Windows
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.stops.form import OLDEST
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, rms

SHORT_WINDOW = 0.5  # [s] windows
LONG_WINDOW = 2.0  # [s] further windows without gravity, and the blocks of left-out windows
MAX_TORQUE_RATIO = 1.02  # largest allowed ratio of a joint's torque error to that before
MAX_COEFFICIENTS = 64  # of laws that are refined
_DIFFERENCE_STEP = 1e-3  # relative
_TORQUE_WEIGHT = 0.5  # weight of the mean square torque error
_SINGLE_TORQUE_WEIGHT = 0.05  # of one joint: its noisy acceleration favours too small a mass
_DAMPING = (1e-3, 1e-2, 1e-1, 1.0, 1e1)  # damping of each round, relative to the curvature
_MAX_CHANGE = 0.7  # largest change of a parameter, relative or logarithmic
_START_SPREAD = 0.15  # relative spread of further starts
_MIN_GAIN = 1e-3  # smallest relative gain of a round
# Shares of the way to the optimum, tried at the end.
_STEP_SHARES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinementResult:
    """Refined body and friction, or the original ones, ratio 1, if left-out windows are worse."""

    body: RigidBody
    model: FrictionModel
    ratio: float  # RMS of the position errors over those before
    before: Array  # position errors on left-out windows, by length and joint [rad; m]
    left_out: Array  # those with the refined friction

    @property
    def size(self) -> float:
        """Geometric mean of the errors on left-out windows; infinite without windows."""
        with np.errstate(all="ignore"):
            mean_error = float(np.exp(np.mean(np.log(self.left_out))))
        return mean_error if np.isfinite(mean_error) else np.inf


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
) -> RefinementResult:
    """Refine friction, and the body unless it is fixed, by output error.

    The best of several random starts continues for `rounds` damped Gauss-Newton steps. Every other
    block of `LONG_WINDOW` is left out in turn; the result counts if these improve. Without gravity,
    whole logs in open loop must not become worse. Laws proven passive remain so. Raises
    SimulationError if a log is too short.
    """
    records = [motion_records(motion, robot, body) for motion in motions]
    window_sets = [simulation.cut_windows(records, SHORT_WINDOW)]
    is_weightless = simulation.is_weightless(records, robot, body)
    longest_duration = max(
        float(joint_records[0].t[-1] - joint_records[0].t[0]) for joint_records in records
    )
    if is_weightless and longest_duration >= simulation.RUN_IN + 4.0 * LONG_WINDOW:
        window_sets.append(simulation.cut_windows(records, LONG_WINDOW))
    problem = _Problem(robot, body, model, motions, records, window_sets, with_body=with_body)
    before, after = problem.cross_validate(rounds, starts, seed)
    if not rms(after / before, axis=None) < 1.0:
        return RefinementResult(body=body, model=model, ratio=1.0, before=before, left_out=before)
    if is_weightless:
        problem.whole_logs = list(map(simulation.to_single_window, records))
    return problem.build_refinement(problem.find_best_change(rounds, starts, seed), before, after)


class _Problem:
    def __init__(
        self,
        robot: Robot,
        body: RigidBody,
        model: FrictionModel,
        motions: Sequence[Motion],
        records: simulation.PartRecords,
        window_sets: Sequence[Windows],
        *,
        with_body: bool,
    ) -> None:
        self._robot = robot
        self._body = body
        self._model = model
        self._records = records
        self.window_sets = window_sets
        self.whole_logs: list[Windows] = []  # logs whose open loop must not become worse
        self._proven = [has_proof(law) for law in model.laws]
        self.columns = [k for k in body.base if with_body and body.parameters[k] != 0.0]
        self._coefficients = _list_coefficients(model)
        self.size = len(self.columns) + len(self._coefficients)
        self._loads = []  # torque [N.m] of each body parameter, (N, n, columns) by log
        for motion in motions:
            regressor = robot.regressor(motion.q, motion.dq, motion.ddq)
            self._loads.append(regressor[:, :, self.columns] * body.parameters[self.columns])
        no_change = np.zeros(self.size)
        self.position_sizes = self.measure_position_sizes(no_change)
        self._torque_sizes = rms(self._torque_errors(no_change))

    def select_blocks(self, k: int) -> "_Problem":
        """Return the problem with the windows of every other block of time."""
        half = copy(self)
        half.window_sets = [
            windows.select(windows.blocks(LONG_WINDOW) % 2 == k) for windows in self.window_sets
        ]
        half.position_sizes = half.measure_position_sizes(np.zeros(self.size))
        return half

    def cross_validate(self, rounds: int, starts: int, seed: int) -> tuple[Array, Array]:
        """Return the position errors on left-out windows, before and after, by length and joint.

        Each half of the windows is left out in turn; without windows of each length in both, the
        errors are NaN.
        """
        halves = [self.select_blocks(k) for k in range(2)]
        for half in halves:
            if not all(len(windows.t) for windows in half.window_sets):
                unknown = np.full((len(self.window_sets), self._robot.n), np.nan)
                return unknown, unknown
        changes = [half.find_best_change(rounds, starts, seed) for half in halves]
        before = rms(np.array([half.position_sizes for half in halves]))
        left_out_sizes = []
        for half, change in zip(halves, reversed(changes), strict=True):
            left_out_sizes.append(half.measure_position_sizes(change))
        return before, rms(np.array(left_out_sizes))

    def find_best_change(self, rounds: int, starts: int, seed: int) -> Array:
        """Return the best change that is allowed."""
        random_changes = np.random.default_rng(seed).normal(
            scale=_START_SPREAD, size=(starts - 1, self.size)
        )
        # Only friction varies: least squares determine the body much better.
        random_changes[:, : len(self.columns)] = 0.0
        changes = np.vstack([np.zeros((1, self.size)), random_changes])
        trial_costs = self.compute_costs(changes)
        best_change = changes[int(np.argmin(trial_costs))]
        cost = float(trial_costs.min())
        for _ in range(rounds):
            residuals, slopes = self.linearise(best_change)
            gradient = slopes.T @ residuals
            curvature = slopes.T @ slopes
            scale = np.diag(np.diag(curvature) + 1e-12 * np.trace(curvature))
            steps = [np.linalg.solve(curvature + damping * scale, gradient) for damping in _DAMPING]
            trials = np.clip(best_change - np.array(steps), -_MAX_CHANGE, _MAX_CHANGE)
            trial_costs = self.compute_costs(trials)
            if not trial_costs.min() < (1.0 - _MIN_GAIN) * cost:
                break
            best_change = trials[int(np.argmin(trial_costs))]
            cost = float(trial_costs.min())
        return self._limit_change(best_change)

    def compute_costs(self, changes: Array) -> Array:
        with np.errstate(all="ignore"):
            square_sums = [np.sum(np.square(row)) for row in self._residual_rows(changes)]
        return np.where(np.isfinite(square_sums), square_sums, np.inf)

    def linearise(self, change: Array) -> tuple[Array, Array]:
        neighbours = change + _DIFFERENCE_STEP * np.eye(self.size)
        rows = np.array(self._residual_rows(np.vstack([change, neighbours])))
        return rows[0], (rows[1:] - rows[0]).T / _DIFFERENCE_STEP

    def _limit_change(self, optimum: Array) -> Array:
        """Return the largest change that keeps torque errors, and the proof of each moved joint."""
        no_change = np.zeros_like(optimum)
        open_loop = self._measure_open_loop(no_change)
        for share in _STEP_SHARES:
            change = share * optimum
            unproven_joints = self._find_unproven_joints(change)
            is_unproven = [j in unproven_joints for j, _ in self._coefficients]
            change[len(self.columns) :][is_unproven] = 0.0
            ratio = rms(self.measure_position_sizes(change) / self.position_sizes, axis=None)
            is_accurate = rms(self._torque_errors(change)) <= MAX_TORQUE_RATIO * self._torque_sizes
            if np.all(is_accurate) and ratio < 1.0 and self._measure_open_loop(change) <= open_loop:
                return change
        return no_change

    def _find_unproven_joints(self, change: Array) -> set[int]:
        """Return the joints whose laws lose the proof of passivity by a change."""
        joints = set()
        for j, law in enumerate(self._change_friction(change).laws):
            if self._proven[j] and not has_proof(law):
                joints.add(j)
        return joints

    def _measure_open_loop(self, change: Array) -> float:
        """Return the RMS position error over whole logs, relative to that over windows."""
        if not self.whole_logs:
            return 0.0
        body = self._change_body(change)
        model = self._change_friction(change)
        simulator = Simulator(robot=self._robot, parameters=body.parameters, model=model)
        errors = [
            (simulator.run(windows) - windows.q) / self.position_sizes[0]
            for windows in self.whole_logs
        ]
        error = float(rms(np.concatenate(errors, axis=1), axis=None))
        return error if np.isfinite(error) else np.inf

    def build_refinement(self, change: Array, before: Array, left_out: Array) -> RefinementResult:
        """Return body and friction after a change."""
        torque_rmse = rms(self._torque_errors(change))
        left_out_rmse = self._model.left_out_rmse
        if left_out_rmse:
            # They grow as the errors on the training logs do.
            left_out_rmse = tuple((left_out_rmse * torque_rmse / self._torque_sizes).tolist())
        model = replace(
            self._change_friction(change),
            training_rmse=tuple(torque_rmse.tolist()),
            left_out_rmse=left_out_rmse,
        )
        return RefinementResult(
            body=self._change_body(change),
            model=model,
            ratio=float(rms(self.measure_position_sizes(change) / self.position_sizes, axis=None)),
            before=before,
            left_out=left_out,
        )

    def measure_position_sizes(self, change: Array) -> Array:
        """Return the RMS position errors by length and joint [rad; m]."""
        return np.array(
            [rms(errors[0], axis=(0, 1)) for errors in self._position_errors(change[None])]
        )

    def _residual_rows(self, changes: Array) -> list[Array]:
        position_errors = zip(*self._position_errors(changes), strict=True)  # by change
        return list(map(self._residuals, position_errors, changes))

    def _residuals(self, position_errors: Sequence[Array], change: Array) -> Array:
        scaled = []
        for errors, joint_sizes in zip(position_errors, self.position_sizes, strict=True):
            # Each length of windows has the same weight.
            root_count = np.sqrt(errors.size * len(position_errors))
            scaled.append((errors / joint_sizes).ravel() / root_count)
        torque_errors = (self._torque_errors(change) / self._torque_sizes).ravel()
        weight = _TORQUE_WEIGHT if self._robot.n > 1 else _SINGLE_TORQUE_WEIGHT
        return np.concatenate([*scaled, np.sqrt(weight / torque_errors.size) * torque_errors])

    def _position_errors(self, changes: Array) -> list[Array]:
        """Return the position errors (M, W, K + 1, n) of (M, P) changes by length."""
        models = [self._change_friction(change) for change in changes]
        bodies = np.array([self._change_body(change).parameters for change in changes])
        errors = []
        for windows in self.window_sets:
            window_count = len(windows.t)
            law_values = []
            for j in range(len(self._model.laws)):
                coefficients = [list(model.laws[j].values.values()) for model in models]
                law_values.append(np.repeat(np.array(coefficients).T, window_count, axis=1))
            model_states = [windows.compute_states(model) for model in models]
            law_states = [np.concatenate(x, axis=1) for x in zip(*model_states, strict=True)]
            simulator = Simulator(
                robot=self._robot,
                parameters=np.repeat(bodies, window_count, axis=0),
                model=self._model,
            )
            simulated = simulator.run(
                simulation.join_windows([windows] * len(changes)),
                values=law_values,
                states=law_states,
            )
            errors.append(simulated.reshape(len(changes), *windows.q.shape) - windows.q)
        return errors

    def _torque_errors(self, change: Array) -> Array:
        model = self._change_friction(change)
        errors = []
        for log_records, loads in zip(self._records, self._loads, strict=True):
            tau_change = loads @ change[: len(self.columns)]
            changed_records = []
            for j, record in enumerate(log_records):
                changed_load = record.tau_load + tau_change[:, j]
                changed_records.append(replace(record, tau_load=changed_load))
            tau = np.column_stack([record.tau for record in log_records])
            errors.append(model.predict(changed_records) + tau_change - tau)
        return np.concatenate(errors)

    def _change_body(self, change: Array) -> RigidBody:
        parameters = self._body.parameters.copy()
        parameters[self.columns] *= 1.0 + change[: len(self.columns)]
        return replace(self._body, parameters=parameters)

    def _change_friction(self, change: Array) -> FrictionModel:
        values = [dict(law.values) for law in self._model.laws]
        coefficient_changes = change[len(self.columns) :]
        for (j, name), coefficient_change in zip(
            self._coefficients, coefficient_changes, strict=True
        ):
            values[j][name] *= float(np.exp(coefficient_change))  # keeps the sign
        laws = []
        for law, law_values in zip(self._model.laws, values, strict=True):
            # Standard errors belong to another estimate.
            laws.append(replace(law, values=law_values, standard_errors={}, covariance=None))
        return replace(self._model, laws=tuple(laws))


def _list_coefficients(model: FrictionModel) -> list[tuple[int, str]]:
    """Return joint and name of each coefficient that may change."""
    coefficients = []
    for j, law in enumerate(model.laws):
        if len(law.values) > MAX_COEFFICIENTS:  # of networks
            continue
        for name, value in law.values.items():
            # 0 has no logarithm, and P is a limit of the training.
            if value != 0.0 and name != OLDEST.name:
                coefficients.append((j, name))
    return coefficients
