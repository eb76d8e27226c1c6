"""Simulation of an identified body with friction under measured torque.

    M(q) ddq + c(q, dq) + g(q) + tau_f = tau

Presliding friction is too stiff for a log's sample rate, so it is implicit in each inner step, as
in a drive: with A = M^-1 the velocity v+ after a step h solves

    v+ + h A tau_f(v+) = v + h A (tau - c - g),  q+ = q + h v+.

M, c and g are those in the middle of a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np

from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import LawStepper, compute_states
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import transform_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Mask

RUN_IN = 1.0  # run-in of friction states before a log's first window [s]
_MAX_GRAVITY_SHARE = 1e-9  # threshold of gravity over the largest torque
_BLOCK_ROUND_OFF = 0.01  # of times, in blocks
_SIGNALS = ("t", "q", "dq", "tau")
PartRecords = Sequence[Sequence[FrictionRecord]]  # records [part][joint] of all logs


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """W windows of K steps: `t` (W, K + 1) [s]; `q`, `dq`, `tau` (W, K + 1, n), measured."""

    t: Array
    q: Array
    dq: Array
    tau: Array
    places: tuple[tuple[int, int], ...]  # part of a log and first row of each window
    records: PartRecords = field(repr=False)

    def blocks(self, length: float) -> Array:
        """Return the number of each window's block of a length [s] after the run-in, (W,)."""
        starts = np.array([self.records[part][0].t[0] + RUN_IN for part, _ in self.places])
        part_numbers = np.array([part for part, _ in self.places])
        return np.asarray(
            part_numbers + np.floor((self.t[:, 0] - starts) / length + _BLOCK_ROUND_OFF)
        )

    def select(self, is_selected: Mask) -> "Windows":
        """Return some of the windows, in the same order."""
        signals = {name: getattr(self, name)[is_selected] for name in _SIGNALS}
        return replace(self, **signals, places=tuple(compress(self.places, is_selected)))

    def compute_states(self, model: FrictionModel, *, delay: int = 0) -> list[Array]:
        """Return each law's states (m, W), run in along the logs, `delay` rows before windows."""
        law_states: list[list[Array]] = [[] for _ in model.laws]
        for part, joint_records in enumerate(self.records):
            rows = [max(row - delay, 0) for window_part, row in self.places if window_part == part]
            transformed_records = transform_records(joint_records)
            for law, record, states in zip(
                model.laws, transformed_records, law_states, strict=True
            ):
                states.append(compute_states(law, **record.motion)[:, rows])
        return [np.concatenate(states, axis=1) for states in law_states]


def cut_windows(records: PartRecords, length: float) -> Windows:
    """Cut logs into windows of a length [s] after a run-in; raise SimulationError if none fits."""
    times = [joint_records[0].t for joint_records in records]
    period = float(np.median(np.concatenate([np.diff(t) for t in times])))
    steps = max(1, round(length / period))
    places = []
    for part, t in enumerate(times):
        first_row = int(np.searchsorted(t, t[0] + RUN_IN))
        places += [(part, row) for row in range(first_row, len(t) - steps, steps)]
    if not places:
        names = ", ".join(dict.fromkeys(joint_records[0].log for joint_records in records))
        raise SimulationError(
            f"log {names}: too short for a window of {length:g} s after a run-in of {RUN_IN:g} s."
        )
    return _cut(records, places, steps)


def join_windows(window_sets: Sequence[Windows]) -> Windows:
    """Join sets of windows with equal numbers of steps."""
    places: list[tuple[int, int]] = []
    records: list[Sequence[FrictionRecord]] = []
    for windows in window_sets:
        first_part = len(records)
        places += [(first_part + part, row) for part, row in windows.places]
        records += windows.records
    return Windows(
        t=np.concatenate([windows.t for windows in window_sets]),
        q=np.concatenate([windows.q for windows in window_sets]),
        dq=np.concatenate([windows.dq for windows in window_sets]),
        tau=np.concatenate([windows.tau for windows in window_sets]),
        places=tuple(places),
        records=records,
    )


def to_single_window(joint_records: Sequence[FrictionRecord]) -> Windows:
    """Return a log, [joint], as one window without run-in."""
    return _cut([joint_records], [(0, 0)], len(joint_records[0].t) - 1)


def _cut(records: PartRecords, places: Sequence[tuple[int, int]], steps: int) -> Windows:
    if records[0][0].tau_body is not None:
        raise SimulationError(
            f"log '{records[0][0].log}': the load of its friction is a pressure, which a "
            "simulation of motion does not know."
        )
    windows: dict[str, list[Array]] = {name: [] for name in _SIGNALS}
    signals = [_stack_signals(joint_records) for joint_records in records]
    for part, row in places:
        for name, values in signals[part].items():
            windows[name].append(values[row : row + steps + 1])
    arrays = {name: np.stack(parts) for name, parts in windows.items()}
    return Windows(**arrays, places=tuple(places), records=records)


def _stack_signals(joint_records: Sequence[FrictionRecord]) -> dict[str, Array]:
    """Return time (N,) [s], motion and measured torque (N, n) of a part of a log, [joint]."""
    return {
        "t": joint_records[0].t,
        "q": np.column_stack([record.q for record in joint_records]),
        "dq": np.column_stack([record.dq for record in joint_records]),
        "tau": np.column_stack([record.measured for record in joint_records]),
    }


def is_weightless(records: PartRecords, robot: Robot, body: RigidBody) -> bool:
    """Return whether gravity acts on no joint; otherwise whole logs diverge with any friction."""
    signals = [_stack_signals(joint_records) for joint_records in records]
    q = np.concatenate([part_signals["q"] for part_signals in signals])
    weight = robot.torque(body.parameters, q, np.zeros_like(q), np.zeros_like(q))
    largest_torque = max(np.abs(part_signals["tau"]).max() for part_signals in signals)
    return bool(np.abs(weight).max() <= _MAX_GRAVITY_SHARE * largest_torque)


MAX_SUBSTEP = 2.5e-3  # longest inner step [s]
_JOINT_SWEEPS = 2  # sweeps over joints, coupled by the mass matrix
_ROOT_ITERATIONS = 12  # iterations of a root
_TEST_OFFSETS = (0.0, 1.0, 2.5)  # [rad; m] no sine or spring is equal at all three
_WEIGHT_TOLERANCE = 1e-12  # spread of a constant weight over the mass
_STEP_ROUND_OFF = 1e-6  # round-off of time differences, in inner steps
_SPEED_PRECISION = 1e-10  # precision of a velocity [rad/s]


def count_inner_steps(dt: Array) -> int:
    """Return the number of inner steps for steps `dt` [s]."""
    return int(np.ceil(dt.max() / MAX_SUBSTEP - _STEP_ROUND_OFF))


@dataclass(eq=False)
class _MotionState:
    """Laws with their states `x` (m, W) each, and positions and velocities (W, n)."""

    laws: Sequence[LawStepper]
    x: list[Array]
    q: Array
    v: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulator:
    """Rigid body of a robot and its friction."""

    robot: Robot
    parameters: Array  # standard ones (P,), or (W, P) for each window
    model: FrictionModel
    as_plant: bool = False  # step explicitly, as MuJoCo does, for logs of the twin

    def run(
        self,
        windows: Windows,
        *,
        values: Sequence[Array] | None = None,
        states: Sequence[Array] | None = None,
    ) -> Array:
        """Return the positions over windows, (W, K + 1, n) [rad; m].

        `values` (C, W) are coefficients of each law, by default its own; `states` (m, W) its
        initial states, by default run in along the logs. Raises SimulationError if the mass matrix
        is not positive definite.
        """
        if states is None:
            # MuJoCo uses the rates before a step: its states lag by one row.
            states = windows.compute_states(self.model, delay=int(self.as_plant))
        if values is None:
            steppers = [LawStepper(law) for law in self.model.laws]
        else:
            steppers = [
                LawStepper(law, law_values)
                for law, law_values in zip(self.model.laws, values, strict=True)
            ]
        motion = _MotionState(
            laws=steppers,
            x=[law_states.copy() for law_states in states],
            q=windows.q[:, 0].copy(),
            v=windows.dq[:, 0].copy(),
        )
        positions = np.empty_like(windows.q)
        positions[:, 0] = motion.q
        constant_body = None
        if self._is_constant(motion.q):
            constant_body = self._evaluate_body(motion.q, motion.v)
        steps = np.diff(windows.t, axis=1)
        with np.errstate(all="ignore"):  # divergence shows in the result
            for k, dt in enumerate(steps.T):
                inverse, bias = constant_body or self._evaluate_step(motion, dt)
                tau = windows.tau[:, k]
                if self.as_plant:
                    self._step_explicitly(motion, dt, tau - bias, inverse, bias)
                else:
                    tau = 0.5 * (tau + windows.tau[:, k + 1])
                    substeps = count_inner_steps(dt)
                    for _ in range(substeps):
                        self._step_implicitly(motion, dt / substeps, tau - bias, inverse, bias)
                positions[:, k + 1] = motion.q
        return positions

    def _evaluate_step(self, motion: _MotionState, dt: Array) -> tuple[Array, Array]:
        """Return inverse mass matrices and bias of a step [s], for the plant at its begin."""
        q = motion.q
        if not self.as_plant:
            q = q + 0.5 * dt[:, None] * motion.v  # in its middle
        # Windows that have diverged must not stop the others.
        return self._evaluate_body(np.nan_to_num(q), np.nan_to_num(motion.v))

    def _is_constant(self, q: Array) -> bool:
        """Return whether mass and weight are those of one joint at any position."""
        if self.robot.n > 1 or self.robot.follow:
            return False
        masses = []
        weights = []
        for offset in _TEST_OFFSETS:
            mass, weight = self.robot.dynamics(self.parameters, q + offset, 0.0 * q)
            masses.append(mass)
            weights.append(weight)
        return bool(np.ptp(weights, axis=0).max() <= _WEIGHT_TOLERANCE * np.max(np.abs(masses)))

    def _evaluate_body(self, q: Array, dq: Array) -> tuple[Array, Array]:
        mass, bias = self.robot.dynamics(self.parameters, q, dq)
        if not _is_positive_definite(mass):
            # As a simulation diverges, centrifugal torques grow until rounding swallows the mass.
            mass, _ = self.robot.dynamics(self.parameters, q, np.zeros_like(dq))
            if not _is_positive_definite(mass):
                raise SimulationError(
                    f"robot '{self.robot.description.name}': the identified mass matrix is not "
                    'positive; identify the body with body = "physical", or use more logs.'
                )
        return np.asarray(np.linalg.inv(mass), dtype=np.float64), bias

    def _to_friction(self, tau_load: Array) -> tuple[Array, Array]:
        coupling = self.model.coupling
        if coupling is None:
            return np.eye(tau_load.shape[1]), tau_load
        return coupling.forward, coupling.torque(tau_load)

    def _step_implicitly(
        self, motion: _MotionState, h: Array, tau: Array, inverse: Array, tau_load: Array
    ) -> None:
        laws = motion.laws
        x = motion.x
        forward, friction_loads = self._to_friction(tau_load)
        friction_inverse = forward @ inverse @ forward.T
        free_dq = motion.v + h[:, None] * np.einsum("wij,wj->wi", inverse, tau)
        free_speed = free_dq @ forward.T
        position = motion.q @ forward.T
        start_speed = motion.v @ forward.T
        start_forces = []
        for j, law in enumerate(laws):
            start_force, _ = law(h, start_speed[:, j], position[:, j], friction_loads[:, j], x[j])
            start_forces.append(start_force)
        force = np.stack(start_forces, axis=1)
        speed = start_speed.copy()
        sweeps = _JOINT_SWEEPS if len(laws) > 1 else 1
        for _ in range(sweeps):
            for j, law in enumerate(laws):
                # Friction of the other joints is that of the last sweep.
                gain = h * friction_inverse[:, j, j]
                acceleration = np.einsum("wj,wj->w", friction_inverse[:, j], force)
                coupled_acceleration = acceleration - friction_inverse[:, j, j] * force[:, j]
                target = free_speed[:, j] - h * coupled_acceleration
                speed[:, j] = _find_root(
                    law, h, position[:, j], friction_loads[:, j], x[j], target, gain, speed[:, j]
                )
                force[:, j] = (target - speed[:, j]) / gain
        for j, law in enumerate(laws):
            _, x[j] = law(
                h, speed[:, j], position[:, j] + h * speed[:, j], friction_loads[:, j], x[j]
            )
        motion.v = free_dq - h[:, None] * np.einsum("wij,wj->wi", inverse, force @ forward)
        motion.q = motion.q + h[:, None] * motion.v

    def _step_explicitly(
        self, motion: _MotionState, h: Array, tau: Array, inverse: Array, tau_load: Array
    ) -> None:
        x = motion.x
        forward, friction_loads = self._to_friction(tau_load)
        position = motion.q @ forward.T
        speed = motion.v @ forward.T
        force = np.empty_like(speed)
        zero_step = np.zeros_like(h)
        for j, law in enumerate(motion.laws):
            force[:, j], _ = law(zero_step, speed[:, j], position[:, j], friction_loads[:, j], x[j])
            _, x[j] = law(h, speed[:, j], position[:, j], friction_loads[:, j], x[j])
        motion.v = motion.v + h[:, None] * np.einsum("wij,wj->wi", inverse, tau - force @ forward)
        motion.q = motion.q + h[:, None] * motion.v


def _is_positive_definite(mass: Array) -> bool:
    """Return whether all matrices (N, n, n) are positive definite."""
    try:
        np.linalg.cholesky(mass)
    except np.linalg.LinAlgError:
        return False
    return True


def position_errors(positions: Array, windows: Windows) -> tuple[float | None, ...]:
    """Return each joint's RMS position error (W, K + 1, n) [rad; m]; None if diverging."""
    with np.errstate(all="ignore"):
        error = np.sqrt(np.mean(np.square(positions - windows.q), axis=(0, 1)))
    return tuple(float(joint_error) if np.isfinite(joint_error) else None for joint_error in error)


def _find_root(
    law: LawStepper,
    h: Array,
    q: Array,
    tau_load: Array,
    x: Array,
    target: Array,
    gain: Array,
    start: Array,
) -> Array:
    """Return the velocity s with s + gain F(s) = target, (W,) [rad/s], by the Illinois method.

    Friction hardly falls within a step, so the root is within twice the first residual.
    """

    def residual(s: Array) -> Array:
        return s - target + gain * law(h, s, q + h * s, tau_load, x)[0]

    lower = start
    residual_lower = residual(start)
    upper = lower - 2.0 * residual_lower
    residual_upper = residual(upper)
    for _ in range(_ROOT_ITERATIONS):
        # Where both ends are the root, any divisor will do.
        difference = residual_upper - residual_lower
        divisor = np.where(difference == 0.0, 1.0, difference)
        middle = upper - residual_upper * (upper - lower) / divisor
        residual_middle = residual(middle)
        if not np.any(np.abs(residual_middle) > _SPEED_PRECISION):
            break
        has_crossed = residual_middle * residual_upper < 0.0
        residual_lower = np.where(has_crossed, residual_upper, 0.5 * residual_lower)
        lower = np.where(has_crossed, upper, lower)
        upper = middle
        residual_upper = residual_middle
    return middle
