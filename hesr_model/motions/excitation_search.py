"""Search space of the excitation design: coordinates, objective and gradient.

The gradient needs one finite difference per joint and quantity for all instants: 3 n + 1
regressors.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hesr_model.motions.limits import Limits
from hesr_model.motions.trajectories import Fourier
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_INSTANTS = 12  # instants per cycle of the highest harmonic; at least 120 per period
_STEP = 1e-6  # step of finite differences; the regressor is linear in ddq and quadratic in dq
_ORDER = 8.0  # order of the eigenvalue norms, smooth bounds of the extreme eigenvalues
_SINGULAR = 1e-14


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """Fourier motions at rest at both ends, with a range of periods [s], as vectors.

    A vector contains, joint by joint, H - 1 coordinates of `a` and H - 1 of `b` in units of the
    joint's speed, then mean positions from -1 to 1 within their limits, then ln(period).
    """

    model: Robot
    limits: Limits
    harmonics: int
    period: tuple[float, float]

    @cached_property
    def base(self) -> tuple[int, ...]:
        """Base columns of the regressor."""
        return base_columns(self.model)

    @property
    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Lowest and highest coordinates."""
        n = self.model.n
        shortest, longest = np.log(self.period)
        free: list[tuple[float | None, float | None]] = [(None, None)]
        return [*free * (2 * n * (self.harmonics - 1)), *[(-1.0, 1.0)] * n, (shortest, longest)]

    @cached_property
    def _at_rest(self) -> tuple[Array, Array]:
        """Orthonormal bases (H, H - 1) of the `a` with sum 0 and the `b` with sum k b_k = 0."""
        orders = np.arange(1.0, self.harmonics + 1)
        return _null_space(np.ones_like(orders)), _null_space(orders)

    @cached_property
    def _series(self) -> tuple[Array, Array, Array]:
        """Position less offset, dq and ddq for each coordinate of one joint, period 2 pi s."""
        count = max(_INSTANTS * self.harmonics, 120)
        orders = np.arange(1.0, self.harmonics + 1)
        phase = np.outer(2 * np.pi * np.arange(count) / count, orders)
        cos, sin = np.cos(phase), np.sin(phase)
        of_a, of_b = self._at_rest
        return (
            np.hstack([sin / orders @ of_a, -cos / orders @ of_b]),
            np.hstack([cos @ of_a, sin @ of_b]),
            np.hstack([-sin * orders @ of_a, cos * orders @ of_b]),
        )

    def pack(self, motion: Fourier) -> Array:
        """Return the coordinates of a motion."""
        of_a, of_b = self._at_rest
        shape = np.hstack([motion.a @ of_a, motion.b @ of_b]) / self.limits.velocity[:, None]
        place = (motion.offset - self._middle) / self._reach
        return np.concatenate([shape.ravel(), place, [np.log(motion.period)]])

    def unpack(self, x: Array) -> Fourier:
        """Return the motion of coordinates."""
        shape, offset, period = self._split(x)
        of_a, of_b = self._at_rest
        free = self.harmonics - 1
        return Fourier(
            offset=offset, a=shape[:, :free] @ of_a.T, b=shape[:, free:] @ of_b.T, period=period
        )

    def value_and_gradient(self, x: Array, weight: float) -> tuple[float, Array]:
        """Return the log of a bound of cond(W_b) plus `weight` times the mean squared excess.

        The excess is the relative part of |q - middle|, |dq|, |ddq| and |tau| above their limits.
        """
        shape, offset, period = self._split(x)
        rate = 2 * np.pi / period
        series = self._series
        path, dq, ddq = series[0] @ shape.T / rate, series[1] @ shape.T, series[2] @ shape.T * rate
        state = (path + offset, dq, ddq)
        value, slopes = self._of_regressor(state, weight)
        centred = (state[0] - self._middle, dq, ddq)
        for k, limit in enumerate((self._reach, self.limits.velocity, self.limits.acceleration)):
            excess, slope = _excess(centred[k], limit)
            value += weight * excess
            slopes[k] += weight * slope
        of_q, of_dq, of_ddq = slopes
        of_shape = of_q.T @ series[0] / rate + of_dq.T @ series[1] + of_ddq.T @ series[2] * rate
        of_log_period = np.sum(of_q * path) - np.sum(of_ddq * ddq)
        gradient = np.concatenate(
            [
                (of_shape * self.limits.velocity[:, None]).ravel(),
                of_q.sum(axis=0) * self._reach,
                [of_log_period],
            ]
        )
        return value, gradient

    def _of_regressor(
        self, state: tuple[Array, Array, Array], weight: float
    ) -> tuple[float, list[Array]]:
        base = list(self.base)
        regressor = self.model.regressor(*state)
        value, of_columns = _log_condition(regressor[:, :, base])
        upstream = np.zeros_like(regressor)
        upstream[:, :, base] = of_columns
        nominal = self.model.nominal_parameters
        excess, of_torque = _excess(regressor @ nominal, self.limits.torque)
        upstream += weight * of_torque[:, :, None] * nominal
        slopes = []
        for k, values in enumerate(state):
            slope = np.empty_like(values)
            for joint in range(self.model.n):
                moved = list(state)
                moved[k] = values.copy()
                moved[k][:, joint] += _STEP
                change = self.model.regressor(*moved) - regressor
                slope[:, joint] = np.sum(upstream * change, axis=(1, 2)) / _STEP
            slopes.append(slope)
        return value + weight * excess, slopes

    @property
    def _middle(self) -> Array:
        return 0.5 * (self.limits.lower + self.limits.upper)

    @property
    def _reach(self) -> Array:
        return 0.5 * (self.limits.upper - self.limits.lower)

    def _split(self, x: Array) -> tuple[Array, Array, float]:
        n = self.model.n
        shape = x[: -n - 1].reshape(n, -1) * self.limits.velocity[:, None]
        return shape, self._middle + self._reach * x[-n - 1 : -1], float(np.exp(x[-1]))


def _null_space(row: Array) -> Array:
    _, _, vt = np.linalg.svd(row[None, :])
    return np.asarray(vt[1:].T)


def _excess(values: Array, limit: Array) -> tuple[float, Array]:
    over = np.maximum(np.abs(values) / limit - 1.0, 0.0)
    slope = 2.0 * over * np.sign(values) / limit / len(values)
    return float(np.sum(over**2)) / len(values), slope


def _log_condition(columns: Array) -> tuple[float, Array]:
    """Return the log of a bound of the condition number of rows (N, n, P), and derivatives.

    For eigenvalues l_i of W'W, max l / min l <= (sum l_i^p)^(1/p) (sum l_i^-p)^(1/p).
    """
    rows = columns.reshape(-1, columns.shape[2])
    values, vectors = np.linalg.eigh(rows.T @ rows)
    values = np.maximum(values, _SINGULAR * values[-1])
    high, low = (values / values[-1]) ** _ORDER, (values / values[0]) ** -_ORDER
    span = np.log(values[-1] / values[0]) + np.log(high.sum() * low.sum()) / _ORDER
    of_values = 0.5 / values * (high / high.sum() - low / low.sum())
    slopes = 2.0 * rows @ ((vectors * of_values) @ vectors.T)
    return 0.5 * float(span), slopes.reshape(columns.shape)
