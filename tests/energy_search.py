"""Search for energy from an exported friction FMU, through its public variables only.

A candidate is a closed path: a preparation, then the same segments of held inputs in `_ROUNDS`
rounds. The segments' speeds, lengths and loads are free, the path is closed in position, and the
candidates of a population follow each other in one instance, so that start states differ.

    law with a storage S   every round must take at least the change of S, from any state
    other laws             the last round must generate energy and end in the state it began with
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from fmu_src.friction.friction_component import GIVEN, START_MODE, STEADY, scale_names
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.audit.certificate import find_scale_limits, find_storage_factors
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.support.arrays import Array

STARTS, POPULATION = 100, 16  # of the optimiser
_SEGMENTS, _PARTS, _ROUNDS = 3, 6, 3
_STEPS = (-6.0, 1.0)  # log10 [s]
_SPEEDS = (-7.0, 4.0)  # log10 [rad/s]
_LOAD = 40.0  # [N.m]
_LARGEST = 100.0  # factor that stands for no limit


@dataclass(frozen=True, kw_only=True)
class Found:
    """The most energy that a search got from an FMU, and how."""

    share: float  # of the work and storage exchanged in the same round
    energy: float  # [J]
    scales: Mapping[str, float]
    rows: Array  # (K, 4): step [s], dq [rad/s], q [rad], load [N.m] of one round
    cases: int


@dataclass(kw_only=True)
class Target:
    """An FMU of one joint under attack."""

    component: FmuInstance
    law: FrictionLaw
    energies: Array | None  # k of k x^2 per state, of a proven law
    longest: float  # step [s]
    cases: int = 0
    best: tuple[float, float, Array] = field(default=(-np.inf, 0.0, np.zeros((0, 4))))

    def __post_init__(self) -> None:
        memory, output = self.law.form.memory, self.law.form.output
        self.states = [f"{m.name}[1]" for m in memory]
        self.damped = any(output.has(m.derivative) for m in memory)
        self._into = self.component.buffer([f"{u.name}[1]" for u in INPUTS])
        self._out = self.component.buffer(["tau[1]", *self.states])
        self._time = 0.0

    def start(self, scales: Mapping[str, float], rng: np.random.Generator) -> None:
        """Restart with scales and random states; those with damping are steady at some speed."""
        if self.component.used:
            self.component.reset()
        states = rng.normal(size=len(self.states)) * 10.0 ** rng.uniform(-6.0, 0.0)
        own = {name.replace("[", "_start["): x for name, x in zip(self.states, states, strict=True)}
        self._into.values[:] = _signed(rng.uniform(-1.0, 1.0)), 0.0, 0.0
        mode = {START_MODE: STEADY if self.damped else GIVEN}
        self.component.initialise(start={**mode, **scales, **own}, inputs=self._into)
        self._time = 0.0

    def shares(self, genes: Array) -> Array:
        """Return the share of energy that each candidate (G, P) gives, <= 0 if none."""
        paths = rows_of(genes, self.longest)
        count, rows, _ = paths.shape
        dt, inputs = paths[:, :, 0].ravel(), paths[:, :, 1:].reshape(-1, len(INPUTS))
        times = self._time + np.concatenate([[0.0], np.cumsum(dt)])
        found = step_rows(self.component, self._into, self._out, times[:-1], dt, inputs)
        self._time = float(times[-1])
        self.cases += count
        found = found.reshape(count, rows, -1)
        power = (found[:, 1:, 0] * paths[:, 1:, 1] * paths[:, 1:, 0]).reshape(count, _ROUNDS, -1)
        ends = found[:, :: _SEGMENTS * _PARTS, 1:]  # (P, rounds + 1, states)
        torque = np.abs(found[:, :, 0]).max(axis=1)
        share, energy = self._judged(power.sum(axis=2), np.abs(power).sum(axis=2), ends, torque)
        best = int(np.argmax(share))
        if share[best] > self.best[0]:
            self.best = float(share[best]), float(energy[best]), paths[best, -_SEGMENTS * _PARTS :]
        return share

    def _judged(self, work: Array, size: Array, ends: Array, torque: Array) -> tuple[Array, Array]:
        if self.energies is not None:
            stored = ends**2 @ self.energies
            given = np.diff(stored, axis=1) - work
            size = size + stored[:, 1:] + stored[:, :-1]
            share = given / np.maximum(size, 1e-300)
            worst = share.argmax(axis=1)[:, None]
            return share.max(axis=1), np.take_along_axis(given, worst, axis=1)[:, 0]
        # Deflections [rad] that have not returned may have stored the energy.
        released = 2.0 * torque * np.abs(ends[:, -1] - ends[:, -2]).sum(axis=1)
        given = -work[:, -1] - released
        return given / np.maximum(size[:, -1], 1e-300), given


def genes_of(segments: int = _SEGMENTS) -> Bounds:
    """Return the bounds of the genes: all are within -1 and 1."""
    count = 2 + 4 * segments
    return Bounds(-np.ones(count), np.ones(count))


def rows_of(genes: Array, longest: float) -> Array:
    """Return step, dq, q and load (P, K, 4) of candidates (G, P)."""
    prepared, place = genes[:2]
    speed, step, load, split = genes[2:].reshape(4, _SEGMENTS, -1)
    span = np.log10(longest) - _STEPS[0]
    v = _signed(speed)
    v[-1] = np.where(np.all(np.sign(v) == np.sign(v[:1]), axis=0), -v[-1], v[-1])
    dt = 10.0 ** (_STEPS[0] + span * (step + 1.0) / 2.0)
    # Parts of a segment are equal or, with a positive gene, ever shorter.
    weights = 10.0 ** (-np.arange(_PARTS)[:, None, None] * np.maximum(3.0 * split - 1.0, 0.0))
    parts = np.maximum(dt * weights, 10.0 ** _STEPS[0])
    moved = v * parts.sum(axis=0)
    ahead, back = np.maximum(moved, 0.0).sum(axis=0), np.maximum(-moved, 0.0).sum(axis=0)
    closed = np.minimum(ahead, back)
    v = v * np.where(v > 0.0, closed / ahead, closed / back)
    shape = (genes.shape[1], _SEGMENTS, _PARTS)
    one = np.zeros((*shape, 4))
    one[..., 0] = parts.transpose(2, 1, 0)
    one[..., 1] = v.T[:, :, None]
    one[..., 3] = (_LOAD * load.T**3)[:, :, None]
    one = one.reshape(len(one), -1, 4)
    rounds = np.tile(one, (1, _ROUNDS, 1))
    first = rounds[:, :1].copy()
    first[:, 0, 1] = _signed(prepared)
    rows = np.concatenate([first, rounds], axis=1)
    path = np.cumsum(one[:, :, 0] * one[:, :, 1], axis=1)
    path[:, -1] = 0.0
    rows[:, 1:, 2] = np.tile(path, (1, _ROUNDS))
    rows[:, :, 2] += np.pi * place[:, None]
    return rows


def _signed(gene: Array | float) -> Array:
    low, high = _SPEEDS
    return np.where(gene < 0.0, -1.0, 1.0) * 10.0 ** (low + (high - low) * np.abs(gene))


@contextmanager
def attacked(law: FrictionLaw, folder: Path, *, longest: float | None = 10.0) -> Iterator[Target]:
    """Export a law as an FMU of one joint and load it; `longest` is its largest certified step."""
    model = FrictionModel(
        law=law.name, robot="bench", joints=("j1",), laws=(law,), sample_time=0.01
    )
    fmu = export_bare(model, folder / f"{law.name}.fmu")
    energies = None
    if longest is not None:
        of_state = find_storage_factors(law)
        energies = np.array([of_state[m.name] for m in law.form.memory])
    with FmuInstance(fmu) as component:
        yield Target(
            component=component,
            law=law,
            energies=energies,
            longest=min(longest or 10.0, 10.0),
        )


def corners(law: FrictionLaw) -> list[dict[str, float]]:
    """Return the scales at their limits, and both at 1."""
    limits = find_scale_limits(law)
    ends = [(low, _LARGEST if high is None else high) for low, high in limits]
    chosen = [(1.0, 1.0), *((a, b) for a in ends[0] for b in ends[1])]
    return [dict(zip(scale_names(1), pair, strict=True)) for pair in chosen]


def search(
    target: Target,
    scales: Sequence[Mapping[str, float]],
    *,
    starts: int = STARTS,
    generations: int = 5,
    cases: int = 0,
    enough: float = np.inf,
) -> Found:
    """Run differential evolution from many starts, more if they converge before `cases`.

    It ends when a share exceeds `enough`.
    """
    used: Mapping[str, float] = {}
    bounds = genes_of()
    for seed in itertools.count():
        if seed >= starts and target.cases >= cases:
            break
        rng = np.random.default_rng(seed)
        before = target.best[0]
        chosen = scales[seed % len(scales)]
        target.start(chosen, rng)
        differential_evolution(
            lambda genes: -target.shares(genes),
            bounds,
            init=rng.uniform(-1.0, 1.0, (POPULATION, len(bounds.lb))),
            maxiter=generations,
            tol=0.0,
            polish=False,
            vectorized=True,
            updating="deferred",
            rng=rng,
        )
        if target.best[0] > before:
            used = chosen
        if target.best[0] > enough:
            break
    share, energy, rows = target.best
    return Found(share=share, energy=energy, scales=used, rows=rows, cases=target.cases)
