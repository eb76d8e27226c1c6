"""Intervals of what was fitted to commands: sandwich covariance over blocks of time.

The errors of a run are correlated over seconds, and steps of the encoder are no noise. So the
gradients of whole blocks count as independent, and Student's quantile as many of them as are left.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from cosim.servo.fit import JointFit
from hesr_model.support.arrays import Array

_UPPER_QUANTILE = 0.975  # upper end of a 95 % interval


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval:
    """Values (P,) of a fit with their covariance (P, P) and the factor of a 95 % interval."""

    names: tuple[str, ...]
    values: Array
    covariance: Array
    quantile: float

    def find(self, name: str) -> tuple[float, float]:
        """Return a value and its standard error; 0 and infinity if it was not fitted."""
        if name not in self.names:
            return 0.0, np.inf
        k = self.names.index(name)
        return float(self.values[k]), float(np.sqrt(max(self.covariance[k, k], 0.0)))

    def scale(self, name: str, *, follows_gravity: bool, error: float) -> float:
        """Return the relative half width of a torque's interval.

        `error` is the relative standard error of the scale. If the scale follows gravity, the
        torque over the gain is divided by gravity over the gain, and their errors are correlated.
        """
        value, own_error = self.find(name)
        if value == 0.0:
            return np.inf
        variance = (own_error / value) ** 2
        if follows_gravity and name != "body_factor":
            gravity, gravity_error = self.find("body_factor")
            k, g = self.names.index(name), self.names.index("body_factor")
            variance += (gravity_error / gravity) ** 2
            variance -= 2.0 * self.covariance[k, g] / (value * gravity)
        return float(self.quantile * np.sqrt(max(variance, 0.0) + error**2))


def compute_interval(fit: JointFit) -> Interval:
    """Return the values of a fit with their covariance."""
    jacobian = fit.jacobian
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    scaled = jacobian / scale
    gradients = scaled * fit.residual[:, None]
    blocks = np.unique(fit.blocks, return_inverse=True)[1]
    sums = np.zeros((int(blocks.max()) + 1, len(scale)))
    np.add.at(sums, blocks, gradients)
    inverse = np.linalg.pinv(scaled.T @ scaled)
    block_count = len(sums)
    degrees = max(block_count - len(scale), 1)
    covariance = inverse @ (sums.T @ sums) @ inverse * (block_count / degrees)
    return Interval(
        names=fit.names,
        values=fit.values,
        covariance=covariance / np.outer(scale, scale),
        quantile=float(stdtrit(degrees, _UPPER_QUANTILE)),
    )
