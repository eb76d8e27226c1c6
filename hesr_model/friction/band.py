"""The numbers of a band around a law's torque: half-widths at 95 %, by what widens it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite
from typing import Any

import numpy as np

from hesr_model.equations.component import Parameter, Quantity
from hesr_model.errors import ArtifactError

LEVEL = 0.95
"""Probability to which the numbers of a band belong."""

REST = 0.005
"""v_rest, below which a joint counts as resting, smoothly [rad/s, m/s]."""

LEAST, GREATEST = 0.5, 0.999
"""Probabilities that a band has; others count as the nearest of these."""

COVERAGE = Parameter(
    name="coverage",
    unit="1",
    description="share of measured torques that the band holds, from 0.5 to 0.999",
    start=LEVEL,
)


def _number(name: str, unit: str, description: str) -> Quantity:
    return Quantity(name=f"band_{name}", unit=unit, description=f"{description}, of {{joint}}")


NUMBERS = (
    _number("floor", "N.m", "half-width at 95 % that is there always"),
    _number("slow", "N.m", "half-width at 95 % that slow motion adds"),
    _number("slow_speed", "rad/s", "speed at which half of its square is left"),
    _number("rest", "N.m", "half-width at 95 % that rest adds"),
    _number("fast", "N.m.s/rad", "half-width at 95 % that speed adds, over the speed"),
    _number("load", "1", "half-width at 95 % that load adds, over the load"),
    _number("tail", "1", "exponent of the error's tail, 0.65 for a normal distribution"),
    _number("envelope", "1", "1 where the band at rest reaches to both break-away torques, else 0"),
)
"""What of a band is a number of each joint, in the order of the fields of `Band`."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """The numbers of one joint's band; see `banded`.

    Attributes
    ----------
    floor, slow, rest : half-widths at 95 % [N.m].
    slow_speed : [rad/s].
    fast : [N.m.s/rad].
    load : [1].
    tail : exponent.
    envelope : 1 where the band at rest is the break-away envelope, 0 where rests were seen.

    Raises
    ------
    ArtifactError
        If a number is negative or not finite, or the speed is 0.
    """

    floor: float
    slow: float
    slow_speed: float
    rest: float
    fast: float
    load: float
    tail: float
    envelope: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value >= 0.0) or (field.name == "slow_speed" and not value):
                raise ArtifactError(
                    f"'{field.name}' of a band is {value}; needed is a finite number, 0 or more "
                    "and a positive speed."
                )

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers, in the order of `NUMBERS`."""
        return tuple(float(getattr(self, field.name)) for field in fields(self))


def shapes(
    dq: Any, tau_load: Any, slow_speed: Any, *, most: Any = np.minimum
) -> tuple[Any, Any, Any, Any, Any]:
    """Return what floor^2, slow^2, rest^2, fast^2 and load^2 are multiplied with in s^2.

    Of arrays or of expressions.

    Parameters
    ----------
    dq, tau_load : velocity [rad/s] and load [N.m].
    slow_speed : [rad/s].
    most : the smaller of two.
    """
    resting = (1 - most((dq / REST) ** 2, 1)) ** 2
    return 1 + 0 * dq, 1 / (1 + (dq / slow_speed) ** 2), resting, dq**2, tau_load**2


def start_values(band: Band) -> Mapping[str, float]:
    """Return the numbers of a band by the names of `NUMBERS`."""
    return dict(zip((q.name for q in NUMBERS), band.values, strict=True))
