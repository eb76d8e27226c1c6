"""Simulation of an identified body with friction under measured torque.

    M(q) ddq + c(q, dq) + g(q) + tau_f = tau

Presliding friction is too stiff for a log's sample rate, so it is implicit in each inner step, as
in a drive: with A = M^-1 the velocity v+ after a step h solves

    v+ + h A tau_f(v+) = v + h A (tau - c - g),  q+ = q + h v+.

M, c and g are those in the middle of a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.errors import SimulationError
from hesr_model.forward.windows import Windows
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.stepper import LawStepper
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

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
    """Body with (P,) standard parameters, or (W, P) for each window, and its friction.

    `as_plant` steps explicitly as MuJoCo does, for logs of the twin.
    """

    robot: Robot
    parameters: Array
    friction: FrictionModel
    as_plant: bool = False

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
        run_in = (
            windows.states(self.friction, delay=int(self.as_plant)) if states is None else states
        )
        own = [None] * len(run_in) if values is None else values
        now = _Moving(
            laws=[LawStepper(law, one) for law, one in zip(self.friction.laws, own, strict=True)],
            x=[part.copy() for part in run_in],
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
        if (coupling := self.friction.coupling) is None:
            return np.eye(load.shape[1]), load
        return coupling.forward, coupling.torque(load)

    def _implicit(self, now: _Moving, h: Array, tau: Array, inverse: Array, load: Array) -> None:
        laws, x, (forward, loads) = now.laws, now.x, self._at_friction(load)
        own = forward @ inverse @ forward.T
        free = now.v + h[:, None] * np.einsum("wij,wj->wi", inverse, tau)
        a, p, u = free @ forward.T, now.q @ forward.T, now.v @ forward.T
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
        p, u = now.q @ forward.T, now.v @ forward.T
        force, still = np.empty_like(u), np.zeros_like(h)
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

    low, at_low = start, residual(start)
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
        high, at_high = middle, at_middle
    return middle
