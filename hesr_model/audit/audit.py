"""Audit of a friction law: dissipation, stiffness at rest and range of the torque.

Torques of position alone can drive the joint without generating net energy, so steady sliding is
audited with (`driving`) and without them (`driving_both_ways`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import Range, TrainedRange
from hesr_model.logs.noise import standard_normal
from hesr_model.support.arrays import Array

FREQUENCIES = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)  # [Hz]; a driving law gives more if slower
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


def closed_motions(trained_range: TrainedRange, amplitudes: Array, wanted: float) -> ClosedMotions:
    """Return motions at about `wanted` [Hz] for amplitudes (A,) [rad/s] around the middle position.

    Each position occurs once at dq and once at -dq, so torques of position alone do zero work.
    """
    half = max(4, round(0.5 / (wanted * trained_range.sample_time)))
    settling = half * max(1, round(2.0 * wanted * _SETTLING))
    phase = np.pi / half * np.arange(-settling, 2 * half)
    frequency = 0.5 / (half * trained_range.sample_time)
    reach = amplitudes[:, None] / (2.0 * np.pi * frequency)
    return ClosedMotions(
        amplitudes=amplitudes,
        frequency=frequency,
        rows=2 * half,
        dq=amplitudes[:, None] * np.cos(phase),
        q=trained_range.middle + reach * np.sin(phase),
    )


def cycles(motions: ClosedMotions, tau_load: float, tau: Array) -> Iterator[Cycle]:
    """Yield the work of `tau` (A, K) [N.m] in the last cycle of each amplitude."""
    dt = 1.0 / (motions.frequency * motions.rows)
    power = (tau * motions.dq)[:, -motions.rows :]
    for amplitude, row in zip(motions.amplitudes, power, strict=True):
        work = float(row.sum()) * dt
        moved = float(np.abs(row).sum()) * dt
        share = work / moved if moved > 0.0 else 0.0
        if abs(share) < _ROUNDING:
            work = share = 0.0
        yield Cycle(
            amplitude=float(amplitude),
            frequency=motions.frequency,
            tau_load=tau_load,
            work=work,
            share=share,
        )


def encoder_noise(trained_range: TrainedRange) -> tuple[Array, Array, int]:
    """Return velocity (K,) [rad/s], position (K,) [rad] and settling rows of a noisy rest."""
    settling = round(_SETTLING / trained_range.sample_time)
    noise = ENCODER * standard_normal(0, 0, np.arange(settling + _NOISE_ROWS + 1))
    return np.diff(noise) / trained_range.sample_time, trained_range.middle + noise[1:], settling


SLOWEST = 1e-3  # slowest steady speed, relative to the largest trained one
REACH = 1.5  # range outside the trained speeds and loads, relative to it
EXPLODES = 2.5  # limit over the largest trained torque; quadratic friction reaches 2.25
_STEADY = 1e6  # [s] step to steady sliding, even at the slowest speed
_POSITIONS = 32  # positions to average over
_NUMERICAL = 1e-9  # [N.m] round-off
_SMALL = 1e-6
_SMALLER = 1e-9  # [rad/s] distances from rest


@dataclass(frozen=True, kw_only=True)
class Audit:
    """Results of an audit."""

    driving: tuple[Range, ...]  # [rad/s] with steady torque tau dq < 0
    driving_both_ways: tuple[Range, ...]  # [rad/s] with tau(|dq|) < tau(-|dq|)
    generated: float  # [J] largest energy of a closed cycle
    generating: Cycle | None  # its cycle
    jump: float  # [N.m] across zero velocity
    slope: float | None  # [N.m.s/rad] d tau / d dq at rest; explicit steps <= 2 J / slope
    slope_of_step: float | None  # with moving states, for a velocity held over one sample
    chatter: float  # [N.m] standard deviation with noise `ENCODER`
    largest: float  # [N.m] within trained speeds and loads
    largest_outside: float | None  # up to `REACH` beyond; None if not finite
    explodes: bool


Run = Callable[[FrictionLaw, Array, Array, Array, Array], Array]  # torque for t, dq, q, load
Response = tuple[ClosedMotions, float, Array]  # motions, their constant load and the torque (A, K)


def audit(law: FrictionLaw, trained_range: TrainedRange) -> Audit:
    """Audit the law of one joint; raises SimulationError if its torque is not finite in range."""
    loads = loads_of(law, trained_range)
    found = list(responses(law, trained_range, np.multiply(AMPLITUDES, trained_range.speed), loads))
    largest = _largest(found)
    if not isfinite(largest):
        raise SimulationError(f"law '{law.name}': torque is not finite within the trained range.")
    outside = _largest_outside(law, trained_range)
    driving, both_ways = _steady(law, trained_range, loads)
    cycle = min((c for response in found for c in cycles(*response)), key=lambda c: c.work)
    generating = cycle if cycle.work < 0.0 else None
    jump, slope = _at_rest(law, trained_range, loads, 0.0)
    _, slope_of_step = _at_rest(law, trained_range, loads, trained_range.sample_time)
    dq, q, settling = encoder_noise(trained_range)
    t = trained_range.sample_time * np.arange(len(dq), dtype=float)
    resting = (_run(law, t, dq, q, np.full(t.shape, load))[settling:] for load in loads)
    return Audit(
        driving=driving,
        driving_both_ways=both_ways,
        generated=-generating.work if generating else 0.0,
        generating=generating,
        jump=jump,
        slope=slope,
        slope_of_step=slope_of_step,
        chatter=max(float(np.std(tau)) for tau in resting),
        largest=largest,
        largest_outside=max(largest, outside) if isfinite(outside) else None,
        explodes=_too_large(outside, trained_range),
    )


def explodes(law: FrictionLaw, trained_range: TrainedRange) -> bool:
    """Return True if |tau| just outside the trained range exceeds `EXPLODES` times its maximum."""
    return _too_large(_largest_outside(law, trained_range), trained_range)


def loads_of(
    law: FrictionLaw, trained_range: TrainedRange, reach: float = 1.0
) -> tuple[float, ...]:
    """Return the minimum, smallest and maximum load [N.m]; one if the law uses none."""
    low, high = trained_range.tau_load
    beyond = (reach - 1.0) * (high - low) / 2.0
    smallest = min(max(0.0, low), high)
    if TAU_LOAD not in law.form.inputs:
        return (smallest,)
    return tuple(sorted({low - beyond, smallest, high + beyond}))


def _run(law: FrictionLaw, t: Array, dq: Array, q: Array, load: Array) -> Array:
    """Predict without warnings: an overflow is a valid result."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return predict(law, t=t, dq=dq, q=q, tau_load=load)


def responses(
    law: FrictionLaw,
    trained_range: TrainedRange,
    amplitudes: Array,
    loads: Sequence[float],
    run: Run = _run,
) -> Iterator[Response]:
    """Yield responses to cycles of every frequency and load, all amplitudes in one run."""
    for wanted in FREQUENCIES:
        motions = closed_motions(trained_range, amplitudes, wanted)
        t: Array = trained_range.sample_time * np.arange(motions.dq.size, dtype=float)
        for load in loads:
            tau = run(law, t, motions.dq.ravel(), motions.q.ravel(), np.full(t.shape, load))
            yield motions, load, tau.reshape(motions.dq.shape)


def _largest(found: Sequence[Response]) -> float:
    return float(np.max([np.max(np.abs(tau[:, -motions.rows :])) for motions, _, tau in found]))


def _largest_outside(law: FrictionLaw, trained_range: TrainedRange) -> float:
    amplitudes = trained_range.speed * np.linspace(1.0, REACH, 3)
    try:
        return _largest(
            list(responses(law, trained_range, amplitudes, loads_of(law, trained_range, REACH)))
        )
    except SimulationError:
        return np.inf


def _too_large(torque: float, trained_range: TrainedRange) -> bool:
    # also True for NaN
    return not torque <= EXPLODES * max(map(abs, trained_range.tau))


def _steady(
    law: FrictionLaw, trained_range: TrainedRange, loads: Sequence[float]
) -> tuple[tuple[Range, ...], tuple[Range, ...]]:
    linear = np.linspace(0.0, 1.0, 121)[1:]
    slow = np.geomspace(SLOWEST, 1.0, 61)
    speeds = trained_range.speed * np.union1d(linear, slow)
    velocities = np.concatenate([-speeds[::-1], speeds])
    known = _POSITIONS if Q in law.form.inputs else 1
    # Multiples of the golden ratio avoid aliasing with ripple.
    places = trained_range.q[0] + np.ptp(trained_range.q) * (
        (0.5 + np.arange(known) * 0.6180339887) % 1.0
    )
    v, load, q = (
        part.ravel() for part in np.meshgrid(velocities, np.array(loads), places, indexing="ij")
    )
    # A very long exact step takes states to drive / rate; the first row has none.
    settled = replace(law, discretisation="exact")
    rows = np.concatenate([[0], np.arange(len(v))])
    t = _STEADY * np.arange(len(rows), dtype=float)
    tau = _run(settled, t, v[rows], q[rows], load[rows])[1:]
    tau = tau.reshape(len(velocities), len(loads), known).mean(axis=2)
    power = (tau * velocities[:, None]).min(axis=1)
    round_trip = (speeds[:, None] * (tau - tau[::-1])[len(speeds) :]).min(axis=1)
    return _negative(velocities, power), _negative(speeds, round_trip)


def _negative(v: Array, power: Array) -> tuple[Range, ...]:
    v = np.concatenate([[min(v[0], 0.0)], v, v[-1:]])
    power = np.pad(power, 1)
    k = np.flatnonzero(np.diff(power < 0.0)) + 1
    back = power[k] / (power[k] - power[k - 1])
    crossed = v[k] - back * (v[k] - v[k - 1])
    edges = np.where((v[k - 1] < 0.0) & (v[k] > 0.0), 0.0, crossed).tolist()
    return tuple(zip(edges[::2], edges[1::2], strict=True))


def _at_rest(
    law: FrictionLaw, trained_range: TrainedRange, loads: Sequence[float], dt: float
) -> tuple[float, float | None]:
    """Return (jump, slope) of the torque at rest over dt for the worst load, by differences."""
    t = np.array([0.0, dt])
    q = np.full(2, trained_range.middle)

    def difference(speed: float, load: float) -> float:
        loads = np.full(2, load)
        ends = [_run(law, t, np.array([0.0, v]), q, loads)[-1] for v in (speed, -speed)]
        return float(ends[0] - ends[1])

    near = max((difference(_SMALLER, load) for load in loads), key=abs)
    far = max((difference(_SMALL, load) for load in loads), key=abs)
    if abs(near) > max(0.5 * abs(far), _NUMERICAL):
        return near, None
    return 0.0, far / (2.0 * _SMALL)
