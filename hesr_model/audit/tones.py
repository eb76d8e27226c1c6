"""Search for cycles of one, two and three tones that generate energy, by evolution.

A law may dissipate in every slow sine and still generate energy in small fast motion, or where one
motion rides on another: its states answer both at once. The tones are multiples of one frequency,
so that the path closes, up to half the sample rate of the training. The torque is summed over fine
steps, as a simulation would call the law.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Self

import numpy as np

from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import Q
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array, Integers, Mask

ROWS_PER_CYCLE = 64
_MULTIPLES = np.array(
    [
        *[(1, 0, 0), (4, 0, 0)],
        *[(1, 2, 0), (1, 3, 0), (2, 3, 0), (1, 4, 0)],
        *[(1, 2, 3), (1, 2, 4), (1, 3, 4)],
    ]
)
_LARGEST_MULTIPLE = 4
_LOWEST_FREQUENCY = 0.2  # [Hz] of the cycle
_AMPLITUDE_RANGE = 1e-3  # smallest amplitude over the trained speed
_FIRST_COUNT = 256  # cycles drawn at first
_ROUND_COUNT = 4
_PARENT_COUNT = 16
_CHILDREN = 8  # of each parent
_CYCLES = 8  # of a tried motion; the last one is judged
_CONFIRMING_CYCLES = 400  # energy of a start is released before
MIN_SHARE = 1e-6  # smallest share of the work that counts as generated
CYCLE_TOLERANCE = 0.05  # largest relative difference of the last two cycles
_CONFIRMED_COUNT = 4  # best cycles that are tried again for long
_STEP_OF_LOGARITHM = 0.5
_STEP_OF_PHASE = 0.7  # [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class ToneCycles:
    """P cycles dq = sum_k amplitudes_k cos(2 pi multiples_k f t + phases_k) at constant loads."""

    frequency: Array  # (P,) f [Hz]
    multiples: Integers  # (P, 3), 0 of an absent tone
    amplitudes: Array  # (P, 3) [rad/s; m/s]
    phases: Array  # (P, 3) [rad]
    tau_load: Array  # (P,) [N.m; N]

    def select(self, rows: Integers) -> Self:
        """Return some of the cycles."""
        return replace(self, **{name: values[rows] for name, values in vars(self).items()})

    def describe(self) -> str:
        """Return the velocity of the first cycle."""
        tones = [
            f"{amplitude:.3g} cos(2 pi {multiple * self.frequency[0]:.3g} t + {phase:.2f})"
            for multiple, amplitude, phase in zip(
                self.multiples[0], self.amplitudes[0], self.phases[0], strict=True
            )
            if multiple
        ]
        return " + ".join(tones)


def find_generating_cycle(
    law: FrictionLaw, trained_range: TrainedRange, loads: tuple[float, ...]
) -> tuple[ToneCycles | None, float, int]:
    """Return a cycle that keeps generating energy, its energy [J], and the number tried."""
    rng = np.random.default_rng(0)
    is_even = Q in law.form.inputs
    cycles = _draw_cycles(law, trained_range, loads, rng, is_even=is_even)
    shares, _ = judge_cycles(law, trained_range, cycles, _CYCLES)
    tried_count = len(shares)
    for _ in range(_ROUND_COUNT):
        parents = np.argsort(-shares, kind="stable")[:_PARENT_COUNT]
        children = _vary(cycles.select(np.repeat(parents, _CHILDREN)), trained_range, rng, is_even)
        child_shares, _ = judge_cycles(law, trained_range, children, _CYCLES)
        tried_count += len(child_shares)
        cycles = _join(cycles.select(parents), children)
        shares = np.concatenate([shares[parents], child_shares])
    for best in np.argsort(-shares, kind="stable")[:_CONFIRMED_COUNT]:
        if shares[best] <= 0.0:
            break
        cycle = cycles.select(np.array([best]))
        share, energy = judge_cycles(law, trained_range, cycle, _CONFIRMING_CYCLES)
        if share[0] > 0.0:
            return cycle, float(energy[0]), tried_count
    return None, 0.0, tried_count


def judge_cycles(
    law: FrictionLaw, trained_range: TrainedRange, cycles: ToneCycles, cycle_count: int
) -> tuple[Array, Array]:
    """Return the generated share (P,) of the exchanged work in the last cycle, and energy [J].

    The share is negative where the law dissipates, and where the last two cycles differ.
    """
    row_count = ROWS_PER_CYCLE * cycle_count
    turns = 2.0 * np.pi * np.arange(row_count) / ROWS_PER_CYCLE
    dt = 1.0 / (ROWS_PER_CYCLE * cycles.frequency)
    dq = np.zeros((len(dt), row_count))
    q = np.full((len(dt), row_count), trained_range.middle)
    for k in range(cycles.multiples.shape[1]):
        multiple = cycles.multiples[:, k, None]
        angle = multiple * turns + cycles.phases[:, k, None]
        amplitude = cycles.amplitudes[:, k, None]
        dq += amplitude * np.cos(angle)
        rate = 2.0 * np.pi * np.maximum(multiple, 1) * cycles.frequency[:, None]
        q += amplitude / rate * np.sin(angle)
    tau_load = np.repeat(cycles.tau_load, row_count)
    t = np.cumsum(np.repeat(dt, row_count))
    try:
        with np.errstate(all="ignore"):
            tau = predict(law, t=t, dq=dq.ravel(), q=q.ravel(), tau_load=tau_load)
    except SimulationError:
        return np.full(len(dt), -inf), np.zeros(len(dt))
    power = (tau.reshape(dq.shape) * dq * dt[:, None])[:, -2 * ROWS_PER_CYCLE :]
    works = power.reshape(len(dt), 2, ROWS_PER_CYCLE).sum(axis=2)
    exchanged = np.abs(power[:, -ROWS_PER_CYCLE:]).sum(axis=1)
    with np.errstate(all="ignore"):
        share = -works[:, 1] / exchanged
        is_repeated = np.abs(works[:, 1] - works[:, 0]) < CYCLE_TOLERANCE * np.abs(works[:, 1])
    is_generating = is_repeated & (share > MIN_SHARE)
    unsettled = np.where(share > 0.0, -MIN_SHARE, share)
    judged = np.where(is_generating, share, unsettled)
    return np.where(np.isfinite(judged), judged, -inf), -works[:, 1]


def _draw_cycles(
    law: FrictionLaw,
    trained_range: TrainedRange,
    loads: tuple[float, ...],
    rng: np.random.Generator,
    *,
    is_even: bool,
) -> ToneCycles:
    """Return the first cycles, spread over logarithms of frequency and amplitude."""
    # Tones up to half the sample rate of the training; Euler steps are at most those of training.
    highest = 0.5 / (_LARGEST_MULTIPLE * trained_range.sample_time)
    finest = 1.0 / (ROWS_PER_CYCLE * trained_range.sample_time)
    lowest = min(finest if law.discretisation == "euler" else _LOWEST_FREQUENCY, highest)
    multiples = _MULTIPLES[rng.integers(len(_MULTIPLES), size=_FIRST_COUNT)]
    shape = multiples.shape
    cycles = ToneCycles(
        frequency=lowest * (highest / lowest) ** rng.uniform(size=_FIRST_COUNT),
        multiples=multiples,
        amplitudes=trained_range.speed * _AMPLITUDE_RANGE ** rng.uniform(size=shape),
        phases=rng.uniform(-np.pi, np.pi, size=shape),
        tau_load=np.array(loads)[rng.integers(len(loads), size=_FIRST_COUNT)],
    )
    return _limit(cycles, trained_range, is_even=is_even)


def _vary(
    cycles: ToneCycles, trained_range: TrainedRange, rng: np.random.Generator, is_even: bool
) -> ToneCycles:
    """Return cycles with other amplitudes and phases, near those given."""
    shape = cycles.amplitudes.shape
    varied = replace(
        cycles,
        amplitudes=cycles.amplitudes * np.exp(_STEP_OF_LOGARITHM * rng.normal(size=shape)),
        phases=cycles.phases + _STEP_OF_PHASE * rng.normal(size=shape),
    )
    return _limit(varied, trained_range, is_even=is_even)


def _limit(cycles: ToneCycles, trained_range: TrainedRange, *, is_even: bool) -> ToneCycles:
    """Return cycles within the trained speed, without absent tones.

    Where the law depends on position, cycles are even in time, so that each position occurs at dq
    and at -dq: torques of position alone then do no work, also in a sum over rows.
    """
    is_present: Mask = cycles.multiples > 0
    amplitudes = np.where(is_present, cycles.amplitudes, 0.0)
    total = amplitudes.sum(axis=1, keepdims=True)
    amplitudes *= np.minimum(1.0, trained_range.speed / total)
    phases = np.where(is_present, cycles.phases, 0.0)
    if is_even:
        phases = np.where(is_present, np.copysign(np.pi / 2.0, phases), 0.0)
    return replace(cycles, amplitudes=amplitudes, phases=phases)


def _join(first: ToneCycles, second: ToneCycles) -> ToneCycles:
    parts = vars(second)
    return replace(
        first, **{name: np.concatenate([v, parts[name]]) for name, v in vars(first).items()}
    )
