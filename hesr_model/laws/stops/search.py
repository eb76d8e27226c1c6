"""Which bounds and viscous terms a joint has, by the errors on logs that are left out."""

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

SPEEDS = (0.05, 0.1, 0.2, 0.4)
"""Stribeck velocities that are tried, as shares of the largest speed."""
TIMES = (0.05, 0.1, 0.2, 0.4)
"""Ageing times T that are tried [s]."""
MORE = ("root", "plus", "minus")
"""Bounds that the search tries beside those of the skeleton."""
LEAST = 2e-3
"""A stop that carries less than this share of all is left out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Terms:
    """Bounds and viscous terms with their errors on left-out rows.

    Attributes
    ----------
    bounds : names, of which each has a stop at every deflection.
    numbers : of the coefficients that are not solved for, in their units.
    samples : rows of the joint.
    weights : (N,) 1 for rows that count.
    products : of columns, which trials share.
    kept : weighted columns of each bound that were computed already.
    """

    bounds: tuple[str, ...]
    numbers: dict[str, float]
    samples: JointRows
    weights: Array
    products: Products
    kept: dict[str, Array] = field(default_factory=dict)

    @property
    def structure(self) -> Structure:
        """The whole dictionary of these bounds."""
        stops = tuple(stop for kind in self.bounds for stop in every(kind).stops)
        return Structure(stops=stops, viscous=VISCOUS)

    def _of(self, kind: str) -> Array:
        if kind not in self.kept:
            own = Structure(viscous=VISCOUS) if kind == "viscous" else every(kind)
            found = columns(own, self.numbers, self.samples)
            self.kept[kind] = self.weights[:, None] * found
        return self.kept[kind]

    @property
    def blocks(self) -> list[Array]:
        """Columns of the forces, and the offset's, all weighted."""
        self.kept.setdefault("offset", self.weights[:, None])
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
        still = {k: c for k, c in self.kept.items() if k != "p"}
        numbers = self.numbers | {"v_s": v_s, "T": time}
        return replace(self, numbers=numbers, kept=still)

    def active(self) -> tuple[Structure, Array]:
        """Return the terms that carry something, and their weighted columns, the offset's last."""
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
    """Return the baseline: the skeleton's bounds, solved with signs, and the best v_s and T.

    Parameters
    ----------
    samples : rows of the joint.
    load : whether bounds may depend on the load.
    """
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
        first.kept.update({k: c for k, c in trials[-1].kept.items() if k == "1"})
        trials[-1].cost  # noqa: B018 - its columns serve the others
        first.kept.update({k: c for k, c in trials[-1].kept.items() if k != "p"})
    return trials[first_best([trial.cost for trial in trials])]


def search(baseline: Terms, *, load: bool) -> Terms:
    """Return terms that predict left-out rows no worse than the baseline.

    Bounds are added that pay by more than a standard error, and left out without loss.
    """
    blocks = blocks_of(baseline.samples.dt, baseline.samples.begins)
    best = _thinned(baseline)
    for kind in MORE if load else ():
        more = replace(best, bounds=(*best.bounds, kind))
        if pays(best.errors, more.errors, blocks):
            best = _thinned(more)
    return best


def _thinned(terms: Terms) -> Terms:
    """Return the terms without bounds, the last one first, that left-out rows do not miss.

    The first one stays: seconds of fast motion cannot tell Coulomb from viscous friction, and a law
    without it would let go at speed.
    """
    for kind in reversed(terms.bounds[1:]):
        fewer = replace(terms, bounds=tuple(k for k in terms.bounds if k != kind))
        if no_worse(fewer.cost, terms.cost):
            terms = fewer
    return terms
