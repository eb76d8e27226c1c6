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
ENCODER_NOISE = 20e-6  # [rad] RMS noise
_SETTLING_TIME = 3.0  # [s] several time constants
_NOISE_ROWS = 4000
_WORK_ROUND_OFF = 1e-9  # of the work


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


def closed_motions(
    trained_range: TrainedRange, amplitudes: Array, target_frequency: float
) -> ClosedMotions:
    """Return motions at about `target_frequency` [Hz] for amplitudes (A,) [rad/s].

    Each position occurs once at dq and once at -dq, so torques of position alone do zero work.
    """
    half_rows = max(4, round(0.5 / (target_frequency * trained_range.sample_time)))
    settling_rows = half_rows * max(1, round(2.0 * target_frequency * _SETTLING_TIME))
    phase = np.pi / half_rows * np.arange(-settling_rows, 2 * half_rows)
    frequency = 0.5 / (half_rows * trained_range.sample_time)
    reach = amplitudes[:, None] / (2.0 * np.pi * frequency)
    return ClosedMotions(
        amplitudes=amplitudes,
        frequency=frequency,
        rows=2 * half_rows,
        dq=amplitudes[:, None] * np.cos(phase),
        q=trained_range.middle + reach * np.sin(phase),
    )


def measure_cycles(motions: ClosedMotions, tau_load: float, tau: Array) -> Iterator[Cycle]:
    """Yield the work of `tau` (A, K) [N.m] in the last cycle of each amplitude."""
    dt = 1.0 / (motions.frequency * motions.rows)
    power = (tau * motions.dq)[:, -motions.rows :]
    for amplitude, row_power in zip(motions.amplitudes, power, strict=True):
        work = float(row_power.sum()) * dt
        exchanged_work = float(np.abs(row_power).sum()) * dt
        share = 0.0
        if exchanged_work > 0.0:
            share = work / exchanged_work
        if abs(share) < _WORK_ROUND_OFF:
            work = 0.0
            share = 0.0
        yield Cycle(
            amplitude=float(amplitude),
            frequency=motions.frequency,
            tau_load=tau_load,
            work=work,
            share=share,
        )


def encoder_noise(trained_range: TrainedRange) -> tuple[Array, Array, int]:
    """Return velocity (K,) [rad/s], position (K,) [rad] and settling rows of a noisy rest."""
    settling = round(_SETTLING_TIME / trained_range.sample_time)
    noise = ENCODER_NOISE * standard_normal(0, 0, np.arange(settling + _NOISE_ROWS + 1))
    return np.diff(noise) / trained_range.sample_time, trained_range.middle + noise[1:], settling


SLOWEST_SPEED = 1e-3  # slowest steady speed, relative to the largest trained one
REACH = 1.5  # range outside the trained speeds and loads, relative to it
EXPLOSION_RATIO = 2.5  # limit over the largest trained torque; quadratic friction reaches 2.25
_STEADY_STEP = 1e6  # [s] step to steady sliding, even at the slowest speed
_POSITION_COUNT = 32  # positions to average over
_TORQUE_ROUND_OFF = 1e-9  # [N.m] round-off
_FAR_SPEED = 1e-6  # [rad/s] a slope shows here
_NEAR_SPEED = 1e-9  # [rad/s] a jump alone remains here


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
    chatter: float  # [N.m] standard deviation with noise `ENCODER_NOISE`
    largest: float  # [N.m] within trained speeds and loads
    largest_outside: float | None  # up to `REACH` beyond; None if not finite
    explodes: bool


Run = Callable[[FrictionLaw, Array, Array, Array, Array], Array]  # torque for t, dq, q, load
Response = tuple[ClosedMotions, float, Array]  # motions, their constant load and the torque (A, K)


def audit(law: FrictionLaw, trained_range: TrainedRange) -> Audit:
    """Audit the law of one joint; raises SimulationError if its torque is not finite in range."""
    loads = choose_loads(law, trained_range)
    amplitudes = np.multiply(AMPLITUDES, trained_range.speed)
    responses = list(compute_responses(law, trained_range, amplitudes, loads))
    largest = _find_largest_torque(responses)
    if not isfinite(largest):
        raise SimulationError(f"law '{law.name}': torque is not finite within the trained range.")
    outside = _extrapolate_largest_torque(law, trained_range)
    largest_outside = None
    if isfinite(outside):
        largest_outside = max(largest, outside)
    driving, driving_both_ways = _find_driving_speeds(law, trained_range, loads)
    cycles: list[Cycle] = []
    for response in responses:
        cycles += measure_cycles(*response)
    worst_cycle = min(cycles, key=lambda cycle: cycle.work)
    generating = None
    generated = 0.0
    if worst_cycle.work < 0.0:
        generating = worst_cycle
        generated = -worst_cycle.work
    jump, slope = _measure_jump_and_slope(law, trained_range, loads, 0.0)
    _, slope_of_step = _measure_jump_and_slope(law, trained_range, loads, trained_range.sample_time)
    return Audit(
        driving=driving,
        driving_both_ways=driving_both_ways,
        generated=generated,
        generating=generating,
        jump=jump,
        slope=slope,
        slope_of_step=slope_of_step,
        chatter=_measure_chatter(law, trained_range, loads),
        largest=largest,
        largest_outside=largest_outside,
        explodes=_is_too_large(outside, trained_range),
    )


def _measure_chatter(
    law: FrictionLaw, trained_range: TrainedRange, loads: Sequence[float]
) -> float:
    """Return the largest deviation of the torque [N.m] at a noisy rest."""
    dq, q, settling_rows = encoder_noise(trained_range)
    t = trained_range.sample_time * np.arange(len(dq), dtype=float)
    deviations = []
    for tau_load in loads:
        tau = _run(law, t, dq, q, np.full(t.shape, tau_load))
        deviations.append(float(np.std(tau[settling_rows:])))
    return max(deviations)


def explodes(law: FrictionLaw, trained_range: TrainedRange) -> bool:
    """Return whether |tau| just outside the trained range exceeds `EXPLOSION_RATIO` maxima."""
    return _is_too_large(_extrapolate_largest_torque(law, trained_range), trained_range)


def choose_loads(
    law: FrictionLaw, trained_range: TrainedRange, reach: float = 1.0
) -> tuple[float, ...]:
    """Return the minimum, smallest and maximum load [N.m]; one if the law uses none."""
    lowest, highest = trained_range.tau_load
    margin = (reach - 1.0) * (highest - lowest) / 2.0
    smallest = min(max(0.0, lowest), highest)
    if TAU_LOAD not in law.form.inputs:
        return (smallest,)
    return tuple(sorted({lowest - margin, smallest, highest + margin}))


def _run(law: FrictionLaw, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
    """Predict without warnings: an overflow is a valid result."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return predict(law, t=t, dq=dq, q=q, tau_load=tau_load)


def compute_responses(
    law: FrictionLaw,
    trained_range: TrainedRange,
    amplitudes: Array,
    loads: Sequence[float],
    run: Run = _run,
) -> Iterator[Response]:
    """Yield responses to cycles of every frequency and load, all amplitudes in one run."""
    for frequency in FREQUENCIES:
        motions = closed_motions(trained_range, amplitudes, frequency)
        t: Array = trained_range.sample_time * np.arange(motions.dq.size, dtype=float)
        for tau_load in loads:
            tau = run(law, t, motions.dq.ravel(), motions.q.ravel(), np.full(t.shape, tau_load))
            yield motions, tau_load, tau.reshape(motions.dq.shape)


def _find_largest_torque(motion_responses: Sequence[Response]) -> float:
    return float(
        np.max([np.max(np.abs(tau[:, -motions.rows :])) for motions, _, tau in motion_responses])
    )


def _extrapolate_largest_torque(law: FrictionLaw, trained_range: TrainedRange) -> float:
    amplitudes = trained_range.speed * np.linspace(1.0, REACH, 3)
    loads = choose_loads(law, trained_range, REACH)
    try:
        responses = list(compute_responses(law, trained_range, amplitudes, loads))
    except SimulationError:
        return np.inf
    return _find_largest_torque(responses)


def _is_too_large(torque: float, trained_range: TrainedRange) -> bool:
    # also True for NaN
    return not torque <= EXPLOSION_RATIO * max(map(abs, trained_range.tau))


def _find_driving_speeds(
    law: FrictionLaw, trained_range: TrainedRange, loads: Sequence[float]
) -> tuple[tuple[Range, ...], tuple[Range, ...]]:
    linear = np.linspace(0.0, 1.0, 121)[1:]
    slow = np.geomspace(SLOWEST_SPEED, 1.0, 61)
    speeds = trained_range.speed * np.union1d(linear, slow)
    velocities = np.concatenate([-speeds[::-1], speeds])
    position_count = 1
    if Q in law.form.inputs:
        position_count = _POSITION_COUNT
    # Multiples of the golden ratio avoid aliasing with ripple.
    shares = (0.5 + np.arange(position_count) * 0.6180339887) % 1.0
    positions = trained_range.q[0] + np.ptp(trained_range.q) * shares
    dq, tau_load, q = (
        axis.ravel() for axis in np.meshgrid(velocities, np.array(loads), positions, indexing="ij")
    )
    # A very long exact step takes states to drive / rate; the first row has none.
    exact_law = replace(law, discretisation="exact")
    rows = np.concatenate([[0], np.arange(len(dq))])
    t = _STEADY_STEP * np.arange(len(rows), dtype=float)
    tau = _run(exact_law, t, dq[rows], q[rows], tau_load[rows])[1:]
    tau = tau.reshape(len(velocities), len(loads), position_count).mean(axis=2)
    power = (tau * velocities[:, None]).min(axis=1)
    round_trip = (speeds[:, None] * (tau - tau[::-1])[len(speeds) :]).min(axis=1)
    return _find_negative_ranges(velocities, power), _find_negative_ranges(speeds, round_trip)


def _find_negative_ranges(velocities: Array, power: Array) -> tuple[Range, ...]:
    velocities = np.concatenate([[min(velocities[0], 0.0)], velocities, velocities[-1:]])
    power = np.pad(power, 1)
    k = np.flatnonzero(np.diff(power < 0.0)) + 1
    fraction = power[k] / (power[k] - power[k - 1])
    crossings = velocities[k] - fraction * (velocities[k] - velocities[k - 1])
    edges = np.where((velocities[k - 1] < 0.0) & (velocities[k] > 0.0), 0.0, crossings).tolist()
    return tuple(zip(edges[::2], edges[1::2], strict=True))


def _measure_jump_and_slope(
    law: FrictionLaw, trained_range: TrainedRange, loads: Sequence[float], dt: float
) -> tuple[float, float | None]:
    """Return (jump, slope) of the torque at rest over dt for the worst load, by differences."""
    t = np.array([0.0, dt])
    q = np.full(2, trained_range.middle)

    def difference(speed: float, tau_load: float) -> float:
        constant_load = np.full(2, tau_load)
        forward_torque = _run(law, t, np.array([0.0, speed]), q, constant_load)[-1]
        backward_torque = _run(law, t, np.array([0.0, -speed]), q, constant_load)[-1]
        return float(forward_torque - backward_torque)

    near_difference = max((difference(_NEAR_SPEED, tau_load) for tau_load in loads), key=abs)
    far_difference = max((difference(_FAR_SPEED, tau_load) for tau_load in loads), key=abs)
    if abs(near_difference) > max(0.5 * abs(far_difference), _TORQUE_ROUND_OFF):
        return near_difference, None
    return 0.0, far_difference / (2.0 * _FAR_SPEED)
