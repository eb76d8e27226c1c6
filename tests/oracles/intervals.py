"""Ranges of expressions: bounds by interval arithmetic with subdivision.

A rate or bound lies within the result of `reach` for all symbol values in a box: natural interval
extensions (Moore, Kearfott and Cloud, Introduction to Interval Analysis, 2009, chapters 5 and 6)
of every subexpression. The box is subdivided, because a single extension is too wide if a symbol
occurs twice. Bounds are those of real numbers; round-off is ignored.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import inf, prod

import numpy as np
import sympy

from hesr_model.equations.functions import NUMPY
from hesr_model.equations.memory import Element
from hesr_model.support.arrays import Array

Interval = tuple[Array, Array]
Box = Mapping[sympy.Symbol, tuple[float, float]]

_BOXES = 4096
"""Approximate number of parts of a box."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Interval bounds of the rate or bound of an element over a box.

    Attributes
    ----------
    low, high : its range; infinite if it may be undefined.
    guarded : parts of the box, as boxes, that may make it negative, so that the guard acts.
    """

    low: float
    high: float
    guarded: tuple[Box, ...] = ()

    @property
    def finite(self) -> bool:
        """Whether it is finite everywhere."""
        return self.low > -inf and self.high < inf


def reach(element: Element, box: Box) -> Reach:
    """Return the range of the rate or bound of an element over a box of its inputs."""
    expression = element.parts[1]
    parts = _cut({s: box[s] for s in expression.free_symbols})
    low, high = _over(expression, parts)
    count = max((len(sides[0]) for sides in parts.values()), default=1)
    low, high = np.broadcast_to(low, count), np.broadcast_to(high, count)
    guarded = tuple(
        {s: (float(a[k]), float(b[k])) for s, (a, b) in parts.items()}
        for k in np.flatnonzero(low < 0.0)
    )
    return Reach(low=float(low.min()), high=float(high.max()), guarded=guarded)


def _cut(box: Box) -> dict[sympy.Symbol, Interval]:
    """Return the parts of a box: the sides of each symbol as arrays over the parts."""
    wide = [s for s, (low, high) in box.items() if low < high]
    each = max(1, round(_BOXES ** (1.0 / len(wide)))) if wide else 1
    edges = {s: np.linspace(*box[s], each + 1) if s in wide else np.array(box[s]) for s in box}
    sides = [list(pairwise(e)) for e in edges.values()]
    parts = np.array(list(product(*sides))).reshape(prod(map(len, sides)), len(box), 2)
    return {s: (parts[:, i, 0], parts[:, i, 1]) for i, s in enumerate(box)}


def _over(expression: sympy.Expr, parts: Mapping[sympy.Symbol, Interval]) -> Interval:
    with np.errstate(all="ignore"):  # undefined values become unbounded
        return _visit(expression, dict(parts))


def _visit(e: sympy.Expr, known: dict[sympy.Expr, Interval]) -> Interval:
    if e not in known:
        known[e] = _checked(_extended(e, known))
    return known[e]


def _checked(found: Interval) -> Interval:
    low, high = (np.asarray(side, dtype=float) for side in found)
    odd = np.isnan(low) | np.isnan(high)
    return np.where(odd, -inf, low), np.where(odd, inf, high)


def _extended(e: sympy.Expr, known: dict[sympy.Expr, Interval]) -> Interval:
    if e.is_number:
        return np.array(float(e)), np.array(float(e))
    arguments = [_visit(a, known) for a in e.args]
    name = type(e).__name__
    if isinstance(e, sympy.Add):
        return sum(a for a, _ in arguments), sum(b for _, b in arguments)  # type: ignore[return-value]
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
        (low, high), (_, bound) = arguments
        return NUMPY["clip"](low, bound), NUMPY["clip"](high, bound)
    if name in ("sin", "cos"):
        return np.array(-1.0), np.array(1.0)
    return np.array(-inf), np.array(inf)


_RISING: Mapping[str, Callable[..., Array]] = {
    **{name: NUMPY[name] for name in ("sgn", "positive", "larger")},
    **{name: getattr(np, name) for name in ("exp", "tanh", "sinh", "log", "arctan")},
    "atan": np.arctan,
}


def _product(a: Array, b: Array) -> Array:
    """Return a b, with 0 times infinity = 0."""
    return np.where((a == 0.0) | (b == 0.0), 0.0, a * b)


def _hull(ends: Sequence[Array]) -> Interval:
    return np.minimum.reduce(np.broadcast_arrays(*ends)), np.maximum.reduce(
        np.broadcast_arrays(*ends)
    )


def _power(low: Array, high: Array, exponent: float) -> Interval:
    if exponent < 0.0:
        low, high = _power(low, high, -exponent)
        through = (low <= 0.0) & (high >= 0.0)
        return np.where(through, -inf, 1.0 / high), np.where(through, inf, 1.0 / low)
    least, most = _hull([low**exponent, high**exponent])  # NaN for a root of a negative number
    if exponent % 2.0 == 0.0:
        least = np.where((low < 0.0) & (high > 0.0), 0.0, least)
    return least, most
