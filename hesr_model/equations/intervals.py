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
_ROUNDS = 100
_BOXES = 200_000  # limits of the subdivision
_PRECISION = 1e-6  # relative, of the least value


class Least(NamedTuple):
    """Lower bound of a function, and its least known value and where."""

    bound: float
    value: float
    at: float


def lowest(
    bound: Callable[[Array, Array], Array], edges: Array, *, enough: float = inf, size: float = 0.0
) -> Least:
    """Return the least value of a function of x > 0 between the first and the last of `edges`.

    `bound` maps ends of intervals to lower bounds. Intervals are halved until the bound exceeds
    `enough` or is precise to 1e-6 of the least value or of `size`, or until a limit is reached.
    """
    low = edges[:-1]
    high = edges[1:]
    known = inf
    value = inf
    at = 0.0
    spent = 0
    for _ in range(_ROUNDS):
        middle = np.sqrt(low) * np.sqrt(high)
        below, here = (
            np.nan_to_num(found, nan=-inf, posinf=inf, neginf=-inf)
            for found in (bound(low, high), bound(middle, middle))
        )
        if here.min() < value:
            value = float(here.min())
            at = float(middle[here.argmin()])
        left = below < min(value - _PRECISION * max(abs(value), size), enough)
        known = min(known, float(below[~left].min(initial=inf)))
        spent += len(low)
        if not np.any(left):
            return Least(known, value, at)
        rest = float(below[left].min())
        if spent > _BOXES or value == -inf:
            break
        low, middle, high = low[left], middle[left], high[left]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    return Least(min(known, rest), value, at)


def bound_expression(expression: sympy.Expr, box: Mapping[sympy.Symbol, Enclosure]) -> Enclosure:
    """Return bounds of an expression over boxes, the sides of each symbol as arrays."""
    with np.errstate(all="ignore"):  # NaN counts as any number
        return _visit(expression, dict(box))


def _visit(e: sympy.Expr, known: dict[sympy.Expr, Enclosure]) -> Enclosure:
    if e not in known:
        low, high = (np.asarray(side, dtype=float) for side in _bound_expression(e, known))
        odd = np.isnan(low) | np.isnan(high)
        known[e] = np.where(odd, -inf, low), np.where(odd, inf, high)
    return known[e]


def _bound_expression(e: sympy.Expr, known: dict[sympy.Expr, Enclosure]) -> Enclosure:
    if e.is_number:
        return np.array(float(e)), np.array(float(e))
    arguments = [_visit(a, known) for a in e.args]
    name = type(e).__name__
    if isinstance(e, sympy.Add):
        lows, highs = zip(*arguments, strict=True)
        return reduce(np.add, lows), reduce(np.add, highs)
    if isinstance(e, sympy.Mul):
        low, high = arguments[0]
        for one in arguments[1:]:
            low, high = _hull([_product(a, b) for a in (low, high) for b in one])
        return low, high
    if isinstance(e, sympy.Pow) and e.exp.is_number:
        return _power(*arguments[0], float(e.exp))
    if name in _RISING:
        lows, highs = zip(*arguments, strict=True)
        return _RISING[name](*lows), _RISING[name](*highs)
    if name in ("absolute", "cosh"):
        low, high = arguments[0]
        function = np.abs if name == "absolute" else np.cosh
        least, most = _hull([function(low), function(high)])
        return np.where((low < 0.0) & (high > 0.0), function(0.0), least), most
    if name == "clip":
        x, (least, most) = arguments
        bounds = (least, most, np.clip(0.0, least, most))
        return _hull([NUMPY["clip"](end, bound) for end in x for bound in bounds])
    if name in ("sin", "cos"):
        return np.array(-1.0), np.array(1.0)
    return np.array(-inf), np.array(inf)


_RISING: Mapping[str, Callable[..., Array]] = {
    **{name: NUMPY[name] for name in ("sgn", "positive", "larger")},
    **{name: getattr(np, name) for name in ("exp", "tanh", "sinh", "log", "arctan")},
    "atan": np.arctan,
}


def _product(a: Array, b: Array) -> Array:
    return np.where((a == 0.0) | (b == 0.0), 0.0, a * b)


def _hull(ends: Sequence[Array]) -> Enclosure:
    ends = np.broadcast_arrays(*ends)
    return np.minimum.reduce(ends), np.maximum.reduce(ends)


def _power(low: Array, high: Array, exponent: float) -> Enclosure:
    if exponent < 0.0:
        low, high = _power(low, high, -exponent)
        through = (low < 0.0) & (high > 0.0)
        return (
            np.where(through | (high == 0.0), -inf, 1.0 / high),
            np.where(through | (low == 0.0), inf, 1.0 / low),
        )
    least, most = _hull([low**exponent, high**exponent])  # NaN for a root of negative numbers
    if exponent % 2.0 == 0.0:
        least = np.where((low < 0.0) & (high > 0.0), 0.0, least)
    return least, most


def never_negative(expression: sympy.Expr) -> bool:
    """Return True if signs alone prove an expression >= 0 for all real inputs."""
    e = expression
    if e.is_number:
        return bool(e >= 0)
    if isinstance(e, sympy.exp | absolute | positive):
        return True
    if isinstance(e, sympy.Pow):
        return bool(e.exp.is_even) or never_negative(e.base)
    return isinstance(e, sympy.Add | sympy.Mul) and all(map(never_negative, e.args))
