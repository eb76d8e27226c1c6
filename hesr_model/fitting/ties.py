"""Choices among candidates that round-off must not decide.

Round-off differs between processors. Among candidates within a tolerance the first one, which
callers make the simplest, wins.
"""

from collections.abc import Sequence

from hesr_model.support.arrays import Array

ROUND_OFF = 1e-9  # of a cost


def no_worse(cost: float, than: float, tolerance: float = ROUND_OFF) -> bool:
    """Return whether a cost exceeds another one by no more than a relative tolerance."""
    return cost <= than * (1.0 + tolerance)


def first_best(costs: Sequence[float] | Array, tolerance: float = ROUND_OFF) -> int:
    """Return the index of the first cost that no other one undercuts beyond a tolerance."""
    least = min(costs)
    return next(k for k, cost in enumerate(costs) if no_worse(cost, least, tolerance))
