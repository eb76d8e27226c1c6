"""Bounds of expressions by interval arithmetic (Moore, Kearfott and Cloud 2009, ch. 5 and 6).

They hold for real numbers, without the round-off of floating point.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
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
        interval_bounds, middle_values = (
            np.nan_to_num(raw_bounds, nan=-inf, posinf=inf, neginf=-inf)
            for raw_bounds in (bound(lower_ends, upper_ends), bound(middles, middles))
        )
        if middle_values.min() < lowest_value:
            lowest_value = float(middle_values.min())
            minimiser = float(middles[middle_values.argmin()])
        is_open = interval_bounds < min(
            lowest_value - _RELATIVE_PRECISION * max(abs(lowest_value), size), sufficient_bound
        )
        closed_bound = min(closed_bound, float(interval_bounds[~is_open].min(initial=inf)))
        box_count += len(lower_ends)
        if not np.any(is_open):
            return Minimum(closed_bound, lowest_value, minimiser)
        open_bound = float(interval_bounds[is_open].min())
        if box_count > _MAX_BOXES or lowest_value == -inf:
            break
        lower_ends, middles, upper_ends = lower_ends[is_open], middles[is_open], upper_ends[is_open]
        lower_ends, upper_ends = (
            np.concatenate([lower_ends, middles]),
            np.concatenate([middles, upper_ends]),
        )
    return Minimum(min(closed_bound, open_bound), lowest_value, minimiser)


def bound_expression(expression: sympy.Expr, box: Mapping[sympy.Symbol, Enclosure]) -> Enclosure:
    """Return bounds of an expression over boxes, the sides of each symbol as arrays."""
    with np.errstate(all="ignore"):  # NaN counts as any number
        return _enclose_expression(expression, dict(box))


def _enclose_expression(
    expression: sympy.Expr, enclosures: dict[sympy.Expr, Enclosure]
) -> Enclosure:
    if expression not in enclosures:
        lower, upper = (
            np.asarray(side, dtype=float) for side in _bound_expression(expression, enclosures)
        )
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
    function_name = type(expression).__name__
    if isinstance(expression, sympy.Add):
        lower_ends, upper_ends = zip(*arguments, strict=True)
        return reduce(np.add, lower_ends), reduce(np.add, upper_ends)
    if isinstance(expression, sympy.Mul):
        lower, upper = arguments[0]
        for factor in arguments[1:]:
            lower, upper = _hull([_multiply_bounds(a, b) for a in (lower, upper) for b in factor])
        return lower, upper
    if isinstance(expression, sympy.Pow) and expression.exp.is_number:
        return _bound_power(*arguments[0], float(expression.exp))
    if function_name in _RISING_FUNCTIONS:
        lower_ends, upper_ends = zip(*arguments, strict=True)
        return _RISING_FUNCTIONS[function_name](*lower_ends), _RISING_FUNCTIONS[function_name](
            *upper_ends
        )
    if function_name in ("absolute", "cosh"):
        lower, upper = arguments[0]
        function = np.abs if function_name == "absolute" else np.cosh
        lowest_end, highest_end = _hull([function(lower), function(upper)])
        return np.where((lower < 0.0) & (upper > 0.0), function(0.0), lowest_end), highest_end
    if function_name == "clip":
        x, (lowest_end, highest_end) = arguments
        bounds = (lowest_end, highest_end, np.clip(0.0, lowest_end, highest_end))
        return _hull([NUMPY["clip"](end, bound) for end in x for bound in bounds])
    if function_name in ("sin", "cos"):
        return np.array(-1.0), np.array(1.0)
    return np.array(-inf), np.array(inf)


_RISING_FUNCTIONS: Mapping[str, Callable[..., Array]] = {
    **{name: NUMPY[name] for name in ("sgn", "positive", "larger")},
    **{name: getattr(np, name) for name in ("exp", "tanh", "sinh", "log", "arctan")},
    "atan": np.arctan,
}


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
