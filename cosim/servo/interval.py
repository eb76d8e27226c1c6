"""Intervals of what was fitted to commands: sandwich covariance over blocks of time.

The errors of a run are correlated over seconds, and steps of the encoder are not independent
noise. So the gradients of whole blocks count as independent, with Student's quantile for one block
less than there are.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from cosim.servo.joint_fit import JointFit
from hesr_model.support.arrays import Array

_LEAST_REST = 0.1  # share of the information on a value that counts as held by other blocks
_ROUND_OFF = 1e-15
NORMAL_QUANTILE = 1.96  # of 95 %, of errors whose size is stated or well known
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

    def scale(self, name: str, *, reference: str | None, error: float) -> float:
        """Return the relative half width of a torque's interval.

        `error` is the relative standard error of the scale. If that rests on another fitted value,
        such as gravity over the gain, torques are divided by this reference, and their errors are
        correlated.
        """
        value, own_error = self.find(name)
        if value == 0.0:
            return np.inf
        variance = (own_error / value) ** 2
        if reference is not None and name != reference:
            known, known_error = self.find(reference)
            covariance = self.covariance[self.names.index(name), self.names.index(reference)]
            variance += (known_error / known) ** 2
            variance -= 2.0 * covariance / (value * known)
        own_width = self.quantile * np.sqrt(max(variance, 0.0))
        return float(np.hypot(own_width, NORMAL_QUANTILE * error))


def compute_interval(fit: JointFit, latency_error: float | None = None) -> Interval:
    """Return the values of a fit with their covariance.

    The errors of a block are those of a fit without it, so that a block of great weight does not
    hide its own error (CR3, and the degrees of freedom, of Cameron and Miller, 2015, "A
    practitioner's guide to cluster-robust inference", J. Human Resources 50(2)).

    Parameters
    ----------
    fit : the fit.
    latency_error : standard error [s] of a latency that the fit did not search; None if it did.
    """
    scale = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-300)
    scaled = fit.jacobian / scale
    root = _find_root_of_inverse(scaled.T @ scaled)
    whitened = scaled @ root
    numbers = np.unique(fit.blocks)
    changes = np.array([_find_change_of_block(whitened, fit, number) for number in numbers])
    changes = changes @ root.T
    covariance = changes.T @ changes
    if fit.latency_slope is not None and latency_error is not None:
        late_change = latency_error * (root @ (whitened.T @ fit.latency_slope))
        covariance += np.outer(late_change, late_change)
    degrees = max(len(numbers) - 1, 1)
    return Interval(
        names=fit.names,
        values=fit.values,
        covariance=covariance / np.outer(scale, scale),
        quantile=float(stdtrit(degrees, _UPPER_QUANTILE)),
    )


def _find_root_of_inverse(information: Array) -> Array:
    """Return a root (P, P) whose product with its transpose is the pseudo-inverse."""
    sizes, directions = np.linalg.eigh(information)
    is_known = sizes > _ROUND_OFF * sizes[-1]
    safe_sizes = np.where(is_known, sizes, 1.0)
    return np.asarray(directions * np.where(is_known, safe_sizes**-0.5, 0.0))


def _find_change_of_block(whitened: Array, fit: JointFit, number: int) -> Array:
    """Return how much a block changes the whitened values (P,): the fit with it and without."""
    rows = fit.blocks == number
    own = whitened[rows]
    shares, directions = np.linalg.eigh(own.T @ own)
    gradient = directions.T @ (own.T @ fit.residual[rows])
    return np.asarray(directions @ (gradient / np.maximum(1.0 - shares, _LEAST_REST)))
