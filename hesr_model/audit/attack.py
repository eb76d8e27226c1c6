"""Search for cycles with net energy: sines, pairs of speeds, moving loads, and several tones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hesr_model.audit.audit import AMPLITUDES, choose_loads, compute_responses, measure_cycles
from hesr_model.audit.tones import CYCLE_TOLERANCE, MIN_SHARE, find_generating_cycle
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array

ANGLES = (1e-5, 1e-4, 1e-3, 1e-2)  # [rad] with a moving load
PHASES = tuple(np.arange(8) * np.pi / 4.0)  # [rad] of the load
_CYCLES = 40
_FREQUENCY = 1.0  # [Hz]; the last two cycles must agree
_REVERSAL_DISTANCES = (1.0, 1e-2, 1e-4, 1e-6)  # [rad] between reversals
_ROWS_PER_DIRECTION = 100
_SPEED_PAIR_CYCLES = 4


@dataclass(frozen=True, kw_only=True)
class Attack:
    """A cycle dq = amplitude cos(2 pi f t) with the load mean + swing cos(4 pi f t + phase)."""

    energy: float  # [J] generated
    amplitude: float  # [rad/s]
    frequency: float  # [Hz]
    mean: float  # [N.m]
    swing: float = 0.0  # [N.m]
    phase: float = 0.0  # [rad]
    back: float | None = None  # [rad/s], constant speed of the return; then forward at `amplitude`
    tones: str = ""  # velocity of several tones [rad/s], instead of one of `amplitude`

    @property
    def text(self) -> str:
        """Description."""
        load = f"a load of {self.mean:.3g} N.m"
        if self.swing:
            load += f" + {self.swing:.3g} N.m cos(4 pi f t + {self.phase:.2f})"
        motion = f"{self.amplitude:.3g} rad/s cos(2 pi f t)"
        if self.tones:
            motion = f"({self.tones}) rad/s"
        if self.back:
            motion = f"{self.amplitude:.3g} rad/s forward and {self.back:.3g} rad/s backward"
        return f"{self.energy:.3g} J per cycle: dq = {motion}, f = {self.frequency:.3g} Hz, {load}"


def attack(
    law: FrictionLaw, trained_range: TrainedRange, speeds: Sequence[tuple[float, float]] = ()
) -> tuple[Attack | None, int]:
    """Return the cycle that generates the most energy, if any, and the number of cycles tried.

    `speeds` are pairs [rad/s] for both directions, tried until one generates energy. Cycles of
    several tones are tried if no other one generates energy.
    """
    attacks = [
        *_try_sine_cycles(law, trained_range),
        *_try_two_speed_cycles(law, trained_range, speeds),
    ]
    if TAU_LOAD in law.form.inputs:
        attacks += _try_loaded_cycles(law, trained_range)
    best = max(attacks, key=lambda a: a.energy)  # the first of equal ones
    if best.energy > 0.0:
        return best, len(attacks)
    tone_attack, tried_count = _try_tone_cycles(law, trained_range)
    return tone_attack, len(attacks) + tried_count


def _try_sine_cycles(law: FrictionLaw, trained_range: TrainedRange) -> Iterator[Attack]:
    amplitudes = np.multiply(AMPLITUDES, trained_range.speed)
    loads = choose_loads(law, trained_range)
    for response in compute_responses(law, trained_range, amplitudes, loads, _run):
        for cycle in measure_cycles(*response):
            energy = 0.0
            if cycle.share < -MIN_SHARE:
                energy = -cycle.work
            yield Attack(
                energy=energy,
                amplitude=cycle.amplitude,
                frequency=cycle.frequency,
                mean=cycle.tau_load,
            )


def _try_tone_cycles(law: FrictionLaw, trained_range: TrainedRange) -> tuple[Attack | None, int]:
    loads = choose_loads(law, trained_range)
    cycle, energy, tried_count = find_generating_cycle(law, trained_range, loads)
    if cycle is None:
        return None, tried_count
    tone_attack = Attack(
        energy=energy,
        amplitude=float(cycle.amplitudes.sum()),
        frequency=float(cycle.frequency[0]),
        mean=float(cycle.tau_load[0]),
        tones=cycle.describe(),
    )
    return tone_attack, tried_count


def _try_two_speed_cycles(
    law: FrictionLaw, trained_range: TrainedRange, speeds: Sequence[tuple[float, float]]
) -> Iterator[Attack]:
    tau_load = choose_loads(law, trained_range)[0]
    energy = 0.0
    for (forward_speed, backward_speed), distance in product(speeds, _REVERSAL_DISTANCES):
        if energy:
            break  # slower motion would generate slightly more
        dq = np.tile(
            np.repeat([forward_speed, -backward_speed], _ROWS_PER_DIRECTION), _SPEED_PAIR_CYCLES
        )
        dt = distance / _ROWS_PER_DIRECTION / np.abs(dq)
        q = trained_range.middle + np.cumsum(dq * dt)
        tau = _run(law, np.cumsum(dt), dq, q, np.full(dq.shape, tau_load))
        power = (tau * dq * dt).reshape(_SPEED_PAIR_CYCLES, -1)
        energy = _last_generated_energy(power[-1], power[-2])
        frequency = 1.0 / (distance / forward_speed + distance / backward_speed)
        yield Attack(
            energy=energy,
            amplitude=forward_speed,
            frequency=frequency,
            mean=tau_load,
            back=backward_speed,
        )


def _last_generated_energy(last_power: Array, previous_power: Array) -> float:
    """Return the energy generated in the last cycle if the last two agree, else 0."""
    work = last_power.sum()
    change = abs(work - previous_power.sum())
    generates = work < -MIN_SHARE * np.abs(last_power).sum()
    is_repeated = change < CYCLE_TOLERANCE * abs(work)
    if generates and is_repeated:
        return -float(work)
    return 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedMotion:
    """A small sine with a load at twice its frequency."""

    dq: Array  # (K,) [rad/s]
    q: Array  # (K,) [rad]
    load: Array  # (K,) [N.m]
    rows: int  # per cycle
    cycle: Attack  # without energy

    def compute_generated_energy(self, tau: Array) -> float:
        """Return the energy [J] generated by `tau` (K,) [N.m] in a settled last cycle, else 0."""
        power = tau * self.dq / (self.rows * self.cycle.frequency)
        return _last_generated_energy(power[-self.rows :], power[-2 * self.rows : -self.rows])


def loaded_motions(
    trained_range: TrainedRange,
    angles: Sequence[float] = ANGLES,
    phases: Sequence[float] = PHASES,
    cycle_count: int = _CYCLES,
) -> Iterator[LoadedMotion]:
    """Yield motions of `cycle_count` cycles with loads within the trained range."""
    rows = 2 * max(8, round(0.5 / (_FREQUENCY * trained_range.sample_time)))
    frequency = 1.0 / (rows * trained_range.sample_time)
    angle = 2.0 * np.pi * np.arange(rows * cycle_count, dtype=float) / rows
    swing = max(map(abs, trained_range.tau_load)) / 2.0
    base_cycle = Attack(energy=0.0, amplitude=0.0, frequency=frequency, mean=0.0, swing=swing)
    for deflection, phase, mean_load in product(angles, phases, (0.0, swing)):
        amplitude = deflection * 2.0 * np.pi * frequency
        yield LoadedMotion(
            dq=amplitude * np.cos(angle),
            q=trained_range.middle + deflection * np.sin(angle),
            load=mean_load + swing * np.cos(2.0 * angle + phase),
            rows=rows,
            cycle=replace(base_cycle, amplitude=amplitude, mean=mean_load, phase=float(phase)),
        )


def _try_loaded_cycles(law: FrictionLaw, trained_range: TrainedRange) -> Iterator[Attack]:
    for motion in loaded_motions(trained_range):
        t: Array = trained_range.sample_time * np.arange(len(motion.dq), dtype=float)
        energy = motion.compute_generated_energy(_run(law, t, motion.dq, motion.q, motion.load))
        yield replace(motion.cycle, energy=energy)


def _run(law: FrictionLaw, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
    with np.errstate(all="ignore"):
        try:
            return predict(law, t=t, dq=dq, q=q, tau_load=tau_load)
        except SimulationError:
            return np.full(t.shape, np.nan)
