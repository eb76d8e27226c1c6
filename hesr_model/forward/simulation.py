"""Simulation of an identified body with friction under measured torque.

    M(q) ddq + c(q, dq) + g(q) + tau_f = tau

Presliding friction is too stiff for a log's sample rate, so it is implicit in each inner step, as
in a drive: with A = M^-1 the velocity v+ after a step h solves

    v+ + h A tau_f(v+) = v + h A (tau - c - g),  q+ = q + h v+.

M, c and g are those in the middle of a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, compress

import numpy as np

from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import LawStepper, states_over
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord, at_friction
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Mask

RUN_IN = 1.0  # run-in of friction states before a log's first window [s]
_WEIGHTLESS = 1e-9  # threshold of gravity over the largest torque
_BLOCK_ROUNDING = 0.01  # of times, in blocks
_SIGNALS = ("t", "q", "dq", "tau")
Logs = Sequence[Sequence[FrictionRecord]]  # records of each part of each log, [part][joint]


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """W windows of K steps: `t` (W, K + 1) [s]; `q`, `dq`, `tau` (W, K + 1, n), measured."""

    t: Array
    q: Array
    dq: Array
    tau: Array
    places: tuple[tuple[int, int], ...]  # part of a log and first row of each window
    logs: Logs = field(repr=False)

    def blocks(self, length: float) -> Array:
        """Return the number of each window's block of a length [s] after the run-in, (W,)."""
        starts = np.array([self.logs[part][0].t[0] + RUN_IN for part, _ in self.places])
        parts = np.array([part for part, _ in self.places])
        return np.asarray(parts + np.floor((self.t[:, 0] - starts) / length + _BLOCK_ROUNDING))

    def some(self, rows: Mask) -> "Windows":
        """Return some of the windows, in the same order."""
        signals = {name: getattr(self, name)[rows] for name in _SIGNALS}
        return replace(self, **signals, places=tuple(compress(self.places, rows)))

    def states(self, model: FrictionModel, *, delay: int = 0) -> list[Array]:
        """Return each law's states (m, W), run in along the logs, `delay` rows before windows."""
        found: list[list[Array]] = [[] for _ in model.laws]
        for number, joint_records in enumerate(self.logs):
            rows = [max(row - delay, 0) for place, row in self.places if place == number]
            for i, (law, record) in enumerate(
                zip(model.laws, at_friction(joint_records), strict=True)
            ):
                found[i].append(states_over(law, **record.motion)[:, rows])
        return [np.concatenate(parts, axis=1) for parts in found]


def windows_of(records: Logs, length: float) -> Windows:
    """Cut logs into windows of a length [s] after a run-in; raise SimulationError if none fits."""
    times = [joint_records[0].t for joint_records in records]
    steps = max(1, round(length / float(np.median(np.concatenate([np.diff(t) for t in times])))))
    places = [
        (number, row)
        for number, t in enumerate(times)
        for row in range(int(np.searchsorted(t, t[0] + RUN_IN)), len(t) - steps, steps)
    ]
    if not places:
        names = ", ".join(dict.fromkeys(joint_records[0].log for joint_records in records))
        raise SimulationError(
            f"log {names}: too short for a window of {length:g} s after a run-in of {RUN_IN:g} s."
        )
    return _cut(records, places, steps)


def joined(sets: Sequence[Windows]) -> Windows:
    """Join sets of windows with equal numbers of steps."""
    firsts = accumulate((len(w.logs) for w in sets), initial=0)
    return Windows(
        **{name: np.concatenate([getattr(w, name) for w in sets]) for name in _SIGNALS},
        places=tuple(
            (first + part, row)
            for first, w in zip(firsts, sets, strict=False)
            for part, row in w.places
        ),
        logs=[joint_records for w in sets for joint_records in w.logs],
    )


def whole(joint_records: Sequence[FrictionRecord]) -> Windows:
    """Return a log, [joint], as one window without run-in."""
    return _cut([joint_records], [(0, 0)], len(joint_records[0].t) - 1)


def _cut(records: Logs, places: Sequence[tuple[int, int]], steps: int) -> Windows:
    if records[0][0].tau_body is not None:
        raise SimulationError(
            f"log '{records[0][0].log}': the load of its friction is a pressure, which a "
            "simulation "
            "of motion does not know."
        )
    signals = {
        "q": [np.column_stack([record.q for record in joint_records]) for joint_records in records],
        "dq": [
            np.column_stack([record.dq for record in joint_records]) for joint_records in records
        ],
        "tau": [
            np.column_stack([record.measured for record in joint_records])
            for joint_records in records
        ],
        "t": [joint_records[0].t for joint_records in records],
    }
    cut = {
        name: np.stack([parts[n][row : row + steps + 1] for n, row in places])
        for name, parts in signals.items()
    }
    return Windows(**cut, places=tuple(places), logs=records)


def weightless(records: Logs, robot: Robot, body: RigidBody) -> bool:
    """Return whether gravity acts on no joint; otherwise whole logs diverge with any friction."""
    q = np.concatenate(
        [np.column_stack([record.q for record in joint_records]) for joint_records in records]
    )
    weight = robot.torque(body.parameters, q, np.zeros_like(q), np.zeros_like(q))
    largest = max(
        np.abs(record.measured).max() for joint_records in records for record in joint_records
    )
    return bool(np.abs(weight).max() <= _WEIGHTLESS * largest)


SUBSTEP = 2.5e-3  # longest inner step [s]
_SWEEPS = 2  # sweeps over joints, coupled by the mass matrix
_ITERATIONS = 12  # iterations of a root
_WAYS = (0.0, 1.0, 2.5)  # [rad; m] no sine or spring is equal at all three
_CONSTANT = 1e-12  # spread of a constant weight over the mass
_ROUNDING = 1e-6  # round-off of time differences, in inner steps
_PRECISION = 1e-10  # precision of a velocity [rad/s]


def inner_steps(dt: Array) -> int:
    """Return the number of inner steps for steps `dt` [s]."""
    return int(np.ceil(dt.max() / SUBSTEP - _ROUNDING))


@dataclass(eq=False)
class _Moving:
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
    friction: FrictionModel
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
        # MuJoCo uses the rates before a step: its states lag by one row.
        x0 = windows.states(self.friction, delay=int(self.as_plant)) if states is None else states
        own = [None] * len(x0) if values is None else values
        now = _Moving(
            laws=[LawStepper(law, one) for law, one in zip(self.friction.laws, own, strict=True)],
            x=[part.copy() for part in x0],
            q=windows.q[:, 0].copy(),
            v=windows.dq[:, 0].copy(),
        )
        found = np.empty_like(windows.q)
        found[:, 0] = now.q
        body = self._body(now.q, now.v) if self._is_constant(now.q) else None
        steps = np.diff(windows.t, axis=1)
        with np.errstate(all="ignore"):  # divergence shows in the result
            for k, dt in enumerate(steps.T):
                middle = now.q if self.as_plant else now.q + 0.5 * dt[:, None] * now.v
                inverse, bias = body or self._body(np.nan_to_num(middle), np.nan_to_num(now.v))
                tau = windows.tau[:, k]
                if self.as_plant:
                    self._explicit(now, dt, tau - bias, inverse, bias)
                else:
                    tau = 0.5 * (tau + windows.tau[:, k + 1])
                    parts = inner_steps(dt)
                    for _ in range(parts):
                        self._implicit(now, dt / parts, tau - bias, inverse, bias)
                found[:, k + 1] = now.q
        return found

    def _is_constant(self, q: Array) -> bool:
        """Return whether mass and weight are those of one joint at any position."""
        if self.robot.n > 1 or self.robot.follow:
            return False
        masses, weights = zip(
            *(self.robot.dynamics(self.parameters, q + way, 0.0 * q) for way in _WAYS), strict=True
        )
        return bool(np.ptp(weights, axis=0).max() <= _CONSTANT * np.max(np.abs(masses)))

    def _body(self, q: Array, v: Array) -> tuple[Array, Array]:
        mass, bias = self.robot.dynamics(self.parameters, q, v)
        try:
            np.linalg.cholesky(mass)
        except np.linalg.LinAlgError as error:
            raise SimulationError(
                f"robot '{self.robot.description.name}': the identified mass matrix is not "
                "positive; identify with --physical, or from more logs."
            ) from error
        return np.asarray(np.linalg.inv(mass), dtype=np.float64), bias

    def _at_friction(self, load: Array) -> tuple[Array, Array]:
        coupling = self.friction.coupling
        if coupling is None:
            return np.eye(load.shape[1]), load
        return coupling.forward, coupling.torque(load)

    def _implicit(self, now: _Moving, h: Array, tau: Array, inverse: Array, load: Array) -> None:
        laws, x, (forward, loads) = now.laws, now.x, self._at_friction(load)
        own = forward @ inverse @ forward.T
        free = now.v + h[:, None] * np.einsum("wij,wj->wi", inverse, tau)
        a = free @ forward.T
        p = now.q @ forward.T
        u = now.v @ forward.T
        force = np.stack(
            [law(h, u[:, i], p[:, i], loads[:, i], x[i])[0] for i, law in enumerate(laws)], axis=1
        )
        speed = u.copy()
        for _ in range(_SWEEPS if len(laws) > 1 else 1):
            for i, law in enumerate(laws):
                gain = h * own[:, i, i]
                rest = np.einsum("wj,wj->w", own[:, i], force) - own[:, i, i] * force[:, i]
                target = a[:, i] - h * rest
                speed[:, i] = _root(law, h, p[:, i], loads[:, i], x[i], target, gain, speed[:, i])
                force[:, i] = (target - speed[:, i]) / gain
        for i, law in enumerate(laws):
            _, x[i] = law(h, speed[:, i], p[:, i] + h * speed[:, i], loads[:, i], x[i])
        now.v = free - h[:, None] * np.einsum("wij,wj->wi", inverse, force @ forward)
        now.q = now.q + h[:, None] * now.v

    def _explicit(self, now: _Moving, h: Array, tau: Array, inverse: Array, load: Array) -> None:
        x, (forward, loads) = now.x, self._at_friction(load)
        p = now.q @ forward.T
        u = now.v @ forward.T
        force = np.empty_like(u)
        still = np.zeros_like(h)
        for i, law in enumerate(now.laws):
            force[:, i], _ = law(still, u[:, i], p[:, i], loads[:, i], x[i])
            _, x[i] = law(h, u[:, i], p[:, i], loads[:, i], x[i])
        now.v = now.v + h[:, None] * np.einsum("wij,wj->wi", inverse, tau - force @ forward)
        now.q = now.q + h[:, None] * now.v


def position_errors(found: Array, windows: Windows) -> tuple[float | None, ...]:
    """Return each joint's RMS position error (W, K + 1, n) [rad; m]; None if diverging."""
    with np.errstate(all="ignore"):
        error = np.sqrt(np.mean(np.square(found - windows.q), axis=(0, 1)))
    return tuple(float(e) if np.isfinite(e) else None for e in error)


def _root(
    law: LawStepper,
    h: Array,
    q: Array,
    load: Array,
    x: Array,
    target: Array,
    gain: Array,
    start: Array,
) -> Array:
    """Return the velocity s with s + gain F(s) = target, (W,) [rad/s], by the Illinois method.

    Friction hardly falls within a step, so the root is within twice the first residual.
    """

    def residual(s: Array) -> Array:
        return s - target + gain * law(h, s, q + h * s, load, x)[0]

    low = start
    at_low = residual(start)
    high = low - 2.0 * at_low
    at_high = residual(high)
    for _ in range(_ITERATIONS):
        spread = at_high - at_low
        middle = high - at_high * (high - low) / np.where(spread == 0.0, 1.0, spread)
        at_middle = residual(middle)
        if not np.any(np.abs(at_middle) > _PRECISION):
            break
        crossed = at_middle * at_high < 0.0
        at_low = np.where(crossed, at_high, 0.5 * at_low)
        low = np.where(crossed, high, low)
        high = middle
        at_high = at_middle
    return middle
