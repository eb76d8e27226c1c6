"""Choices among candidates that round-off must not decide.

The last digits of a cost differ between processors. Candidates whose costs differ by no more are
tied, and the first one, which callers make the simplest, wins.
"""

from collections.abc import Sequence

ROUND_OFF = 1e-9  # share of a cost below which a difference is round-off


def no_worse(cost: float, than: float) -> bool:
    """Return whether a cost exceeds another one by no more than round-off."""
    return cost <= than * (1.0 + ROUND_OFF)


def first_best(costs: Sequence[float]) -> int:
    """Return the index of the first cost that no other one undercuts by more than round-off."""
    least = min(costs)
    return next(k for k, cost in enumerate(costs) if no_worse(cost, least))
