"""Test motions: closed cycles, whose work must be positive, and rest with encoder noise."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.noise import standard_normal
from hesr_model.support.arrays import Array

FREQUENCIES = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)
"""[Hz]. Laws that drive at low speed generate more energy per slow cycle: Table I 12 and 21 J on
joints 1 and 2 at 0.05 Hz, 63 and 104 J at 0.01 Hz.
"""
AMPLITUDES = (1 / 100, 1 / 20, 1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6, 1.0)  # of the trained speed
ENCODER = 20e-6  # [rad] RMS noise

_SETTLING = 3.0  # [s] several time constants
_NOISE_ROWS = 4000
_ROUNDING = 1e-9  # of the work


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """A motion dq = amplitude cos(2 pi frequency t) at a load, and the work of the law."""

    amplitude: float  # [rad/s]
    frequency: float  # [Hz]
    tau_load: float  # [N.m]
    work: float  # [J] dissipated; negative if generated
    share: float  # of the integral of |tau dq|, from 1 (a brake) to -1 (a motor)
    swing: float = 0.0  # [N.m] of the load at twice the frequency


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedMotions:
    """Settling and one closed cycle of `rows` rows at one frequency, for A amplitudes."""

    amplitudes: Array  # (A,) [rad/s]
    frequency: float  # [Hz]
    rows: int
    dq: Array  # (A, K) [rad/s]
    q: Array  # (A, K) [rad]


def closed_motions(trained: TrainedRange, amplitudes: Array, wanted: float) -> ClosedMotions:
    """Return motions at about `wanted` [Hz] for amplitudes (A,) [rad/s] around the middle position.

    Each position occurs once at dq and once at -dq, so torques of position alone do zero work.
    """
    half = max(4, round(0.5 / (wanted * trained.sample_time)))
    settling = half * max(1, round(2.0 * wanted * _SETTLING))
    phase = np.pi / half * np.arange(-settling, 2 * half)
    frequency = 0.5 / (half * trained.sample_time)
    reach = amplitudes[:, None] / (2.0 * np.pi * frequency)
    return ClosedMotions(
        amplitudes=amplitudes,
        frequency=frequency,
        rows=2 * half,
        dq=amplitudes[:, None] * np.cos(phase),
        q=trained.middle + reach * np.sin(phase),
    )


def cycles(motions: ClosedMotions, tau_load: float, tau: Array) -> Iterator[Cycle]:
    """Yield the work of `tau` (A, K) [N.m] in the last cycle of each amplitude."""
    dt = 1.0 / (motions.frequency * motions.rows)
    power = (tau * motions.dq)[:, -motions.rows :]
    for amplitude, row in zip(motions.amplitudes, power, strict=True):
        work, moved = float(row.sum()) * dt, float(np.abs(row).sum()) * dt
        share = work / moved if moved > 0.0 else 0.0
        rounding = abs(share) < _ROUNDING
        yield Cycle(
            amplitude=float(amplitude),
            frequency=motions.frequency,
            tau_load=tau_load,
            work=0.0 if rounding else work,
            share=0.0 if rounding else share,
        )


def encoder_noise(trained: TrainedRange) -> tuple[Array, Array, int]:
    """Return velocity (K,) [rad/s], position (K,) [rad] and settling rows of a noisy rest."""
    settling = round(_SETTLING / trained.sample_time)
    noise = ENCODER * standard_normal(0, 0, np.arange(settling + _NOISE_ROWS + 1))
    return np.diff(noise) / trained.sample_time, trained.middle + noise[1:], settling
