"""Cycles on which a law may give energy: sines, also with a load that moves at twice their rate."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hesr_model.audit.audit import loads_of
from hesr_model.audit.cycles import AMPLITUDES, FREQUENCIES, closed_motions, cycles
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array

ANGLES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Amplitudes of motions with a moving load [rad]."""
PHASES = tuple(np.arange(8) * np.pi / 4.0)
"""Of the load's motion [rad]."""
_CYCLES, _FREQUENCY = 40, 1.0  # [Hz]; the last two count, which must agree
_LEAST, _ALIKE = 1e-6, 0.05  # share of the work that is no rounding; of two cycles


@dataclass(frozen=True, kw_only=True)
class Attack:
    """A cycle dq = amplitude cos(2 pi f t) with the load mean + swing cos(4 pi f t + phase).

    Attributes
    ----------
    energy : that the law gives in it [J].
    amplitude, frequency : of the velocity [rad/s], [Hz].
    mean, swing, phase : of the load [N.m], [N.m], [rad].
    """

    energy: float
    amplitude: float
    frequency: float
    mean: float
    swing: float = 0.0
    phase: float = 0.0

    @property
    def text(self) -> str:
        """The cycle in words."""
        load = f"a load of {self.mean:.3g} N.m"
        if self.swing:
            load += f" + {self.swing:.3g} N.m cos(4 pi f t + {self.phase:.2f})"
        return (
            f"{self.energy:.3g} J a cycle: dq = {self.amplitude:.3g} rad/s cos(2 pi f t), "
            f"f = {self.frequency:.3g} Hz, {load}"
        )


def attack(law: FrictionLaw, trained: TrainedRange) -> Attack | None:
    """Return the cycle that gives most energy, or None where none gives any.

    Parameters
    ----------
    law : of one joint.
    trained : ranges of speeds, loads and positions; its sample time counts.
    """
    found = [*_still(law, trained)]
    if TAU_LOAD in law.form.inputs:
        found += _moving(law, trained)
    return max(found, key=lambda a: a.energy, default=None)


def _still(law: FrictionLaw, trained: TrainedRange) -> list[Attack]:
    found = []
    for wanted, load in product(FREQUENCIES, loads_of(law, trained)):
        motions = closed_motions(trained, np.multiply(AMPLITUDES, trained.speed), wanted)
        t: Array = trained.sample_time * np.arange(motions.dq.size, dtype=float)
        tau = _run(law, t, motions.dq.ravel(), motions.q.ravel(), np.full(t.shape, load))
        found += [
            Attack(energy=-c.work, amplitude=c.amplitude, frequency=c.frequency, mean=load)
            for c in cycles(motions, load, tau.reshape(motions.dq.shape))
            if c.work < 0.0 and c.share < -_LEAST
        ]
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedMotion:
    """A small sine, and a load that moves at twice its rate, until it has settled.

    Attributes
    ----------
    dq, q, load : (K,) velocity [rad/s], position [rad] and load [N.m], a sample time apart.
    rows : of a cycle.
    cycle : what is known of it, without its energy.
    """

    dq: Array
    q: Array
    load: Array
    rows: int
    cycle: Attack

    def given(self, tau: Array) -> float:
        """Return the energy [J] that a torque (K,) [N.m] gives in the last cycle.

        It is 0 where the cycle before says otherwise, or where there is none but rounding.
        """
        power = tau * self.dq / (self.rows * self.cycle.frequency)
        last, before = power[-self.rows :].sum(), power[-2 * self.rows : -self.rows].sum()
        moved = np.abs(power[-self.rows :]).sum()
        settled = last < -_LEAST * moved and abs(last - before) < _ALIKE * abs(last)
        return -float(last) if settled else 0.0


def loaded_motions(
    trained: TrainedRange,
    angles: Sequence[float] = ANGLES,
    phases: Sequence[float] = PHASES,
    turns: int = _CYCLES,
) -> Iterator[LoadedMotion]:
    """Yield motions of several amplitudes [rad] and phases [rad] of the load, `turns` cycles each.

    Loads stay within those that were trained.
    """
    rows = 2 * max(8, round(0.5 / (_FREQUENCY * trained.sample_time)))
    frequency = 1.0 / (rows * trained.sample_time)
    angle = 2.0 * np.pi * np.arange(rows * turns, dtype=float) / rows
    swing = max(map(abs, trained.tau_load)) / 2.0
    for reach, phase, mean in product(angles, phases, (0.0, swing)):
        amplitude = reach * 2.0 * np.pi * frequency
        yield LoadedMotion(
            dq=amplitude * np.cos(angle),
            q=trained.middle + reach * np.sin(angle),
            load=mean + swing * np.cos(2.0 * angle + phase),
            rows=rows,
            cycle=Attack(
                energy=0.0, amplitude=amplitude, frequency=frequency,
                mean=mean, swing=swing, phase=float(phase),
            ),
        )  # fmt: skip


def _moving(law: FrictionLaw, trained: TrainedRange) -> Iterator[Attack]:
    for motion in loaded_motions(trained):
        t: Array = trained.sample_time * np.arange(len(motion.dq), dtype=float)
        energy = motion.given(_run(law, t, motion.dq, motion.q, motion.load))
        if energy > 0.0:
            yield replace(motion.cycle, energy=energy)


def _run(law: FrictionLaw, t: Array, dq: Array, q: Array, load: Array) -> Array:
    with np.errstate(all="ignore"):
        try:
            return predict(law, t=t, dq=dq, q=q, tau_load=load)
        except SimulationError:
            return np.full(t.shape, np.nan)
