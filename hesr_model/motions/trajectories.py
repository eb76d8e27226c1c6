"""Motions in closed form that start at rest, with exact derivatives."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from hesr_model.errors import ConfigError
from hesr_model.logs.noise import standard_normal
from hesr_model.support.arrays import Array

_AT_REST = 1e-9  # start [rad/s, rad/s2] that counts as rest, over the largest coefficient
_ROUNDING = 1e-9  # round-off of the end of a motion [s]
_POINTS_PER_CYCLE = 256  # of the highest harmonic; peaks are low by at most 8e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory(ABC):
    """Motion of n joints over a finite time."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """Length of the motion [s]."""

    @abstractmethod
    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """Return `q`, `dq` and `ddq`, (N, n) each [rad, rad/s, rad/s2], at times `t` (N,) [s].

        Before 0 and after `duration` periodic motions continue and others rest.
        """

    def reverse_time(self) -> "Trajectory":
        """Return the same path run backwards: q(duration - t)."""
        return Reversed(forward=self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Reversed(Trajectory):
    """Time-reversed motion."""

    forward: Trajectory

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return self.forward.duration

    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """See `Trajectory.sample`."""
        q, dq, ddq = self.forward.sample(self.duration - np.asarray(t))
        return q, -dq, ddq

    def reverse_time(self) -> Trajectory:
        """Return the original motion."""
        return self.forward


@dataclass(frozen=True, kw_only=True, eq=False)
class Fourier(Trajectory):
    """Finite Fourier series, periodic (paper, section III-B), from coefficients (n, H) [rad/s].

    With w = 2 pi / period and k = 1..H::

        dq = sum_k a_k cos(k w t) + b_k sin(k w t)
        q  = offset + sum_k (a_k sin(k w t) - b_k cos(k w t)) / (k w)

    It starts and ends at rest and without acceleration: sum_k a_k = 0 and sum_k k b_k = 0. Raises
    ConfigError if a joint does not.
    """

    offset: Array
    a: Array
    b: Array
    period: float
    periods: int = 1

    def __post_init__(self) -> None:
        orders = np.arange(1, self.a.shape[1] + 1)
        scale = max(float(np.abs(self.a).max()), float(np.abs(orders * self.b).max()))
        end_mismatch = np.maximum(np.abs(self.a.sum(axis=1)), np.abs(self.b @ orders))
        if np.any(end_mismatch > _AT_REST * scale):
            number = int(np.argmax(end_mismatch)) + 1
            raise ConfigError(
                f"Fourier motion: joint {number} does not start at rest (sum of a_k is "
                f"{self.a[number - 1].sum():.3g}, sum of k b_k is "
                f"{self.b[number - 1] @ orders:.3g} rad/s); both must be zero."
            )

    @classmethod
    def from_rest(cls, a: Array, b: Array, **fields: Any) -> Self:
        """Return the nearest motion that starts at rest."""
        orders = np.arange(1.0, a.shape[1] + 1)
        return cls(
            a=a - a.mean(axis=1, keepdims=True),
            b=b - np.outer(b @ orders, orders) / (orders @ orders),
            **fields,
        )

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return self.periods * self.period

    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """See `Trajectory.sample`."""
        rates = 2 * np.pi / self.period * np.arange(1, self.a.shape[1] + 1)
        phase = np.outer(t, rates)
        cos = np.cos(phase)
        sin = np.sin(phase)
        q = self.offset + sin @ (self.a / rates).T - cos @ (self.b / rates).T
        dq = cos @ self.a.T + sin @ self.b.T
        return q, dq, cos @ (self.b * rates).T - sin @ (self.a * rates).T

    def reverse_time(self) -> "Fourier":
        """Return the same path run backwards, again a Fourier series."""
        return replace(self, a=-self.a)


def sample_one_period(motion: Fourier) -> tuple[Array, Array, Array]:
    """Return q, dq and ddq (N, n) on a grid that resolves peaks."""
    points = _POINTS_PER_CYCLE * motion.a.shape[1]
    return motion.sample(np.linspace(0.0, motion.period, points, endpoint=False))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sine(Trajectory):
    """Sine of one frequency [Hz] around `offset` (n,) [rad].

    dq = amplitude sin(w t) and q = offset - amplitude / w cos(w t), w = 2 pi frequency.
    """

    offset: Array
    amplitude: Array
    frequency: float
    periods: int = 1

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return self.periods / self.frequency

    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """See `Trajectory.sample`."""
        rate = 2 * np.pi * self.frequency
        cos = np.cos(rate * np.asarray(t))
        sin = np.sin(rate * np.asarray(t))
        q = self.offset - np.outer(cos, self.amplitude / rate)
        return q, np.outer(sin, self.amplitude), np.outer(cos, self.amplitude * rate)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep(Trajectory):
    """Rising frequency [Hz] with a varying peak velocity (n,) [rad/s], from `start` (n,) [rad].

    In formulas::

        dq    = A(t) sin(phi(t)),  A(t) = amplitude + swing sin(2 pi t / swing_period + swing_phase)
        phi   = 2 pi (first t + (last - first) t^2 / (2 length))

    The position is the exact integral, by Fresnel's functions. The joint rests outside the length
    [s]. Raises ConfigError if the frequency does not rise.
    """

    start: Array
    amplitude: Array
    swing: Array
    swing_phase: Array
    swing_period: float
    first: float
    last: float
    length: float

    def __post_init__(self) -> None:
        if not self.first < self.last:
            raise ConfigError(
                f"sweep from {self.first:g} to {self.last:g} Hz: the frequency must rise."
            )

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return self.length

    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """See `Trajectory.sample`."""
        times = np.asarray(t, dtype=float)[:, None]
        moving_times = np.clip(times, 0.0, self.length)
        is_moving = np.abs(times - moving_times) <= _ROUNDING
        rate = 2 * np.pi * self.first
        slope = 2 * np.pi * (self.last - self.first) / self.length
        slow = 2 * np.pi / self.swing_period
        wave = np.exp(1j * (rate * moving_times + 0.5 * slope * moving_times**2))
        swell = np.exp(1j * (slow * moving_times + self.swing_phase))
        peak = self.amplitude + self.swing * swell.imag
        # 2 sin(phi) sin(s) = cos(phi - s) - cos(phi + s): every term has a quadratic phase.
        steady = _quadratic_phase_integral(0.0, rate, slope, moving_times).imag
        below = _quadratic_phase_integral(-self.swing_phase, rate - slow, slope, moving_times).real
        above = _quadratic_phase_integral(self.swing_phase, rate + slow, slope, moving_times).real
        q = self.start + self.amplitude * steady + 0.5 * self.swing * (below - above)
        dq = peak * wave.imag
        ddq = (
            slow * self.swing * swell.real * wave.imag
            + peak * (rate + slope * moving_times) * wave.real
        )
        return q, np.where(is_moving, dq, 0.0), np.where(is_moving, ddq, 0.0)


def chirp(*, start: Array, amplitude: Array, first: float, last: float, length: float) -> Sweep:
    """Return a sweep of constant peak velocity: dq = amplitude sin(phi(t))."""
    zeros = np.zeros_like(amplitude)
    return Sweep(
        start=start,
        amplitude=amplitude,
        swing=zeros,
        swing_phase=zeros,
        swing_period=length,
        first=first,
        last=last,
        length=length,
    )


def random_fourier(
    *,
    seed: int,
    harmonics: int,
    period: float,
    peak_velocity: Array,
    offset: Array,
    periods: int = 1,
) -> Fourier:
    """Draw a Fourier motion with peak velocities (n,) [rad/s].

    A seed gives the same motion on every machine. Raises ConfigError for fewer than 2 harmonics.
    """
    if harmonics < 2:
        raise ConfigError(f"random Fourier motion: {harmonics} harmonics; at least 2 are needed.")
    joints = np.arange(len(peak_velocity))[:, None]
    counters = np.arange(harmonics)
    a = standard_normal(seed, 2 * joints, counters)
    b = standard_normal(seed, 2 * joints + 1, counters)
    unscaled_motion = Fourier.from_rest(a, b, offset=offset, period=period, periods=periods)
    _, dq, _ = sample_one_period(unscaled_motion)
    joint_scales = np.asarray(peak_velocity) / np.abs(dq).max(axis=0)
    scale = joint_scales[:, None]
    return replace(unscaled_motion, a=scale * unscaled_motion.a, b=scale * unscaled_motion.b)


def _quadratic_phase_integral(
    phase: Array | float, rate: float, slope: float, t: Array
) -> NDArray[np.complex128]:
    """Return the integral from 0 to t of exp(i (phase + rate s + slope s^2 / 2)) ds, for slope > 0.

    Completing the square turns it into Fresnel's C + i S (Abramowitz and Stegun 7.3).
    """
    stretch = np.sqrt(slope / np.pi)
    s0, c0 = fresnel(stretch * rate / slope)
    s1, c1 = fresnel(stretch * (t + rate / slope))
    turn = np.exp(1j * (phase - rate**2 / (2 * slope)))
    integral: NDArray[np.complex128] = turn * ((c1 - c0) + 1j * (s1 - s0)) / stretch
    return integral
