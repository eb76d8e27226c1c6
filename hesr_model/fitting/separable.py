"""Separable least squares of laws linear in most coefficients (Golub and Pereyra 1973)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
import scipy
import sympy

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Discretisation, find_read_symbols
from hesr_model.fitting.joint_rows import (
    JointRows,
    find_first_best,
    is_no_worse,
    non_negative_least_squares,
    to_slice,
)
from hesr_model.fitting.local_search import search_locally
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.progress import step


@dataclass(frozen=True, kw_only=True)
class SearchSpace:
    """Search space of the coefficients of a form.

    Attributes
    ----------
    bounds : name and bounds of each searched number; the scale of positive
        bounds is logarithmic.
    linear : names of the unknowns to solve for; the first `non_negative` must
        not be negative.
    values : expressions of all other coefficients.
    """

    bounds: tuple[tuple[str, tuple[float, float]], ...]
    linear: tuple[str, ...]
    non_negative: int = 0
    values: tuple[tuple[str, sympy.Expr], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the searched numbers."""
        return tuple(name for name, _ in self.bounds)

    def scale_to_joint(self, *, is_prismatic: bool) -> Self:
        """Return the space of a joint, whose lengths in m may be a hundredth of those in rad."""
        if not is_prismatic:
            return self
        bounds = []
        for name, (lower, upper) in self.bounds:
            if name in _LENGTHS:
                lower *= FINEST_SCALE
            bounds.append((name, (lower, upper)))
        return replace(self, bounds=tuple(bounds))


FINEST_SCALE = 0.01  # smallest scale of a sliding joint's lengths
_LENGTHS = {"deflection", "v_s", "v_t", "x_0"}  # searched numbers [rad, rad/s; m, m/s]
_SPEEDS = {"v_s", "v_t"}  # those of them that are speeds, over which friction falls or rises
# The slowest row over the smallest speed that is searched: exp(-4) = 2 % of a rise is left there.
_SLOWEST_TO_SPEED = 2.0
MIN_COEFFICIENT = 1e-9  # [its unit] of a non-negative coefficient that scales others
_WEAK_RISE = 1e-3  # relative rise of the cost that a number with hardly an effect causes
_WEAK_VALUES = 5  # tried of such a number; searched velocities span three decades
_SAME_VALUE_SHARE = 1e-3  # share of the range


def _limit_speed(name: str, limits: tuple[float, float], dq: Array) -> tuple[float, float]:
    """Return the bounds of a searched number, without speeds too small for the rows to show.

    A log at constant speeds has no slow row. If friction fell within 1 mrad/s, only round-off of
    its fall would be left at the speeds `dq` (N,), and the fit would find a static level of
    1e150 N.m.
    """
    lower, upper = limits
    if name not in _SPEEDS:
        return lower, upper
    slowest = float(np.min(np.abs(dq), initial=np.inf))
    smallest_speed = np.clip(slowest / _SLOWEST_TO_SPEED, lower, upper / _SLOWEST_TO_SPEED)
    return float(smallest_speed), upper


class Separable:
    """The least-squares problem of a form on the rows of a joint.

    A point has the searched numbers, logarithms where bounds are positive; `start` has the states
    at rest, 0 by default.
    """

    def __init__(
        self,
        form: LawForm,
        space: SearchSpace,
        rows: JointRows,
        discretisation: Discretisation = "exact",
        start: Sequence[float] = (),
    ) -> None:
        self.start = tuple(start) or (0.0,) * len(form.memory)
        self.discretisation = discretisation
        self.form = form
        self.space = space
        self.rows = rows
        self._kernel = _build_kernel(form, space)
        limits = np.array(
            [_limit_speed(name, limits, rows.dq) for name, limits in space.bounds]
        ).reshape(-1, 2)
        self._is_logarithmic = limits[:, 0] > 0.0
        scaled = np.log(np.maximum(limits, 1e-300))
        self.bounds = np.where(self._is_logarithmic[:, None], scaled, limits)

    def numbers(self, point: Array) -> Array:
        """Return the searched numbers of a point, in the units of the coefficients."""
        return np.where(
            self._is_logarithmic, np.exp(np.where(self._is_logarithmic, point, 0.0)), point
        )

    def name_numbers(self, point: Array) -> dict[str, float]:
        """Return the searched numbers of a point by name."""
        return dict(zip(self.space.names, map(float, self.numbers(point)), strict=True))

    def point(self, numbers: Mapping[str, float]) -> Array:
        """Return the point of searched numbers, moved inside the bounds."""
        values = np.array([numbers[name] for name in self.space.names])
        scaled = np.where(
            self._is_logarithmic, np.log(np.where(self._is_logarithmic, values, 1.0)), values
        )
        lower, upper = self.bounds.T
        margin = 1e-9 * (upper - lower)
        return np.clip(scaled, lower + margin, upper - margin)

    def columns(self, point: Array) -> Array:
        """Return the (N, len(linear)) columns of the torque at a point [N.m per unit of each]."""
        return self._run.evaluate(self.numbers(point)).copy(order="F")

    @cached_property
    def _run(self) -> KernelRun:
        rows = self.rows
        euler = self.discretisation == "euler"
        return KernelRun(
            self._kernel,
            (rows.dq, rows.q, rows.tau_load),
            rows.dt,
            np.flatnonzero(rows.begins),
            euler=euler,
            start=self.start,
            target=rows.tau,
        )

    def solve(self, point: Array) -> tuple[Array, float]:
        """Return (len(linear),) unknowns at a point and the sum of squared residuals [N^2.m^2]."""
        non_negative = self.space.non_negative
        solution = self._run.fit_factors(self.numbers(point), non_negative=non_negative)
        if solution is not None:
            return solution
        return non_negative_least_squares(
            self.columns(point), self.rows.tau, non_negative=non_negative
        )

    def _residual(self, point: Array, weights: Array | None) -> Array:
        non_negative = self.space.non_negative
        tau = self.rows.tau
        solution = self._run.fit_factors(
            self.numbers(point), non_negative=non_negative, weights=weights, keep=True
        )
        if solution is not None:
            return np.asarray(self._run.results @ solution[0] - tau)
        columns = self._run.results
        row_weights = weights
        if row_weights is None:
            row_weights = np.ones_like(tau)
        x, _ = non_negative_least_squares(
            row_weights[:, None] * columns, row_weights * tau, non_negative=non_negative
        )
        return np.asarray(columns @ x - tau)

    def search(self, rng: np.random.Generator, *, effort: int = 40) -> Array:
        """Return the best point of differential evolution with at most `effort` generations."""
        if not len(self.bounds):
            return np.zeros(0)
        generations = iter(range(1, effort + 2))

        def report(*_: object) -> None:
            step(next(generations, effort), effort + 1)

        best = scipy.optimize.differential_evolution(
            lambda point: self.solve(point)[1],
            self.bounds,
            rng=rng,
            popsize=10,
            maxiter=effort,
            tol=1e-4,
            callback=report,
        )
        return np.asarray(best.x)

    def polish(self, point: Array, *, evaluations: int = 12, is_used: Mask | None = None) -> Array:
        """Return the point after a local search, with linear unknowns solved.

        `is_used` (N,) is a mask of the rows, by default all.
        """
        if not len(self.bounds):
            return point
        weights = None
        used_rows: Mask | slice = slice(None)
        if is_used is not None:
            weights = is_used.astype(float)
            used_rows = is_used

        def residual(trial: Array) -> Array:
            return self._residual(trial, weights)[used_rows]

        lower, upper = self.bounds.T
        tau = self.rows.tau[used_rows]
        result = search_locally(
            residual,
            point,
            bounds=(lower, upper),
            scale=upper - lower,
            magnitude=float(np.linalg.norm(tau)),
            evaluations=evaluations,
        )
        return np.asarray(result.x)

    def polish_from_corners(self, point: Array) -> Array:
        """Return the point after local searches, also from where numbers hardly have an effect.

        Where F_s = F_c, v_s has none, and its value decides whether a higher F_s is found. At the
        smallest v_s no row is slow enough for F_s to matter.
        """
        point = self.polish(point, evaluations=40)
        cost = self.solve(point)[1]
        starts = []
        for corner in (point, *self._vary(point, cost, 2)):
            starts += self._vary(corner, cost, _WEAK_VALUES)
        points = [point, *(self.polish(start, evaluations=40) for start in starts)]
        return points[find_first_best([self.solve(candidate)[1] for candidate in points])]

    def _vary(self, point: Array, cost: float, value_count: int) -> list[Array]:
        """Return points with one number changed, whose cost hardly exceeds `cost`.

        The numbers take `value_count` values, the bounds included.
        """
        points = []
        for k, (lower, upper) in enumerate(self.bounds):
            for value in np.linspace(upper, lower, value_count):
                trial = point.copy()
                trial[k] = value
                is_near = abs(value - point[k]) < _SAME_VALUE_SHARE * (upper - lower)
                if not is_near and is_no_worse(self.solve(trial)[1], cost, _WEAK_RISE):
                    points.append(trial)
        return points

    def values(self, point: Array, unknowns: Array) -> dict[str, float]:
        """Return all coefficients of the form by name, from a point and the unknowns of `solve`."""
        known_values = self.name_numbers(point)
        known_values |= zip(self.space.linear, unknowns, strict=True)
        # Ratios of coefficients that are multiples of 0 would be 0 / 0.
        divisor_names = set()
        for _, expression in self.space.values:
            divisor_names |= {symbol.name for symbol in expression.free_symbols}
        for name in divisor_names & set(self.space.linear[: self.space.non_negative]):
            known_values[name] = max(known_values[name], MIN_COEFFICIENT)
        symbols = {sympy.Symbol(name, real=True): value for name, value in known_values.items()}
        known_values |= {
            name: float(expression.subs(symbols)) for name, expression in self.space.values
        }
        return {
            quantity.name: float(known_values[quantity.name]) for quantity in self.form.coefficients
        }

    def law(self, point: Array, name: str, structure: Mapping[str, Any]) -> FrictionLaw:
        """Return the law at a point."""
        return FrictionLaw(
            name=name,
            structure=structure,
            form=self.form,
            values=self.values(point, self.solve(point)[0]),
            discretisation=self.discretisation,
        )


def left_out_cost(columns: Array, tau: Array, folds: Sequence[Mask]) -> float:
    """Return the mean square error of a linear law by cross-validation over (N,) masks."""
    slices = list(map(to_slice, folds))
    grams = np.array([columns[fold].T @ columns[fold] for fold in slices])
    moments = np.array([columns[fold].T @ tau[fold] for fold in slices])
    total = 0.0
    for k, fold in enumerate(slices):
        # Sums, as differences from the totals are round-off where only this fold moves.
        gram = np.delete(grams, k, axis=0).sum(axis=0)
        moment = np.delete(moments, k, axis=0).sum(axis=0)
        x = np.linalg.lstsq(gram, moment, rcond=1e-12)[0]
        total += float(np.sum((tau[fold] - columns[fold] @ x) ** 2))
    return total / len(tau)


@lru_cache(maxsize=64)
def _build_kernel(form: LawForm, space: SearchSpace) -> Kernel:
    replacements = {sympy.Symbol(name, real=True): expression for name, expression in space.values}
    searched_symbols = tuple(sympy.Symbol(name, real=True) for name in space.names)
    linear_symbols = tuple(sympy.Symbol(name, real=True) for name in space.linear)
    # Expand products so that factors cancel. Other simplifications may cause an overflow by
    # 1/exp(x).
    memory = tuple(element.subs(replacements) for element in form.memory)
    output = sympy.expand_mul(form.output.xreplace(replacements))
    columns = tuple(sympy.diff(output, symbol) for symbol in linear_symbols)
    constant_torque = output.xreplace(dict.fromkeys(linear_symbols, sympy.Integer(0)))
    read_symbols = find_read_symbols(memory)
    for column in columns:
        read_symbols |= column.free_symbols
    nonlinear_symbols = set(linear_symbols) & read_symbols
    if nonlinear_symbols or constant_torque != 0:
        raise ValueError(
            f"not linear in {sorted(map(str, nonlinear_symbols)) or 'an offset'}: {output}"
        )
    return Kernel(memory, searched_symbols, INPUTS, columns, form.component.settling)
