"""Range of a rate or a bound over a box of its symbols, by interval arithmetic.

The box is cut along its sides, because an extension is too wide if a symbol occurs twice.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from math import inf, prod

import numpy as np
import sympy

from hesr_model.equations.intervals import Enclosure, bound_expression
from hesr_model.equations.memory import Element

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
    low, high = bound_expression(expression, parts)
    count = max((len(sides[0]) for sides in parts.values()), default=1)
    low, high = np.broadcast_to(low, count), np.broadcast_to(high, count)
    guarded = tuple(
        {s: (float(a[k]), float(b[k])) for s, (a, b) in parts.items()}
        for k in np.flatnonzero(low < 0.0)
    )
    return Reach(low=float(low.min()), high=float(high.max()), guarded=guarded)


def _cut(box: Box) -> dict[sympy.Symbol, Enclosure]:
    """Return the parts of a box: the sides of each symbol as arrays over the parts."""
    wide = [s for s, (low, high) in box.items() if low < high]
    each = max(1, round(_BOXES ** (1.0 / len(wide)))) if wide else 1
    edges = {s: np.linspace(*box[s], each + 1) if s in wide else np.array(box[s]) for s in box}
    sides = [list(pairwise(e)) for e in edges.values()]
    parts = np.array(list(product(*sides))).reshape(prod(map(len, sides)), len(box), 2)
    return {s: (parts[:, i, 0], parts[:, i, 1]) for i, s in enumerate(box)}
