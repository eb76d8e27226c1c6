"""Planned motions through setpoints, and their pieces."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from hesr_model.motions.limits import Limits
from hesr_model.motions.trajectories import Trajectory
from hesr_model.support.arrays import Array

_PEAK_SPEED = 1.875  # of the quintic blend, for unit way and time
_PEAK_ACCELERATION = 5.7736  # of the quintic blend, for unit way and time
_TIME_MARGIN = 1.05  # factor on the time of a move
_FADE_SHARE = 0.1  # share of a chirp that fades in, and out
_FIRST_FREQUENCY = 0.1  # of a chirp [Hz]
_LAST_FREQUENCY = 1.0  # of a chirp [Hz]

Pulse = tuple[float, float, float, float]  # speed [rad/s], its ramps, hold and rest after it [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion(Trajectory):
    """Quintic spline through `rows` (N, n) [rad] at a `rate` [Hz], at rest at both ends."""

    rate: float
    rows: Array
    parts: tuple[tuple[str, float, float], ...] = ()  # name, first and last time [s]

    @cached_property
    def _spline(self) -> Any:
        rest_conditions = [(order, np.zeros(self.rows.shape[1])) for order in (1, 2)]
        t = np.arange(len(self.rows)) / self.rate
        return make_interp_spline(t, self.rows, k=5, bc_type=(rest_conditions, rest_conditions))

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return (len(self.rows) - 1) / self.rate

    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """See `Trajectory.sample`."""
        clipped_t = np.clip(t, 0.0, self.duration)
        return self._spline(clipped_t), self._spline(clipped_t, 1), self._spline(clipped_t, 2)

    def setpoints(self) -> tuple[Array, Array, Array, Array]:
        """Return times (N,) [s] and q, dq, ddq (N, n), with exact ends."""
        t = np.arange(len(self.rows)) / self.rate
        _, dq, ddq = self.sample(t)
        dq[[0, -1]] = ddq[[0, -1]] = 0.0
        return t, self.rows, dq, ddq


def compute_pulses(program: Sequence[Pulse], t: Array) -> Array:
    """Return the displacement (N,) [rad] of pulses of velocity, one after another.

    A pulse rises to its speed, holds it, falls to 0 and rests: it travels speed (ramp + hold), with
    a largest acceleration of 1.5 speed / ramp.
    """

    def integrate_step(s: Array) -> Array:  # integral of the step 3 s^2 - 2 s^3
        x = np.clip(s, 0.0, 1.0)
        return np.asarray(x**3 - 0.5 * x**4 + np.maximum(s - 1.0, 0.0))

    displacement = np.zeros_like(t)
    start = 0.0
    for speed, ramp, hold, pause in program:
        s = (t - start) / ramp
        displacement += speed * ramp * (integrate_step(s) - integrate_step(s - 1.0 - hold / ramp))
        start += 2.0 * ramp + hold + pause
    return displacement


def plan_move(start_pose: Array, end_pose: Array, limits: Limits, rate: float) -> Array:
    """Return rows (N, n) from rest to rest, without the first, within speeds and accelerations."""
    distance = np.abs(end_pose - start_pose)
    durations = [_PEAK_SPEED * distance / limits.velocity]
    durations.append(np.sqrt(_PEAK_ACCELERATION * distance / limits.acceleration))
    row_count = max(1, int(np.ceil(_TIME_MARGIN * rate * np.max(durations))))
    rows = start_pose + (end_pose - start_pose) * _blend(
        np.arange(1, row_count + 1)[:, None] / row_count
    )
    rows[-1] = end_pose
    return np.asarray(rows)


def _blend(s: Array) -> Array:
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def compute_chirp(start: Array, limits: Limits, t: Array) -> Array:
    """Return rows (N, n) of a chirp from 0.1 to 1 Hz around `start` (n,), at rest at both ends.

    Its frequency rises geometrically; positions, speeds and accelerations stay within the limits,
    but for its envelope.
    """
    growth = np.log(_LAST_FREQUENCY / _FIRST_FREQUENCY) / t[-1]
    angular_frequency = 2.0 * np.pi * _FIRST_FREQUENCY * np.exp(growth * t)[:, None]
    reach = np.maximum(0.9 * np.minimum(start - limits.lower, limits.upper - start), 1e-9)
    amplitude = 1.0 / (
        1.0 / reach
        + angular_frequency / limits.velocity
        + angular_frequency**2 / limits.acceleration
    )
    fade = _blend(np.clip(np.minimum(t, t[-1] - t) / (_FADE_SHARE * t[-1]), 0.0, 1.0))[:, None]
    angle = (angular_frequency - angular_frequency[0]) / growth + np.arange(len(start))
    return np.asarray(start + fade * amplitude * np.sin(angle))
