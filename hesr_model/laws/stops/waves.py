"""Ripple of ParFam-S: harmonics of the motor angle with a lag, chosen by cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.nonnegative import Normal, blocks_of, pays
from hesr_model.support.arrays import Array

ORDERS = range(1, 17)  # per turn of the motor
NEAR = 3  # [1/rad] from an integer multiple of the gear ratio
LAGS = np.arange(0.0, 0.0121, 0.0005)  # [s]
MOST = 6  # frequencies of a joint
GAIN = 0.002  # smallest relative gain of the left-out mean square by a frequency


_PHASE = 0.6  # range of the lag, as a phase at 1 rad/s [rad]


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Frequencies in the joint angle [1/rad] and their common lag [s]."""

    frequencies: tuple[int, ...]
    lag: float


def waves(frequencies: Sequence[int], lag: float, samples: JointRows) -> Array:
    """Return the (N, 2 K) cosines and sines of the joint angle before the lag."""
    phase = np.outer(samples.q - lag * samples.dq, np.asarray(frequencies, dtype=float))
    return np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(samples.q), -1)


def select(base: Array, samples: JointRows, weights: Array, gear_ratio: float) -> Waves:
    """Return the waves that lower the error on left-out rows by more than one standard error.

    `base` (N, K) are the columns of a law with a force, the offset last; `weights` (N,) are 1 or 0.
    """
    problem = _Problem(base=base, samples=samples, weights=weights)
    blocks = blocks_of(samples.dt, samples.begins)
    chosen = Waves(frequencies=(), lag=0.0)
    errors = problem.left_out(chosen)
    while len(chosen.frequencies) < MOST:
        if (trial := _next(problem, chosen, gear_ratio)) is None:
            break
        trial = problem.in_phase(trial, reach=_PHASE / max(trial.frequencies))
        left = problem.left_out(trial)
        gain = 1.0 - float(left @ left) / float(errors @ errors)
        if gain < GAIN or not pays(errors, left, blocks):
            break
        chosen, errors = trial, left
    return chosen


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    base: Array
    samples: JointRows
    weights: Array

    def columns(self, chosen: Waves) -> Array:
        own = waves(chosen.frequencies, chosen.lag, self.samples)
        return np.hstack([self.base, own]) if chosen.frequencies else self.base

    def left_out(self, chosen: Waves) -> Array:
        s, free = self.samples, 1 + 2 * len(chosen.frequencies)
        return Normal.of(self.columns(chosen), s.tau, s.folds, self.weights, free=free).left_out()

    def residual(self, chosen: Waves) -> Array:
        columns, tau = self.weights[:, None] * self.columns(chosen), self.weights * self.samples.tau
        x = np.linalg.lstsq(columns.T @ columns, columns.T @ tau, rcond=1e-12)[0]
        return np.asarray(tau - columns @ x)

    def in_phase(self, chosen: Waves, *, reach: float) -> Waves:
        """Return the waves with the best lag within `reach` [s]."""

        def cost(lag: float) -> float:
            left = self.residual(replace(chosen, lag=lag))
            return float(left @ left)

        around = (max(0.0, chosen.lag - reach), chosen.lag + reach)
        found = minimize_scalar(
            cost, bounds=around, method="bounded", options={"xatol": reach / 50.0}
        )
        return replace(chosen, lag=float(found.x))


def _next(problem: _Problem, chosen: Waves, gear_ratio: float) -> Waves | None:
    """Return the waves plus the one that fits the residual best, over all lags for the first."""
    samples, residual = problem.samples, problem.residual(chosen)
    taken = {round(n / gear_ratio) for n in chosen.frequencies}
    orders = [order for order in ORDERS if order not in taken]
    if not orders:
        return None
    fits = {}
    for lag in [chosen.lag] if taken else LAGS:
        first = np.exp(1j * gear_ratio * (samples.q - lag * samples.dq))
        power = residual.astype(complex)
        for order in ORDERS:
            power = power * first
            fits[order, float(lag)] = abs(complex(power.sum()))
    order, lag = max((key for key in fits if key[0] in orders), key=fits.__getitem__)
    whole = round(order * gear_ratio)
    angle = samples.q - lag * samples.dq
    near = range(max(1, whole - NEAR), whole + NEAR + 1)
    frequency = max(near, key=lambda n: abs(complex(residual @ np.exp(1j * n * angle))))
    return Waves(frequencies=(*chosen.frequencies, frequency), lag=lag)
