"""The hysteresis state of eq. 9 over all rows of a joint, with its derivatives."""

from dataclasses import dataclass

import numpy as np

from hesr_model.equations.memory import Discretisation
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class HysteresisFeatures:
    """Features x = (1, dq, h, dh) of eq. 11 as functions of (alpha, beta)."""

    samples: JointRows
    discretisation: Discretisation

    @property
    def alpha_limit(self) -> float:
        """Upper limit of alpha [1/s]: alpha * step < 1, for Euler at the longest step (eq. 10)."""
        steps = self.samples.dt[~self.samples.begins]
        return 1.0 / float(steps.max() if self.discretisation == "euler" else np.median(steps))

    def columns(self, alpha: float, beta: float) -> Array:
        """Return the (N, 4) features 1, dq [rad/s], h [1], dh [1/s]."""
        return self._columns(alpha, np.tanh(beta * self.samples.dq), self._decay(alpha))

    def with_derivatives(self, alpha: float, beta: float) -> tuple[Array, Array, Array]:
        """Return (N, 4) features and (N, 2) derivatives of h and dh by (alpha, beta), SI units."""
        s = self.samples
        target = np.tanh(beta * s.dq)
        a = self._decay(alpha)
        features = self._columns(alpha, target, a)
        h = features[:, 2]
        slope = s.dq * (1.0 - target**2)
        before = np.concatenate([[0.0], h[:-1]])
        a_by_alpha = -s.dt * a if self.discretisation == "exact" else -s.dt
        by_alpha = s.recurrence(a, a_by_alpha * (before - target), np.zeros_like(a))
        by_beta = s.recurrence(a, (1.0 - a) * slope, slope)
        ddh = np.stack([target - h - alpha * by_alpha, alpha * (slope - by_beta)], axis=1)
        return features, np.stack([by_alpha, by_beta], axis=1), ddh

    def _decay(self, alpha: float) -> Array:
        """Return the (N,) factor a of h+ = a h + (1 - a) tanh(beta dq)."""
        z = alpha * self.samples.dt
        return np.exp(-z) if self.discretisation == "exact" else 1.0 - z

    def _columns(self, alpha: float, target: Array, a: Array) -> Array:
        h = self.samples.recurrence(a, (1.0 - a) * target, target)
        columns = np.empty((len(h), 4), order="F")
        columns[:, 0] = 1.0
        columns[:, 1] = self.samples.dq
        columns[:, 2] = h
        columns[:, 3] = alpha * (target - h)
        return columns
