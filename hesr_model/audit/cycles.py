"""Motions on which a law is tried: closed cycles, whose work is to be positive, and noisy rest.

The audit runs laws over them in NumPy, the property battery the same laws as FMUs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.noise import standard_normal
from hesr_model.support.arrays import Array

FREQUENCIES = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)
"""Of the closed cycles [Hz]. A law that drives at low speed gives more per cycle the slower it is:
Table I gives 12 and 21 J on joints 1 and 2 at 0.05 Hz, 63 and 104 J at 0.01 Hz."""
AMPLITUDES = (1 / 100, 1 / 20, 1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6, 1.0)
"""Velocity amplitudes of the cycles, as shares of the largest trained speed."""
ENCODER = 20e-6
"""RMS noise of the encoder [rad] of which the chatter at rest is made."""

_SETTLING = 3.0  # [s] before a cycle is measured: several memories of the laws' states
_NOISE_ROWS = 4000
_ROUNDING = 1e-9  # least share of the work that is not taken for rounding


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """A motion dq = amplitude cos(2 pi frequency t) at a load, and the law's work in it.

    Attributes
    ----------
    amplitude : of the velocity [rad/s].
    frequency : as sampled [Hz].
    tau_load : load torque [N.m].
    work : that the law takes out of one settled cycle [J]; negative is generated energy.
    share : work over the integral of |tau dq|, from 1 (a brake) to -1 (a motor).
    swing : amplitude of the load about `tau_load`, at twice the frequency [N.m].
    """

    amplitude: float
    frequency: float
    tau_load: float
    work: float
    share: float
    swing: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedMotions:
    """Settling and one closed cycle of `rows` rows at one frequency, for each amplitude.

    Attributes
    ----------
    amplitudes : (A,) of the velocity [rad/s].
    frequency : as sampled [Hz].
    rows : of the cycle, which is the last one.
    dq, q : (A, K) velocity [rad/s] and position [rad].
    """

    amplitudes: Array
    frequency: float
    rows: int
    dq: Array
    q: Array


def closed_motions(trained: TrainedRange, amplitudes: Array, wanted: float) -> ClosedMotions:
    """Return motions dq = amplitude cos(2 pi f t) around the middle of the trained positions.

    The samples of a cycle lie symmetrically, so each position is passed once at dq and once at
    -dq: a torque of position alone, such as motor ripple, sums to no work however fast it is.

    Parameters
    ----------
    trained : whose sample time counts.
    amplitudes : (A,) of the velocity [rad/s].
    wanted : frequency [Hz]; the one that comes out has a whole number of samples in half a cycle.
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
    """Return the work in the measured cycle of each amplitude.

    Parameters
    ----------
    motions : that were run.
    tau_load : load that was held [N.m].
    tau : (A, K) torque that a law gave [N.m].
    """
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
    """Return what an encoder says of a joint at rest at the middle of the trained positions.

    Returns
    -------
    (K,) velocity [rad/s], the backward difference of white noise of `ENCODER`; (K,) position [rad];
    and the rows after which a law has settled.
    """
    settling = round(_SETTLING / trained.sample_time)
    noise = ENCODER * standard_normal(0, 0, np.arange(settling + _NOISE_ROWS + 1))
    return np.diff(noise) / trained.sample_time, trained.middle + noise[1:], settling
