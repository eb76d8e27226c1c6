"""A fit of one joint: its unknowns, and servo and law with torques over the gain."""

from dataclasses import dataclass

import numpy as np

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.servo import JointServo
from hesr_model.support.arrays import Array, Integers

_DIFFERENCE = 1e-3  # step of a derivative, relative to an unknown or its scale


@dataclass(frozen=True, kw_only=True)
class FitUnknown:
    """An unknown of a fit: of the servo, or a coefficient of the law.

    Attributes
    ----------
    name : field of the servo, or name of the coefficient.
    of_law : whether it is a coefficient.
    start : value [its unit, torques over kp].
    scale : size of its changes.
    lower, upper : bounds.
    is_logarithmic : whether it changes by factors.
    difference : step of its derivative, over the scale.
    """

    name: str
    of_law: bool
    start: float
    scale: float
    lower: float
    upper: float
    is_logarithmic: bool
    difference: float = _DIFFERENCE

    def encode(self, value: float) -> float:
        """Return the number of the search for a value."""
        if self.is_logarithmic:
            return float(np.log(value))
        return value / self.scale

    def decode(self, number: float) -> float:
        """Return the value of a number of the search."""
        if self.is_logarithmic:
            return float(np.exp(number))
        return number * self.scale

    def slope(self, number: float) -> float:
        """Return the derivative of the value at a number of the search."""
        if self.is_logarithmic:
            return float(np.exp(number))
        return self.scale


@dataclass(frozen=True, kw_only=True, eq=False)
class JointFit:
    """Servo and law of one joint, with torques over the gain.

    Attributes
    ----------
    servo : with kp 1 N.m/rad.
    law : coefficients over the gain.
    unknowns : what was fitted, by name.
    values : (P,) of the unknowns.
    jacobian : (N, P) of the position errors over the values.
    residual : (N,) position errors [rad; m], simulated less measured.
    blocks : (N,) number of the block of time of each row.
    latency_slope : (N,) derivative of the position errors over a latency that was not fitted.
    """

    servo: JointServo
    law: FrictionLaw
    unknowns: tuple[FitUnknown, ...]
    values: Array
    jacobian: Array
    residual: Array
    blocks: Integers
    latency_slope: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(unknown.name for unknown in self.unknowns)

    @property
    def rmse(self) -> float:
        """Root mean square of the position errors [rad; m]."""
        return float(np.sqrt(np.mean(self.residual**2)))
