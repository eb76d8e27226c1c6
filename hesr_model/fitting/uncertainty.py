"""Uncertainty of the coefficients of a law: covariance from the Jacobian of its prediction.

Coefficients at a bound, or in a structure chosen by the data, have a covariance but no interval.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import sympy

from hesr_model.errors import SimulationError
from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.fitting.separable import LEAST, SearchSpace
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict, record_start
from hesr_model.inference.covariance import Covariance, blocks_of_time, covariance_of_fit, pooled
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array, Integers

MOST_COEFFICIENTS = 64  # coefficients of larger laws, networks, have no meaning
_STEP = 1e-6
_NONE = 1e-12  # derivative that is round-off
_WIDTH = 2.0  # standard errors for measuring curvature
_FLATTEST = 0.25  # of the ratio between actual and linear change
_AT_BOUND = 1e-3  # distance that counts as at a bound, of the (logarithmic) range


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """Free numbers of a fitted law."""

    point: Array  # (P,)
    values: Callable[[Array], dict[str, float]]  # all coefficients
    held: frozenset[str]  # coefficients at a bound


def with_standard_errors(
    law: FrictionLaw, records: Sequence[FrictionRecord], space: SearchSpace | None = None
) -> FrictionLaw:
    """Return the law with covariance and standard errors; `space` is its search space, if known."""
    if len(law.values) > MOST_COEFFICIENTS:
        return law
    if space:
        moved = _free_coordinates(law, space.at_joint(slides=records[0].sliding))
    else:
        moved = _every(law)
    # Initial states are measured, so they are constant.
    starts = [record_start(law, record) for record in records]

    def at(point: Array) -> tuple[Array, Array]:
        values = moved.values(point)
        torque = _predicted(replace(law, values=values), records, starts)
        return torque, np.array([values[name] for name in law.values])

    jacobian, slope = _derivatives(at, moved.point)
    used = np.abs(jacobian).max(axis=0) > _NONE
    jacobian, slope = jacobian[:, used], slope[:, used]
    torque = _predicted(law, records, starts)
    covariance = _covariance(np.flatnonzero(used), jacobian, torque, records)
    moves = dict(zip(law.values, slope, strict=True))
    moves = {name: own for name, own in moves.items() if np.any(own != 0.0)}
    whole = replace(law, covariance=covariance.mapped(list(moves), np.array(list(moves.values()))))
    if law.structure.keys() - {"limited"}:
        return _stated(whole, {})
    q, record = np.linalg.qr(jacobian)

    def moved_by(index: int, step: Array) -> tuple[float, Array]:
        point = moved.point.copy()
        point[used] += step
        with np.errstate(all="ignore"):  # the law may be undefined there
            try:
                there, values = at(point)
            except SimulationError:  # Euler's step may be unstable
                return 0.0, np.zeros_like(torque)
        return values[index] - list(law.values.values())[index], there - torque

    wider = {
        name: wider_side(
            own, covariance.matrix, q, record, partial(moved_by, list(law.values).index(name))
        )
        for name, own in moves.items()
        if name not in moved.held
    }
    return _stated(whole, wider)


def _derivatives(of: Callable[[Array], tuple[Array, Array]], point: Array) -> tuple[Array, Array]:
    """Return central differences of two functions, (N, P) and (M, P)."""
    size = np.abs(point)
    steps = _STEP * np.maximum(size, 1e-3)
    # Laws divide by some coefficients; none may become zero.
    steps = np.where(size > 0.0, np.minimum(steps, 0.5 * size), steps)
    columns = []
    for step in np.diag(steps):
        sides = zip(of(point + step), of(point - step), strict=True)
        columns.append([(after - before) / (2.0 * step.sum()) for after, before in sides])
    first, second = (np.stack(part, axis=1) for part in zip(*columns, strict=True))
    return first, second


def _covariance(
    used: Integers, jacobian: Array, torque: Array, records: Sequence[FrictionRecord]
) -> Covariance:
    residual = np.concatenate([record.tau for record in records]) - torque
    labels = blocks_of_time(log_of_rows(records))
    spreads = [record.tau_load_spread for record in records if record.tau_load_spread is not None]
    carried = jacobian.T @ np.concatenate(spreads) if len(spreads) == len(records) else None
    return covariance_of_fit([str(k) for k in used], jacobian, residual, labels, carried=carried)


def with_pooled_errors(laws: Sequence[FrictionLaw]) -> list[FrictionLaw]:
    """Return the laws of all joints with one common between-log factor."""
    shared = iter(pooled([law.covariance for law in laws if law.covariance is not None]))
    found = []
    for law in laws:
        if law.covariance is None:
            found.append(law)
            continue
        plain = dict(zip(law.covariance.names, law.covariance.standard_errors, strict=True))
        wider = {n: e / plain[n] if plain[n] else 1.0 for n, e in law.standard_errors.items()}
        found.append(_stated(replace(law, covariance=next(shared)), wider))
    return found


def _stated(law: FrictionLaw, wider: Mapping[str, float]) -> FrictionLaw:
    if law.covariance is None:
        return law
    errors = dict(zip(law.covariance.names, law.covariance.standard_errors, strict=True))
    return replace(law, standard_errors={n: float(errors[n]) * wider[n] for n in wider})


def wider_side(
    slope: Array,
    covariance: Array,
    q: Array,
    r: Array,
    moved_by: Callable[[Array], tuple[float, Array]],
) -> float:
    """Return the ratio of the wider side of a coefficient's interval to its standard error.

    `slope` (P,) is its derivative, `q` and `r` the QR decomposition of the torque's (N, P)
    derivatives; `moved_by` maps a step (P,) to the changes of the coefficient and of the torque
    (N,) [N.m]. If the torque moves less than linearly with the other coefficients fitted again, the
    interval is wider by that ratio: the end of the profile t of Bates and Watts (1988, ch. 6).
    """
    error = float(np.sqrt(slope @ covariance @ slope))
    normal = np.linalg.lstsq(r.T, slope, rcond=None)[0]
    size = float(np.linalg.norm(normal))
    if not error or not size:
        return 1.0
    ratios = []
    for sign in (1.0, -1.0):
        aside, moved = moved_by(sign * _WIDTH * covariance @ slope / error)
        within = q.T @ moved
        left = moved @ moved - within @ within + (normal @ within / size) ** 2
        ratio = np.sqrt(left) * size / abs(aside) if aside and left > 0.0 else 1.0
        ratios.append(ratio if np.isfinite(ratio) else 1.0)
    return 1.0 / float(np.clip(min(ratios), _FLATTEST, 1.0))


def _every(law: FrictionLaw) -> Coordinates:
    names = [name for name, value in law.values.items() if abs(value) > LEAST]

    def values(point: Array) -> dict[str, float]:
        return {**law.values, **dict(zip(names, map(float, point), strict=True))}

    return Coordinates(
        point=np.array([law.values[name] for name in names]),
        values=values,
        held=frozenset(law.values) - frozenset(names),
    )


def _free_coordinates(law: FrictionLaw, space: SearchSpace) -> Coordinates:
    numbers = _unknowns(law.values, space)
    at = {name for name, (low, high) in space.bounds if _at_end(numbers[name], low, high)}
    at |= {name for name in space.linear[: space.non_negative] if numbers[name] <= LEAST}
    names = [name for name in numbers if name not in at]
    through = [(name, tuple(str(s) for s in e.free_symbols)) for name, e in space.values]
    held = at | {name for name, sources in through if at & set(sources) or not sources}

    def values(point: Array) -> dict[str, float]:
        known = numbers | dict(zip(names, map(float, point), strict=True))
        computed = _functions(space)(*(known[name] for name in numbers))
        known |= dict(zip((name for name, _ in space.values), map(float, computed), strict=True))
        return {name: known.get(name, value) for name, value in law.values.items()}

    return Coordinates(
        point=np.array([numbers[name] for name in names]), values=values, held=frozenset(held)
    )


def _at_end(number: float, low: float, high: float) -> bool:
    value, ends = (np.log(number), np.log([low, high])) if low > 0 else (number, (low, high))
    margin = _AT_BOUND * (ends[1] - ends[0])
    return bool(value < ends[0] + margin or value > ends[1] - margin)


def _unknowns(values: Mapping[str, float], space: SearchSpace) -> dict[str, float]:
    every = (*space.names, *space.linear)
    known = {name: values[name] for name in every if name in values}
    for name, expression in space.values:
        rest = [s for s in expression.free_symbols if s.name not in known]
        if len(rest) == 1:
            at = {s: known[s.name] for s in expression.free_symbols if s.name in known}
            at[sympy.Symbol(name, real=True)] = values[name]
            found = _solved(expression, name, rest[0]).subs(at)
            known[rest[0].name] = float(found) if found.is_finite else 0.0
    return {name: known[name] for name in every}


@lru_cache(maxsize=64)
def _solved(expression: sympy.Expr, name: str, unknown: sympy.Symbol) -> sympy.Expr:
    (found, *_) = sympy.solve(expression - sympy.Symbol(name, real=True), unknown)
    return found


@lru_cache(maxsize=64)
def _functions(space: SearchSpace) -> Callable[..., Sequence[float]]:
    symbols = [sympy.Symbol(name, real=True) for name in (*space.names, *space.linear)]
    found: Callable[..., Sequence[float]] = sympy.lambdify(symbols, [e for _, e in space.values])
    return found


def _predicted(
    law: FrictionLaw, records: Sequence[FrictionRecord], starts: Sequence[tuple[float, ...]]
) -> Array:
    parts = zip(records, starts, strict=True)
    return np.concatenate([predict(law, **record.motion, start=start) for record, start in parts])
