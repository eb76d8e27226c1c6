"""Excitation design: Fourier motions with a well-conditioned rigid-body regressor (III-B)."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydantic import Field, field_validator
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from hesr_model.errors import FitError, RuleError
from hesr_model.motions.limits import Limits, MotionLimits, Positive, peak_torque
from hesr_model.motions.trajectories import Fourier, sample_one_period
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.rigid_body.identification import MIN_PEAK_SPEED
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, report_progress, silent
from hesr_model.support.typed_files import Config

_INSTANTS_PER_CYCLE = 12  # instants per cycle of the highest harmonic; at least 120 per period
# Step of finite differences; the regressor is linear in ddq and quadratic in dq.
_DIFFERENCE_STEP = 1e-6
_NORM_ORDER = 8.0  # order of the eigenvalue norms, smooth bounds of the extreme eigenvalues
_MIN_EIGENVALUE_RATIO = 1e-14


@dataclass(frozen=True, kw_only=True, eq=False)
class FourierSearch:
    """Fourier motions at rest at both ends, with a range of periods [s], as vectors.

    A vector contains, joint by joint, H - 1 coordinates of `a` and H - 1 of `b` in units of the
    joint's speed, then mean positions from -1 to 1 within their limits, then ln(period).
    """

    robot: Robot
    limits: Limits
    harmonics: int
    period: tuple[float, float]

    @cached_property
    def base(self) -> tuple[int, ...]:
        """Base columns of the regressor."""
        return base_columns(self.robot)

    @property
    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Lowest and highest coordinates."""
        n = self.robot.n
        shortest, longest = np.log(self.period)
        unbounded: list[tuple[float | None, float | None]] = [(None, None)]
        return [
            *unbounded * (2 * n * (self.harmonics - 1)),
            *[(-1.0, 1.0)] * n,
            (shortest, longest),
        ]

    @cached_property
    def _at_rest(self) -> tuple[Array, Array]:
        """Orthonormal bases (H, H - 1) of the `a` with sum 0 and the `b` with sum k b_k = 0."""
        orders = np.arange(1.0, self.harmonics + 1)
        return _find_null_space(np.ones_like(orders)), _find_null_space(orders)

    @cached_property
    def _series(self) -> tuple[Array, Array, Array]:
        """Position less offset, dq and ddq for each coordinate of one joint, period 2 pi s."""
        count = max(_INSTANTS_PER_CYCLE * self.harmonics, 120)
        orders = np.arange(1.0, self.harmonics + 1)
        phase = np.outer(2 * np.pi * np.arange(count) / count, orders)
        cos = np.cos(phase)
        sin = np.sin(phase)
        basis_a, basis_b = self._at_rest
        return (
            np.hstack([sin / orders @ basis_a, -cos / orders @ basis_b]),
            np.hstack([cos @ basis_a, sin @ basis_b]),
            np.hstack([-sin * orders @ basis_a, cos * orders @ basis_b]),
        )

    def pack(self, motion: Fourier) -> Array:
        """Return the coordinates of a motion."""
        basis_a, basis_b = self._at_rest
        shape = np.hstack([motion.a @ basis_a, motion.b @ basis_b]) / self.limits.velocity[:, None]
        relative_offset = (motion.offset - self._middle) / self._reach
        return np.concatenate([shape.ravel(), relative_offset, [np.log(motion.period)]])

    def unpack(self, x: Array) -> Fourier:
        """Return the motion of coordinates."""
        shape, offset, period = self._split(x)
        basis_a, basis_b = self._at_rest
        free_count = self.harmonics - 1
        return Fourier(
            offset=offset,
            a=shape[:, :free_count] @ basis_a.T,
            b=shape[:, free_count:] @ basis_b.T,
            period=period,
        )

    def value_and_gradient(self, x: Array, weight: float) -> tuple[float, Array]:
        """Return the log of a bound of cond(W_b) plus `weight` times the mean squared excess.

        The excess is the relative part of |q - middle|, |dq|, |ddq| and |tau| above their limits.
        """
        shape, offset, period = self._split(x)
        rate = 2 * np.pi / period
        series = self._series
        displacement = series[0] @ shape.T / rate
        dq = series[1] @ shape.T
        ddq = series[2] @ shape.T * rate
        state = (displacement + offset, dq, ddq)
        value, slopes = self._differentiate_regressor(state, weight)
        centred = (state[0] - self._middle, dq, ddq)
        for k, limit in enumerate((self._reach, self.limits.velocity, self.limits.acceleration)):
            excess, slope = _compute_excess(centred[k], limit)
            value += weight * excess
            slopes[k] += weight * slope
        q_slope, dq_slope, ddq_slope = slopes
        shape_slope = (
            q_slope.T @ series[0] / rate + dq_slope.T @ series[1] + ddq_slope.T @ series[2] * rate
        )
        period_slope = np.sum(q_slope * displacement) - np.sum(ddq_slope * ddq)
        size_slopes = (shape_slope * self.limits.velocity[:, None]).ravel()
        return value, np.concatenate(
            [size_slopes, q_slope.sum(axis=0) * self._reach, [period_slope]]
        )

    def _differentiate_regressor(
        self, state: tuple[Array, Array, Array], weight: float
    ) -> tuple[float, list[Array]]:
        base = list(self.base)
        regressor = self.robot.regressor(*state)
        value, column_slopes = _bound_condition(regressor[:, :, base])
        upstream = np.zeros_like(regressor)
        upstream[:, :, base] = column_slopes
        nominal = self.robot.nominal_parameters
        excess, torque_slopes = _compute_excess(regressor @ nominal, self.limits.torque)
        upstream += weight * torque_slopes[:, :, None] * nominal
        slopes = []
        for k, values in enumerate(state):
            slope = np.empty_like(values)
            for j in range(self.robot.n):
                shifted = list(state)
                shifted[k] = values.copy()
                shifted[k][:, j] += _DIFFERENCE_STEP
                change = self.robot.regressor(*shifted) - regressor
                slope[:, j] = np.sum(upstream * change, axis=(1, 2)) / _DIFFERENCE_STEP
            slopes.append(slope)
        return value + weight * excess, slopes

    @property
    def _middle(self) -> Array:
        return 0.5 * (self.limits.lower + self.limits.upper)

    @property
    def _reach(self) -> Array:
        return 0.5 * (self.limits.upper - self.limits.lower)

    def _split(self, x: Array) -> tuple[Array, Array, float]:
        n = self.robot.n
        shape = x[: -n - 1].reshape(n, -1) * self.limits.velocity[:, None]
        return shape, self._middle + self._reach * x[-n - 1 : -1], float(np.exp(x[-1]))


def _find_null_space(row: Array) -> Array:
    _, _, vt = np.linalg.svd(row[None, :])
    return np.asarray(vt[1:].T)


def _compute_excess(values: Array, limit: Array) -> tuple[float, Array]:
    overshoot = np.maximum(np.abs(values) / limit - 1.0, 0.0)
    slope = 2.0 * overshoot * np.sign(values) / limit / len(values)
    return float(np.sum(overshoot**2)) / len(values), slope


def _bound_condition(columns: Array) -> tuple[float, Array]:
    """Return the log of a bound of the condition number of rows (N, n, P), and derivatives.

    For eigenvalues l_i of W'W, max l / min l <= (sum l_i^p)^(1/p) (sum l_i^-p)^(1/p).
    """
    rows = columns.reshape(-1, columns.shape[2])
    eigenvalues, eigenvectors = np.linalg.eigh(rows.T @ rows)
    eigenvalues = np.maximum(eigenvalues, _MIN_EIGENVALUE_RATIO * eigenvalues[-1])
    upper_terms = (eigenvalues / eigenvalues[-1]) ** _NORM_ORDER
    lower_terms = (eigenvalues / eigenvalues[0]) ** -_NORM_ORDER
    span = (
        np.log(eigenvalues[-1] / eigenvalues[0])
        + np.log(upper_terms.sum() * lower_terms.sum()) / _NORM_ORDER
    )
    value_slopes = (
        0.5 / eigenvalues * (upper_terms / upper_terms.sum() - lower_terms / lower_terms.sum())
    )
    slopes = 2.0 * rows @ ((eigenvectors * value_slopes) @ eigenvectors.T)
    return 0.5 * float(span), slopes.reshape(columns.shape)


_SAMPLES_PER_PERIOD = 400  # above 100, the condition number of W_b changes by 1 %
_COARSE_WEIGHT = 1e2  # weight of exceeded limits in the first descents
_FINE_WEIGHT = 1e4  # in the last one
_COARSE_STEPS = 100
_FINE_STEPS = 300
_MIN_SHARE_OF_LIMIT = 0.02  # of a joint's own limit of speed, which its peak exceeds
_DEFAULT_RATE = 200.0  # [Hz]
_INITIAL_SIZE = 100.0  # size of a random motion before it is shrunk, relative to the joint's speed


class ExcitationSettings(Config):
    """Settings of the designed motion."""

    harmonics: int = Field(default=10, ge=2)
    period: tuple[Positive, Positive] = (10.0, 30.0)  # range [s]
    periods: int = Field(default=1, ge=1)
    starts: int = Field(default=4, ge=1)
    seed: int = Field(default=0, ge=0)
    sample_rate: Positive | None = None  # [Hz], by default that of the logs, or 200
    limits: MotionLimits = MotionLimits()

    @field_validator("period")
    @classmethod
    def _shortest_first(cls, period: tuple[float, float]) -> tuple[float, float]:
        if period[0] > period[1]:
            raise RuleError("the shortest period must come first", code="excitation.period")
        return period


@dataclass(frozen=True, kw_only=True, eq=False)
class Excitation:
    """Designed motion, at rest at both ends, for a robot."""

    motion: Fourier
    condition: float  # condition number of W_b
    sample_rate: float  # of the setpoints [Hz]
    limits: Limits
    peak_torque: Array  # (n,) [N.m], of the model file's rigid body, without friction

    def setpoints(self) -> tuple[Array, Array, Array, Array]:
        """Return times (N,) [s] and q, dq, ddq (N, n) [rad, rad/s, rad/s2]."""
        t = np.arange(round(self.motion.duration * self.sample_rate) + 1) / self.sample_rate
        return t, *self.motion.sample(t)


def condition(robot: Robot, base: tuple[int, ...], motion: Fourier) -> float:
    """Return the condition number of W_b: `base` columns over one period, in SI, unscaled."""
    t = np.linspace(0.0, motion.period, _SAMPLES_PER_PERIOD, endpoint=False)
    columns = robot.regressor(*motion.sample(t))[:, :, list(base)]
    return float(np.linalg.cond(columns.reshape(-1, columns.shape[2])))


def design(
    robot: Robot, settings: ExcitationSettings | None = None, *, progress: Progress = silent
) -> Excitation:
    """Design the motion with the smallest `condition` within limits.

    L-BFGS-B descends a smooth bound of the condition number from random motions; the best one is
    refined. Raises RobotError if the limits do not fit the robot, FitError if they admit no motion.
    """
    settings = settings or ExcitationSettings()
    rate = settings.sample_rate or robot.description.log.sample_rate or _DEFAULT_RATE
    limits = Limits.from_settings(robot, settings.limits)
    rest_q = limits.find_rest_position(robot)
    search = FourierSearch(
        robot=robot, limits=limits, harmonics=settings.harmonics, period=settings.period
    )
    with threadpool_limits(1):
        starts = random_motions(robot, settings, settings.starts, settings.seed)
        coarse_motions = [
            _descend(search, start, rest_q, _COARSE_WEIGHT, _COARSE_STEPS)
            for start in report_progress(starts, progress)
        ]
        best_motion = min(coarse_motions, key=lambda motion: condition(robot, search.base, motion))
        period = round(best_motion.period * rate) / rate
        search = replace(search, period=(period, period))
        motion = replace(
            _descend(search, best_motion, rest_q, _FINE_WEIGHT, _FINE_STEPS), period=period
        )
    _, dq, _ = sample_one_period(motion)
    peaks = np.abs(dq).max(axis=0)
    # A lift may be slow, but not as slow as by positions that hardly differ.
    least_peaks = np.minimum(MIN_PEAK_SPEED, _MIN_SHARE_OF_LIMIT * limits.velocity)
    for joint, peak, least_peak in zip(robot.description.joints, peaks, least_peaks, strict=True):
        if not peak > least_peak:
            raise FitError(
                f"robot '{robot.description.name}': the limits allow joint '{joint}' at most "
                f"{peak:.2g} rad/s; widen them, identification needs {least_peak:.2g} rad/s."
            )
    return Excitation(
        motion=replace(motion, periods=settings.periods),
        condition=condition(robot, search.base, motion),
        sample_rate=rate,
        limits=limits,
        peak_torque=peak_torque(robot, motion),
    )


def _descend(
    search: FourierSearch, motion: Fourier, rest_q: Array, weight: float, steps: int
) -> Fourier:
    minimum = minimize(
        search.value_and_gradient,
        search.pack(motion),
        args=(weight,),
        jac=True,
        method="L-BFGS-B",
        bounds=search.bounds,
        options={"maxiter": steps},
    )
    return search.limits.shrink(search.unpack(minimum.x), search.robot, rest_q)


def random_motions(
    robot: Robot, settings: ExcitationSettings, count: int, seed: int
) -> list[Fourier]:
    """Draw random motions as large as the limits allow, as references for `design`."""
    limits = Limits.from_settings(robot, settings.limits)
    rest_q = limits.find_rest_position(robot)
    rng = np.random.default_rng(seed)
    shape = (2, robot.n, settings.harmonics)
    motions = []
    for _ in range(count):
        a, b = _INITIAL_SIZE * limits.velocity[:, None] * rng.standard_normal(shape)
        offset = rng.uniform(limits.lower, limits.upper)
        period = rng.uniform(*settings.period)
        motion = Fourier.from_rest(a, b, offset=offset, period=period)
        motions.append(limits.shrink(motion, robot, rest_q))
    return motions
