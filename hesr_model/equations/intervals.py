"""Bounds of expressions by interval arithmetic (Moore, Kearfott and Cloud 2009, ch. 5 and 6).

They hold for real numbers, without the round-off of floating point.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import product
from math import inf
from typing import NamedTuple

import numpy as np
import sympy

from hesr_model.equations.functions import NUMPY, absolute, positive
from hesr_model.support.arrays import Array

Enclosure = tuple[Array, Array]
_MAX_ROUNDS = 100
_MAX_BOXES = 200_000  # limit of the subdivision
_RELATIVE_PRECISION = 1e-6  # of the least value


class Minimum(NamedTuple):
    """Lower bound of a function, and its least known value with its place."""

    bound: float
    value: float
    minimiser: float


def find_minimum(
    bound: Callable[[Array, Array], Array],
    edges: Array,
    *,
    sufficient_bound: float = inf,
    size: float = 0.0,
) -> Minimum:
    """Return the least value of a function of x > 0 between the first and the last of `edges`.

    `bound` maps ends of intervals to lower bounds. Intervals are halved until the bound exceeds
    `sufficient_bound` or is precise to 1e-6 of the least value or of `size`, or until a limit is
    reached.
    """
    lower_ends = edges[:-1]
    upper_ends = edges[1:]
    closed_bound = inf
    lowest_value = inf
    minimiser = 0.0
    box_count = 0
    for _ in range(_MAX_ROUNDS):
        middles = np.sqrt(lower_ends) * np.sqrt(upper_ends)
        interval_bounds = _replace_nan(bound(lower_ends, upper_ends))
        middle_values = _replace_nan(bound(middles, middles))
        if middle_values.min() < lowest_value:
            lowest_value = float(middle_values.min())
            minimiser = float(middles[middle_values.argmin()])
        precise_bound = lowest_value - _RELATIVE_PRECISION * max(abs(lowest_value), size)
        is_open = interval_bounds < min(precise_bound, sufficient_bound)
        closed_bound = min(closed_bound, float(interval_bounds[~is_open].min(initial=inf)))
        box_count += len(lower_ends)
        if not np.any(is_open):
            return Minimum(closed_bound, lowest_value, minimiser)
        open_bound = float(interval_bounds[is_open].min())
        if box_count > _MAX_BOXES or lowest_value == -inf:
            break
        open_middles = middles[is_open]
        lower_ends = np.concatenate([lower_ends[is_open], open_middles])
        upper_ends = np.concatenate([open_middles, upper_ends[is_open]])
    return Minimum(min(closed_bound, open_bound), lowest_value, minimiser)


def _replace_nan(bounds: Array) -> Array:
    """Return lower bounds with -inf in place of NaN, which counts as any number."""
    return np.nan_to_num(bounds, nan=-inf, posinf=inf, neginf=-inf)


def bound_expression(expression: sympy.Expr, box: Mapping[sympy.Symbol, Enclosure]) -> Enclosure:
    """Return bounds of an expression over boxes, the sides of each symbol as arrays."""
    with np.errstate(all="ignore"):  # NaN counts as any number
        return _enclose_expression(expression, dict(box))


def _enclose_expression(
    expression: sympy.Expr, enclosures: dict[sympy.Expr, Enclosure]
) -> Enclosure:
    if expression not in enclosures:
        lower_side, upper_side = _bound_expression(expression, enclosures)
        lower = np.asarray(lower_side, dtype=float)
        upper = np.asarray(upper_side, dtype=float)
        is_undefined = np.isnan(lower) | np.isnan(upper)
        enclosures[expression] = (
            np.where(is_undefined, -inf, lower),
            np.where(is_undefined, inf, upper),
        )
    return enclosures[expression]


def _bound_expression(expression: sympy.Expr, enclosures: dict[sympy.Expr, Enclosure]) -> Enclosure:
    if expression.is_number:
        return np.array(float(expression)), np.array(float(expression))
    arguments = [_enclose_expression(a, enclosures) for a in expression.args]
    if isinstance(expression, sympy.Add):
        return _bound_rising(_add, arguments)
    if isinstance(expression, sympy.Mul):
        return _bound_product(arguments)
    if isinstance(expression, sympy.Pow) and expression.exp.is_number:
        return _bound_power(*arguments[0], float(expression.exp))
    function_name = type(expression).__name__
    if function_name in _RISING_FUNCTIONS:
        return _bound_rising(_RISING_FUNCTIONS[function_name], arguments)
    if function_name in _EVEN_FUNCTIONS:
        return _bound_even(_EVEN_FUNCTIONS[function_name], *arguments[0])
    if function_name == "clip":
        return _bound_clip(*arguments)
    if function_name in ("sin", "cos"):
        return np.array(-1.0), np.array(1.0)
    return np.array(-inf), np.array(inf)


_RISING_FUNCTIONS: Mapping[str, Callable[..., Array]] = {
    **{name: NUMPY[name] for name in ("sgn", "positive", "larger")},
    **{name: getattr(np, name) for name in ("exp", "tanh", "sinh", "log", "arctan")},
    "atan": np.arctan,
}
_EVEN_FUNCTIONS: Mapping[str, Callable[..., Array]] = {"absolute": np.abs, "cosh": np.cosh}


def _add(*terms: Array) -> Array:
    return reduce(np.add, terms)


def _bound_rising(function: Callable[..., Array], arguments: Sequence[Enclosure]) -> Enclosure:
    """Return bounds of a function that rises with each argument."""
    lower_ends, upper_ends = zip(*arguments, strict=True)
    return function(*lower_ends), function(*upper_ends)


def _bound_even(function: Callable[..., Array], lower: Array, upper: Array) -> Enclosure:
    """Return bounds of a function that rises with the distance from 0."""
    lowest_end, highest_end = _hull([function(lower), function(upper)])
    contains_zero = (lower < 0.0) & (upper > 0.0)
    return np.where(contains_zero, function(0.0), lowest_end), highest_end


def _bound_product(factors: Sequence[Enclosure]) -> Enclosure:
    bounds = factors[0]
    for factor in factors[1:]:
        bounds = _hull([_multiply_bounds(a, b) for a, b in product(bounds, factor)])
    return bounds


def _bound_clip(x: Enclosure, limit: Enclosure) -> Enclosure:
    """Return bounds of x clipped to -limit and limit; as a function of limit it bends at |x|."""
    lower, upper = limit
    limits = (lower, upper, np.clip(0.0, lower, upper))
    return _hull([NUMPY["clip"](end, bound) for end, bound in product(x, limits)])


def _multiply_bounds(a: Array, b: Array) -> Array:
    return np.where((a == 0.0) | (b == 0.0), 0.0, a * b)


def _hull(ends: Sequence[Array]) -> Enclosure:
    ends = np.broadcast_arrays(*ends)
    return np.minimum.reduce(ends), np.maximum.reduce(ends)


def _bound_power(lower: Array, upper: Array, exponent: float) -> Enclosure:
    if exponent < 0.0:
        lower, upper = _bound_power(lower, upper, -exponent)
        spans_zero = (lower < 0.0) & (upper > 0.0)
        return (
            np.where(spans_zero | (upper == 0.0), -inf, 1.0 / upper),
            np.where(spans_zero | (lower == 0.0), inf, 1.0 / lower),
        )
    # NaN for a root of negative numbers
    lowest_end, highest_end = _hull([lower**exponent, upper**exponent])
    if exponent % 2.0 == 0.0:
        lowest_end = np.where((lower < 0.0) & (upper > 0.0), 0.0, lowest_end)
    return lowest_end, highest_end


def is_never_negative(expression: sympy.Expr) -> bool:
    """Return True if signs alone prove an expression >= 0 for all real inputs."""
    node = expression
    if node.is_number:
        return bool(node >= 0)
    if isinstance(node, sympy.exp | absolute | positive):
        return True
    if isinstance(node, sympy.Pow):
        return bool(node.exp.is_even) or is_never_negative(node.base)
    return isinstance(node, sympy.Add | sympy.Mul) and all(map(is_never_negative, node.args))
