"""Uncertainty of the coefficients of a law: covariance from the Jacobian of its prediction.

Coefficients at a bound, or in a structure chosen by the data, have a covariance but no interval.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import sympy

from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.fitting.separable import MIN_COEFFICIENT, SearchSpace
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict, record_start
from hesr_model.inference.covariance import (
    Covariance,
    blocks_of_time,
    covariance_of_fit,
    pool_covariances,
)
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array, Integers, Mask

MAX_COEFFICIENTS = 64  # coefficients of larger laws, networks, have no meaning
_DIFFERENCE_STEP = 1e-6
_DERIVATIVE_ROUND_OFF = 1e-12  # derivative that is round-off
_CURVATURE_WIDTH = 2.0  # standard errors for measuring curvature
_MIN_CHANGE_RATIO = 0.25  # of the ratio between actual and linear change
_BOUND_MARGIN = 1e-3  # distance that counts as at a bound, of the (logarithmic) range


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """Free numbers of a fitted law."""

    point: Array  # (P,)
    values: Callable[[Array], dict[str, float]]  # all coefficients
    held_names: frozenset[str]  # coefficients at a bound


def add_standard_errors(
    law: FrictionLaw, joint_records: Sequence[FrictionRecord], space: SearchSpace | None = None
) -> FrictionLaw:
    """Return the law with covariance and standard errors; `space` is its search space, if known."""
    if len(law.values) > MAX_COEFFICIENTS:
        return law
    if space:
        joint_space = space.scale_to_joint(is_prismatic=joint_records[0].sliding)
        coordinates = _build_free_coordinates(law, joint_space)
    else:
        coordinates = _build_all_coordinates(law)
    if not len(coordinates.point):
        return law
    free_law = _FreeLaw(law, coordinates, joint_records)
    jacobian, slope = _differentiate(free_law.evaluate, coordinates.point)
    is_used = np.abs(jacobian).max(axis=0) > _DERIVATIVE_ROUND_OFF
    if not np.any(is_used):
        return law
    jacobian = jacobian[:, is_used]
    tau_predicted = free_law.predict(law)
    covariance = _estimate_covariance(
        np.flatnonzero(is_used), jacobian, tau_predicted, joint_records
    )
    named_slopes = zip(law.values, slope[:, is_used], strict=True)
    coefficient_slopes = {name: row for name, row in named_slopes if np.any(row != 0.0)}
    names = list(coefficient_slopes)
    slopes = np.array(list(coefficient_slopes.values()))
    law_with_covariance = replace(law, covariance=covariance.transform(names, slopes))
    if law.structure.keys() - {"limited"}:  # a structure that the data chose
        return _store_standard_errors(law_with_covariance, {})
    q, r = np.linalg.qr(jacobian)
    widening = {}
    for name, derivative in coefficient_slopes.items():
        if name not in coordinates.held_names:
            measure_change = partial(free_law.measure_change, name, is_used, tau_predicted)
            widening[name] = measure_wider_side(derivative, covariance.matrix, q, r, measure_change)
    return _store_standard_errors(law_with_covariance, widening)


class _FreeLaw:
    """Torque and coefficients of a law on records as functions of its free numbers."""

    def __init__(
        self, law: FrictionLaw, coordinates: Coordinates, joint_records: Sequence[FrictionRecord]
    ) -> None:
        self._law = law
        self._coordinates = coordinates
        self._joint_records = joint_records
        # Initial states are measured, so they are constant.
        self._starts = [record_start(law, record) for record in joint_records]

    def predict(self, law: FrictionLaw) -> Array:
        """Return the torque (N,) [N.m] of a law with other coefficients."""
        torques = []
        for record, start in zip(self._joint_records, self._starts, strict=True):
            torques.append(predict(law, **record.motion, start=start))
        return np.concatenate(torques)

    def evaluate(self, point: Array) -> tuple[Array, Array]:
        """Return the torque (N,) [N.m] and all coefficients (M,) at a point (P,)."""
        values = self._coordinates.values(point)
        tau = self.predict(replace(self._law, values=values))
        return tau, np.array([values[name] for name in self._law.values])

    def measure_change(
        self, name: str, is_used: Mask, tau_predicted: Array, step: Array
    ) -> tuple[float, Array]:
        """Return the changes of a coefficient and of the torque (N,) [N.m] by a step.

        The `step` is one of the used free numbers; without a torque there, both changes are 0.
        """
        point = self._coordinates.point.copy()
        point[is_used] += step
        with np.errstate(all="ignore"):  # the law may be undefined there
            try:
                tau, values = self.evaluate(point)
            except (ArtifactError, SimulationError):  # coefficients or Euler's steps are not finite
                return 0.0, np.zeros_like(tau_predicted)
        k = list(self._law.values).index(name)
        return values[k] - self._law.values[name], tau - tau_predicted


def _differentiate(
    evaluate: Callable[[Array], tuple[Array, Array]], point: Array
) -> tuple[Array, Array]:
    """Return central differences of two functions, (N, P) and (M, P)."""
    size = np.abs(point)
    steps = _DIFFERENCE_STEP * np.maximum(size, 1e-3)
    # Laws divide by some coefficients; none may become zero.
    steps = np.where(size > 0.0, np.minimum(steps, 0.5 * size), steps)
    first_columns = []
    second_columns = []
    for step in np.diag(steps):
        first_after, second_after = evaluate(point + step)
        first_before, second_before = evaluate(point - step)
        width = 2.0 * step.sum()
        first_columns.append((first_after - first_before) / width)
        second_columns.append((second_after - second_before) / width)
    return np.stack(first_columns, axis=1), np.stack(second_columns, axis=1)


def _estimate_covariance(
    used_numbers: Integers,
    jacobian: Array,
    tau_predicted: Array,
    joint_records: Sequence[FrictionRecord],
) -> Covariance:
    residual = np.concatenate([record.tau for record in joint_records]) - tau_predicted
    labels = blocks_of_time(log_of_rows(joint_records))
    spreads = [
        record.tau_load_spread for record in joint_records if record.tau_load_spread is not None
    ]
    carried = None
    if len(spreads) == len(joint_records):
        carried = jacobian.T @ np.concatenate(spreads)
    return covariance_of_fit(
        [str(k) for k in used_numbers], jacobian, residual, labels, carried=carried
    )


def pool_errors(laws: Sequence[FrictionLaw]) -> list[FrictionLaw]:
    """Return the laws of all joints with one common between-log factor."""
    pooled_covariances = iter(
        pool_covariances([law.covariance for law in laws if law.covariance is not None])
    )
    pooled_laws = []
    for law in laws:
        if law.covariance is None:
            pooled_laws.append(law)
            continue
        unpooled_errors = dict(
            zip(law.covariance.names, law.covariance.standard_errors, strict=True)
        )
        widening = dict.fromkeys(law.standard_errors, 1.0)
        for name, error in law.standard_errors.items():
            if unpooled_errors[name]:
                widening[name] = error / unpooled_errors[name]
        pooled_law = replace(law, covariance=next(pooled_covariances))
        pooled_laws.append(_store_standard_errors(pooled_law, widening))
    return pooled_laws


def _store_standard_errors(law: FrictionLaw, widening: Mapping[str, float]) -> FrictionLaw:
    if law.covariance is None:
        return law
    errors = dict(zip(law.covariance.names, law.covariance.standard_errors, strict=True))
    widened_errors = {name: float(errors[name]) * widening[name] for name in widening}
    return replace(law, standard_errors=widened_errors)


def measure_wider_side(
    slope: Array,
    covariance: Array,
    q: Array,
    r: Array,
    measure_change: Callable[[Array], tuple[float, Array]],
) -> float:
    """Return the ratio of the wider side of a coefficient's interval to its standard error.

    `slope` (P,) is its derivative, `q` and `r` the QR decomposition of the torque's (N, P)
    derivatives; `measure_change` maps a step (P,) to the changes of the coefficient and of the
    torque (N,) [N.m]. If the torque moves less than linearly with the other coefficients fitted
    again, the interval is wider by that ratio: the end of the profile t of Bates and Watts (1988,
    ch. 6).
    """
    error = float(np.sqrt(slope @ covariance @ slope))
    normal = np.linalg.lstsq(r.T, slope, rcond=None)[0]
    size = float(np.linalg.norm(normal))
    if not error or not size:
        return 1.0
    ratios = []
    for sign in (1.0, -1.0):
        coefficient_change, torque_change = measure_change(
            sign * _CURVATURE_WIDTH * covariance @ slope / error
        )
        projected = q.T @ torque_change
        remaining_square = (
            torque_change @ torque_change - projected @ projected + (normal @ projected / size) ** 2
        )
        ratio = 1.0
        if coefficient_change and remaining_square > 0.0:
            ratio = float(np.sqrt(remaining_square) * size / abs(coefficient_change))
        if not np.isfinite(ratio):
            ratio = 1.0
        ratios.append(ratio)
    return 1.0 / float(np.clip(min(ratios), _MIN_CHANGE_RATIO, 1.0))


def _build_all_coordinates(law: FrictionLaw) -> Coordinates:
    names = [name for name, value in law.values.items() if abs(value) > MIN_COEFFICIENT]

    def values(point: Array) -> dict[str, float]:
        return {**law.values, **dict(zip(names, map(float, point), strict=True))}

    return Coordinates(
        point=np.array([law.values[name] for name in names]),
        values=values,
        held_names=frozenset(law.values) - frozenset(names),
    )


def _build_free_coordinates(law: FrictionLaw, space: SearchSpace) -> Coordinates:
    numbers = _find_unknowns(law.values, space)
    names_at_bound = _find_names_at_bound(numbers, space)
    names = [name for name in numbers if name not in names_at_bound]
    held_names = set(names_at_bound)
    for name, expression in space.values:
        source_names = {str(symbol) for symbol in expression.free_symbols}
        if not source_names or names_at_bound & source_names:
            held_names.add(name)

    def values(point: Array) -> dict[str, float]:
        known_values = numbers | dict(zip(names, map(float, point), strict=True))
        computed = _compile_values(space)(*(known_values[name] for name in numbers))
        for (name, _), value in zip(space.values, computed, strict=True):
            known_values[name] = float(value)
        return {name: known_values.get(name, value) for name, value in law.values.items()}

    return Coordinates(
        point=np.array([numbers[name] for name in names]),
        values=values,
        held_names=frozenset(held_names),
    )


def _find_names_at_bound(numbers: Mapping[str, float], space: SearchSpace) -> set[str]:
    """Return the unknowns at a bound, and those that must not be negative and are 0."""
    names = set()
    for name, (lower, upper) in space.bounds:
        if _is_at_end(numbers[name], lower, upper):
            names.add(name)
    for name in space.linear[: space.non_negative]:
        if numbers[name] <= MIN_COEFFICIENT:
            names.add(name)
    return names


def _is_at_end(number: float, lower: float, upper: float) -> bool:
    if lower > 0:  # searched by its logarithm
        number = np.log(number)
        lower, upper = np.log([lower, upper])
    margin = _BOUND_MARGIN * (upper - lower)
    return bool(number < lower + margin or number > upper - margin)


def _find_unknowns(values: Mapping[str, float], space: SearchSpace) -> dict[str, float]:
    """Return searched and solved numbers by name, from the coefficients of a law."""
    searched_names = (*space.names, *space.linear)
    numbers = {name: values[name] for name in searched_names if name in values}
    for name, expression in space.values:
        missing = [symbol for symbol in expression.free_symbols if symbol.name not in numbers]
        if len(missing) != 1:
            continue
        replacements = {
            symbol: numbers[symbol.name]
            for symbol in expression.free_symbols
            if symbol.name in numbers
        }
        replacements[sympy.Symbol(name, real=True)] = values[name]
        solution = _solve_expression(expression, name, missing[0]).subs(replacements)
        # A ratio of coefficients that are 0 is not determined.
        numbers[missing[0].name] = float(solution) if solution.is_finite else 0.0
    return {name: numbers[name] for name in searched_names}


@lru_cache(maxsize=64)
def _solve_expression(expression: sympy.Expr, name: str, unknown: sympy.Symbol) -> sympy.Expr:
    (solution, *_) = sympy.solve(expression - sympy.Symbol(name, real=True), unknown)
    return solution


@lru_cache(maxsize=64)
def _compile_values(space: SearchSpace) -> Callable[..., Sequence[float]]:
    symbols = [sympy.Symbol(name, real=True) for name in (*space.names, *space.linear)]
    compute_values: Callable[..., Sequence[float]] = sympy.lambdify(
        symbols, [expression for _, expression in space.values]
    )
    return compute_values
