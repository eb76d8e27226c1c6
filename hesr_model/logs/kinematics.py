"""Velocities tried as derivatives of positions, on rows that did not form the answer."""

from dataclasses import dataclass

import numpy as np

from hesr_model.support.arrays import Array

_WINDOW_COUNTS = (60, 400)  # windows per log: for slow and noisy, and for fast motions
_MIN_WINDOW_ROWS = 2
_BLOCK_COUNT = 10  # blocks of windows, each of which is left out in turn
_MAX_WRAP_SHARE = 0.5  # of the range of a position, above which a single step is a wrap
_SIGNIFICANCE = 3.0  # standard errors of a difference that decides
MAX_SHARE = 0.5  # unexplained share of the squared motion, above which nothing is explained


@dataclass(frozen=True, kw_only=True, eq=False)
class DerivativeMatch:
    """Changes of a position, predicted by the integral of a velocity.

    Attributes
    ----------
    factor : change of the position over the integral of the velocity, in their units.
    errors : by block (K,), squared errors of left-out changes over the mean squared change.
    """

    factor: float
    errors: Array

    @property
    def share(self) -> float:
        """Unexplained share of the squared changes; 1 if the velocity says nothing."""
        return float(np.mean(self.errors))

    @property
    def explains(self) -> bool:
        """Whether the velocity predicts the motion."""
        return self.share < MAX_SHARE

    def beats(self, other: "DerivativeMatch") -> bool:
        """Return whether the errors are smaller by more than chance."""
        differences = other.errors - self.errors
        std_error = float(np.std(differences)) / np.sqrt(len(differences))
        return bool(np.mean(differences) > _SIGNIFICANCE * std_error)


def match_derivative(t: Array, q: Array, dq: Array) -> DerivativeMatch:
    """Predict changes of positions by the integral of velocities, each block by the others.

    The factor is that of a line through the origin: at a constant speed an intercept would explain
    everything.

    Parameters
    ----------
    t : (N,) [s, or any unit].
    q, dq : (N, n) in any units.
    """
    matches = [_match_joint(t, q[:, j], dq[:, j]) for j in range(q.shape[1])]
    errors = np.mean([np.minimum(match.errors, 1.0) for match in matches], axis=0)
    factors = [match.factor for match in matches if match.explains]
    factor = float(np.median(factors)) if factors else 0.0
    return DerivativeMatch(factor=factor, errors=errors)


def _match_joint(t: Array, q: Array, dq: Array) -> DerivativeMatch:
    is_finite = np.isfinite(t) & np.isfinite(q) & np.isfinite(dq)
    t, q, dq = t[is_finite], q[is_finite], dq[is_finite]
    unexplained = DerivativeMatch(factor=0.0, errors=np.ones(_BLOCK_COUNT))
    if len(t) < _BLOCK_COUNT * _MIN_WINDOW_ROWS:
        return unexplained
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (dq[1:] + dq[:-1]) * np.diff(t))])
    is_wrap = np.abs(np.diff(q)) > _MAX_WRAP_SHARE * max(float(np.ptp(q)), 1e-300)
    wraps = np.concatenate([[0], np.cumsum(is_wrap)])
    best = unexplained
    for window_count in _WINDOW_COUNTS:
        width = max(len(t) // window_count, _MIN_WINDOW_ROWS)
        edges = np.arange(0, len(t), width)
        is_whole = np.diff(wraps[edges]) == 0
        match = _cross_validate(np.diff(integral[edges])[is_whole], np.diff(q[edges])[is_whole])
        if match is not None and match.share < best.share:
            best = match
    return best


def _cross_validate(predictor: Array, change: Array) -> DerivativeMatch | None:
    """Predict each block of changes (K,) by the factor of the other blocks."""
    if len(change) < _BLOCK_COUNT:
        return None
    mean_square = float(np.mean(change**2))
    squares = float(np.sum(predictor**2))
    if mean_square == 0.0 or squares == 0.0:
        return None
    blocks = np.array_split(np.arange(len(change)), _BLOCK_COUNT)
    product = float(predictor @ change)
    errors = []
    for block in blocks:
        remaining_squares = squares - float(predictor[block] @ predictor[block])
        remaining_product = product - float(predictor[block] @ change[block])
        factor = remaining_product / remaining_squares if remaining_squares > 0.0 else 0.0
        residual = change[block] - factor * predictor[block]
        errors.append(float(np.mean(residual**2)) / mean_square)
    return DerivativeMatch(factor=product / squares, errors=np.array(errors))
