"""Selection of bounds and viscous terms by errors on left-out logs."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import compress, product

import numpy as np

from hesr_model.equations.recurrence import recurrence
from hesr_model.fitting import joint_rows
from hesr_model.fitting.joint_rows import FoldProducts, JointRows, NormalEquations
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.law import LawForm
from hesr_model.laws.stops import form as forms
from hesr_model.laws.stops.form import DEFLECTIONS, LOAD_SCALE, SHARES, THINNING, Structure
from hesr_model.support.arrays import Array

STRIBECK_SHARES = (0.05, 0.1, 0.2, 0.4)  # Stribeck velocities, of the largest speed
AGEING_TIMES = (0.05, 0.1, 0.2, 0.4)  # [s] ageing times T
EXTRA_BOUNDS = ("root", "plus", "minus")  # candidate bounds
MIN_FORCE_SHARE = 2e-3  # of the sum of forces
_UNBOUNDED = (1e-12, 1e12)
VISCOUS = ("1", "v", *SHARES)  # of f


def build_stops(kind: str, scale: int = 0) -> Structure:
    """Return all stops with one bound and the deflections of one of `DEFLECTION_SCALES`."""
    first = scale * len(DEFLECTIONS)
    return Structure(stops=tuple((kind, first + node) for node in range(len(DEFLECTIONS))))


def derive_scales(rows: JointRows) -> dict[str, float]:
    """Return the coefficients that follow from the largest load and speed of a joint."""
    load = float(np.max(np.abs(rows.tau_load)))
    speed = float(np.max(np.abs(rows.dq)))
    thinning_speeds = {THINNING[k].name: share * speed for k, share in SHARES.items()}
    if not load > 0.0:
        load = 1.0  # of a joint without load, whose bounds of the load are 0 at any scale
    return {LOAD_SCALE.name: load, **thinning_speeds}


def select_ageing_times(rows: JointRows) -> tuple[float, ...]:
    """Return the ageing times [s] up to a twelfth of the shortest left-out part."""
    shortest = min(float(rows.dt[fold].sum()) for fold in rows.folds)
    return tuple(time for time in AGEING_TIMES if 3.0 * time <= shortest / 4.0)


def weights(rows: JointRows, longest: float = 0.0) -> Array:
    """Return (N,) weights: 0 while the unknown initial state of a record matters, then 1.

    The deflections are forgotten after a distance, the age after three times the `longest` T [s].
    """
    row_weights = np.empty(len(rows.q))
    first = np.flatnonzero(rows.begins)
    for start, end in zip(first, [*first[1:], len(row_weights)], strict=True):
        q = rows.q[start:end]
        travel = np.maximum.accumulate(q) - np.minimum.accumulate(q)
        is_forgotten = travel > 2.0 * DEFLECTIONS[-1]
        elapsed = np.cumsum(rows.dt[start:end]) - rows.dt[start]
        row_weights[start:end] = (is_forgotten | ~is_forgotten.any()) & (elapsed >= 3.0 * longest)
    return row_weights


def find_largest_age(rows: JointRows, row_weights: Array, v_s: float, time: float) -> float:
    """Return the largest age of the rows with a weight (N,), rounded up to three digits."""
    decay = np.exp(-rows.dt / time)
    growth = (1.0 - decay) * np.exp(-((rows.dq / v_s) ** 2))
    decay = np.where(rows.begins, 0.0, decay)
    growth = np.where(rows.begins, 1.0, growth)
    return float(np.ceil(1e3 * np.max(recurrence(decay, growth, 1.0) * row_weights)) / 1e3)


def columns(structure: Structure, numbers: Mapping[str, float], rows: JointRows) -> Array:
    """Return the (N, K) columns [N.m per unit] of a structure's forces and waves."""
    form, space = _pose(structure)
    problem = Separable(form, space, rows, start=forms.build_rest_states(form))
    return problem.columns(problem.point({name: numbers[name] for name in space.names}))[:, :-1]


@lru_cache(maxsize=64)
def _pose(structure: Structure) -> tuple[LawForm, SearchSpace]:
    form = structure.form()
    linear = (*structure.forces, *structure.waves, "tau_0")
    free_bounds = tuple(
        (quantity.name, _UNBOUNDED) for quantity in form.coefficients if quantity.name not in linear
    )
    return form, SearchSpace(bounds=free_bounds, linear=linear)


@dataclass(frozen=True, kw_only=True, eq=False)
class Terms:
    """Bounds and viscous terms with their errors on left-out rows."""

    bounds: tuple[str, ...]  # each with a stop at every deflection
    numbers: dict[str, float]  # other coefficients
    rows: JointRows
    weights: Array  # (N,) 1 or 0
    products: FoldProducts  # shared by trials
    scale: int = 0  # place of the deflections' scale in `DEFLECTION_SCALES`
    cache: dict[str, Array] = field(default_factory=dict)  # weighted columns by bound

    @property
    def structure(self) -> Structure:
        """All terms of these bounds."""
        stops: list[tuple[str, int]] = []
        for kind in self.bounds:
            stops += build_stops(kind, self.scale).stops
        return Structure(stops=tuple(stops), viscous=VISCOUS)

    def _weighted_columns(self, kind: str) -> Array:
        if kind in self.cache:
            return self.cache[kind]
        structure = Structure(viscous=VISCOUS)
        if kind != "viscous":
            structure = build_stops(kind, self.scale)
        self.cache[kind] = self.weights[:, None] * columns(structure, self.numbers, self.rows)
        return self.cache[kind]

    @property
    def blocks(self) -> list[Array]:
        """Weighted columns of forces and offset."""
        self.cache.setdefault("offset", self.weights[:, None])
        return [self._weighted_columns(kind) for kind in (*self.bounds, "viscous", "offset")]

    @cached_property
    def normal(self) -> NormalEquations:
        """The least-squares problem."""
        return NormalEquations(self.blocks, self.products, free=1)

    @cached_property
    def errors(self) -> Array:
        """(N,) errors on left-out rows [N.m]."""
        return self.normal.cross_validate()

    @property
    def cost(self) -> float:
        """Sum of squares on left-out rows [N^2.m^2]."""
        return float(self.errors @ self.errors)

    def replace_age(self, v_s: float, time: float) -> "Terms":
        """Return the terms with another Stribeck velocity [rad/s] and ageing time [s]."""
        other_columns = {
            kind: kind_columns for kind, kind_columns in self.cache.items() if kind != "age"
        }
        largest_age = find_largest_age(self.rows, self.weights, v_s, time)
        numbers = self.numbers | {"v_s": v_s, "T": time, "P": largest_age}
        return replace(self, numbers=numbers, cache=other_columns)

    def select_active(self) -> tuple[Structure, Array]:
        """Return the terms with a force, and their weighted columns with the offset last."""
        x = self.normal.solve()[:-1]
        full_structure = self.structure
        stop_forces = x[: len(full_structure.stops)]
        is_loaded = stop_forces > MIN_FORCE_SHARE * max(stop_forces.sum(), np.finfo(float).tiny)
        is_viscous = x[len(full_structure.stops) :] > 0.0
        chosen = Structure(
            stops=tuple(compress(full_structure.stops, is_loaded)),
            viscous=tuple(compress(VISCOUS, is_viscous)),
        )
        return chosen, np.hstack(self.blocks)[:, np.concatenate([is_loaded, is_viscous, [True]])]


def build_dictionary(rows: JointRows, *, load: bool, scale: int = 0) -> Terms:
    """Return the bounds of the skeleton with the best v_s and T, at a scale of deflections."""
    speed = float(np.max(np.abs(rows.dq)))
    ageing = select_ageing_times(rows)
    row_weights = weights(rows, max(ageing, default=0.0))
    first_bounds = ["1"]
    if ageing:
        first_bounds.append("age")
    if load:
        first_bounds.append("load")
    first_terms = Terms(
        bounds=tuple(first_bounds),
        numbers=derive_scales(rows),
        rows=rows,
        weights=row_weights,
        products=FoldProducts(rows.tau, rows.folds, row_weights),
        scale=scale,
    )
    if not ageing:
        return first_terms
    trials = []
    costs = []
    for share, time in product(STRIBECK_SHARES, ageing):
        trial = first_terms.replace_age(share * speed, time)
        trials.append(trial)
        costs.append(trial.cost)  # fills the cache, of which the age alone differs between trials
        for kind, kind_columns in trial.cache.items():
            if kind != "age":
                first_terms.cache[kind] = kind_columns
    return trials[joint_rows.find_first_best(costs)]


def search(baseline: Terms, *, load: bool) -> Terms:
    """Add bounds that gain more than a standard error on left-out rows; remove useless ones."""
    blocks = joint_rows.divide_into_blocks(baseline.rows.dt, baseline.rows.begins)
    best_terms = _remove_useless_bounds(baseline)
    if not load:
        return best_terms  # all further bounds are of the load
    for kind in EXTRA_BOUNDS:
        extended_terms = replace(best_terms, bounds=(*best_terms.bounds, kind))
        if joint_rows.has_significant_gain(best_terms.errors, extended_terms.errors, blocks):
            best_terms = _remove_useless_bounds(extended_terms)
    return best_terms


def _remove_useless_bounds(terms: Terms) -> Terms:
    for kind in reversed(terms.bounds[1:]):
        reduced_terms = replace(terms, bounds=tuple(k for k in terms.bounds if k != kind))
        if joint_rows.is_no_worse(reduced_terms.cost, terms.cost):
            terms = reduced_terms
    return terms
