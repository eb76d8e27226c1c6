"""Candidates of the three stages: points of the ParFam family with one unit g."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from hesr_model.equations.memory import Discretisation
from hesr_model.friction.law import FrictionLaw
from hesr_model.laws.parfam import family
from hesr_model.laws.parfam.features import LARGEST_EXPONENT
from hesr_model.support.arrays import Array

UNIT_FUNCTIONS: dict[str, tuple[Callable[[Array], Array], Callable[[Array, Array], Array]]] = {
    "tanh": (np.tanh, lambda _, g: 1.0 - g**2),
    "sin": (np.sin, lambda x, _: np.cos(x)),
    "cos": (np.cos, lambda x, _: -np.sin(x)),
    "exp": (lambda x: np.exp(np.minimum(x, LARGEST_EXPONENT)), lambda _, g: g),
}  # g and its derivative as functions of argument and value of g


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """tau = c . x + gain g(theta . x) with x = (1, dq, h, dh) in raw units."""

    g: str | None  # None for a linear law
    alpha: float  # [1/s]
    beta: float  # [s/rad]
    c: Array  # (4,)
    theta: Array  # (4,)
    gain: float  # [N.m]
    c_active: Array  # (4,) coefficients in the structure
    theta_active: Array  # (4,)
    cost: float  # [N^2.m^2] on the searched rows

    def __post_init__(self) -> None:
        # Their columns of the Jacobian would be uninitialised.
        if self.g is None and self.theta_active.any():
            raise ValueError("a candidate without a unit must not have arguments")

    def to_canonical(self) -> "Candidate":
        """Return the same law with positive gain, offset within a quarter turn (cos: half)."""
        theta = self.theta.copy()
        gain = self.gain
        if self.g == "sin" and self.theta_active[0]:
            half_turns = np.round(theta[0] / np.pi)
            theta[0] -= half_turns * np.pi
            gain *= (-1.0) ** half_turns
        if self.g in ("tanh", "sin") and gain < 0.0:
            gain = -gain
            theta = -theta
        if self.g == "cos" and self.theta_active[0]:
            if gain < 0.0:
                gain = -gain
                theta[0] += np.pi
            theta[0] = np.pi - (np.pi - theta[0]) % (2.0 * np.pi)
        return replace(self, theta=theta, gain=float(gain))

    def torque(self, features: Array) -> Array:
        """Return the (N,) torque [N.m] for (N, 4) features 1, dq, h, dh in SI units."""
        linear = features @ self.c
        if self.g is None:
            return np.asarray(linear)
        return np.asarray(linear + self.gain * UNIT_FUNCTIONS[self.g][0](features @ self.theta))

    def law(self, name: str, discretisation: Discretisation) -> FrictionLaw:
        """Return the candidate as a friction law."""
        linear = [*compress(family.FEATURES, self.c_active)]
        arguments = [*compress(family.FEATURES, self.theta_active)]
        units = []
        if self.g is not None:
            units.append({"g": self.g, "arguments": arguments})
        structure = {"linear": linear, "units": units}
        values: dict[str, float] = {}
        for x, c, theta in zip(family.FEATURES, self.c, self.theta, strict=True):
            values |= {family.linear_name(x): c, family.argument_name(1, x): theta}
        values |= {family.gain_name(1): self.gain, "alpha": self.alpha, "beta": self.beta}
        form = family.form(structure)
        form_values = {
            quantity.name: float(values[quantity.name]) for quantity in form.coefficients
        }
        return FrictionLaw(
            name=name,
            structure=structure,
            form=form,
            values=form_values,
            discretisation=discretisation,
        )
