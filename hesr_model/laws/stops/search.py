"""Selection of bounds and viscous terms by errors on left-out logs."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.nonnegative import Normal, Products, blocks_of, pays
from hesr_model.fitting.ties import first_best, no_worse
from hesr_model.laws.stops.form import Structure
from hesr_model.laws.stops.terms import VISCOUS, columns, every, fixed, weights
from hesr_model.support.arrays import Array

SPEEDS = (0.05, 0.1, 0.2, 0.4)  # Stribeck velocities, relative to the largest speed
TIMES = (0.05, 0.1, 0.2, 0.4)  # [s] ageing times T
MORE = ("root", "plus", "minus")  # candidate bounds in addition to those of the skeleton
LEAST = 2e-3  # smallest relative force of a stop


@dataclass(frozen=True, kw_only=True, eq=False)
class Terms:
    """Bounds and viscous terms with their errors on left-out rows."""

    bounds: tuple[str, ...]  # each with a stop at every deflection
    numbers: dict[str, float]  # other coefficients
    samples: JointRows
    weights: Array  # (N,) 1 for rows that are used, else 0
    products: Products  # shared by trials
    cache: dict[str, Array] = field(default_factory=dict)  # weighted columns by bound

    @property
    def structure(self) -> Structure:
        """All terms of these bounds."""
        stops = tuple(stop for kind in self.bounds for stop in every(kind).stops)
        return Structure(stops=stops, viscous=VISCOUS)

    def _of(self, kind: str) -> Array:
        if kind not in self.cache:
            own = Structure(viscous=VISCOUS) if kind == "viscous" else every(kind)
            found = columns(own, self.numbers, self.samples)
            self.cache[kind] = self.weights[:, None] * found
        return self.cache[kind]

    @property
    def blocks(self) -> list[Array]:
        """Weighted columns of forces and offset."""
        self.cache.setdefault("offset", self.weights[:, None])
        return [self._of(kind) for kind in (*self.bounds, "viscous", "offset")]

    @cached_property
    def normal(self) -> Normal:
        """The least-squares problem."""
        return Normal(self.blocks, self.products, free=1)

    @cached_property
    def errors(self) -> Array:
        """(N,) errors on left-out rows [N.m]."""
        return self.normal.left_out()

    @property
    def cost(self) -> float:
        """Sum of squares on left-out rows [N^2.m^2]."""
        return float(self.errors @ self.errors)

    def at(self, v_s: float, time: float) -> "Terms":
        """Return the terms with another Stribeck velocity [rad/s] and ageing time [s]."""
        still = {k: c for k, c in self.cache.items() if k != "p"}
        numbers = self.numbers | {"v_s": v_s, "T": time}
        return replace(self, numbers=numbers, cache=still)

    def active(self) -> tuple[Structure, Array]:
        """Return the terms with a force, and their weighted columns with the offset last."""
        x = self.normal.solve()[:-1]
        whole = self.structure
        carried = x[: len(whole.stops)]
        enough = carried > LEAST * max(carried.sum(), np.finfo(float).tiny)
        flows = x[len(whole.stops) :] > 0.0
        chosen = Structure(
            stops=tuple(s for s, yes in zip(whole.stops, enough, strict=True) if yes),
            viscous=tuple(v for v, yes in zip(VISCOUS, flows, strict=True) if yes),
        )
        return chosen, np.hstack(self.blocks)[:, np.concatenate([enough, flows, [True]])]


def dictionary(samples: JointRows, *, load: bool) -> Terms:
    """Return the baseline: bounds of the skeleton with the best v_s and T."""
    speed = float(np.max(np.abs(samples.dq)))
    bounds = ("1", "p", "load") if load else ("1", "p")
    counted = weights(samples)
    first = Terms(
        bounds=bounds,
        numbers=fixed(samples),
        samples=samples,
        weights=counted,
        products=Products(samples.tau, samples.folds, counted),
    )
    trials = []
    for share, time in product(SPEEDS, TIMES):
        trials.append(first.at(share * speed, time))
        first.cache.update({k: c for k, c in trials[-1].cache.items() if k == "1"})
        trials[-1].cost  # noqa: B018 - fills the cache
        first.cache.update({k: c for k, c in trials[-1].cache.items() if k != "p"})
    return trials[first_best([trial.cost for trial in trials])]


def search(baseline: Terms, *, load: bool) -> Terms:
    """Return terms that predict left-out rows no worse than the baseline.

    Bounds are added if they gain more than a standard error, and removed if nothing is lost.
    """
    blocks = blocks_of(baseline.samples.dt, baseline.samples.begins)
    best = _thinned(baseline)
    for kind in MORE if load else ():
        more = replace(best, bounds=(*best.bounds, kind))
        if pays(best.errors, more.errors, blocks):
            best = _thinned(more)
    return best


def _thinned(terms: Terms) -> Terms:
    """Remove bounds, the last one first, that do not lower the error on left-out rows.

    The first one stays: short fast motion cannot separate Coulomb from viscous friction.
    """
    for kind in reversed(terms.bounds[1:]):
        fewer = replace(terms, bounds=tuple(k for k in terms.bounds if k != kind))
        if no_worse(fewer.cost, terms.cost):
            terms = fewer
    return terms
