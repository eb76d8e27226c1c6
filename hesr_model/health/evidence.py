"""Velocities derived from positions, and torques of the model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hesr_model.errors import LogError
from hesr_model.fitting.joint_rows import ROUND_OFF
from hesr_model.health.referee import Estimate
from hesr_model.inference.covariance import standard_errors
from hesr_model.logs.rest import find_resting_speeds, find_resting_travel
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import Coupling
from hesr_model.support.arrays import Array, Mask, select_rows

_MAX_ROWS = 4000  # per log
_MIN_INNER_ROWS = 20
# Of white noise behind the low pass, over its cut-off: root mean square angular frequency, and
# bandwidth. They follow from integrals of 1 / (1 + x^4)^2.
_NOISE_FREQUENCY = 0.577 * 2.0 * np.pi
_NOISE_BANDWIDTH = 0.833
_KNEE_SHARE = 0.1  # speed over which a sign is smoothed, as a share of the peak speed


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothPart:
    """Smoothed part of a log.

    Attributes
    ----------
    log : the part as it was read.
    t : (N,) time [s].
    q : (N, n) smoothed positions [rad, m].
    v, a : (N, n) first and second derivative of `q` [rad/s, m/s; rad/s^2, m/s^2].
    dq : (N, n) smoothed velocities as logged [rad/s, m/s]; None if only positions were.
    tau : (N, n) torques as logged [N.m, N].
    resting_travel, resting_speeds : up to which joints rest [rad, m; rad/s, m/s], of each or of
        all joints; `find_rests` derives them from all logs.
    settling : time [s] at both ends within which the low pass continues the motion by a guess; 0
        if nothing was smoothed.
    """

    log: Log
    t: Array
    q: Array
    v: Array
    a: Array
    dq: Array | None
    tau: Array
    resting_travel: tuple[float, ...] | float = 0.0
    resting_speeds: tuple[float, ...] | float = 0.0
    settling: float = 0.0

    @cached_property
    def is_moving(self) -> Mask:
        """Joints (n,) that move."""
        speed = np.max(np.abs(self.v), axis=0)
        has_travelled = np.ptp(self.q, axis=0) > np.asarray(self.resting_travel)
        return np.asarray(has_travelled & (speed > np.asarray(self.resting_speeds)))

    def find_resting_speed(self, j: int) -> float:
        """Return the speed up to which a joint rests [rad/s, m/s]."""
        if isinstance(self.resting_speeds, tuple):
            return self.resting_speeds[j]
        return self.resting_speeds

    @property
    def period(self) -> float:
        """Median time between rows [s]."""
        return float(np.median(np.diff(self.t)))

    @cached_property
    def is_measured(self) -> Mask:
        """Rows (N,) that smoothing did not have to guess at an end."""
        is_inner = (self.t >= self.t[0] + self.settling) & (self.t <= self.t[-1] - self.settling)
        if np.count_nonzero(is_inner) <= _MIN_INNER_ROWS:
            return np.ones_like(is_inner)
        return np.asarray(is_inner)

    def estimate_speed_noise(self) -> tuple[Array, Array]:
        """Return what white noise adds to `v` and to `dq` (n,), as standard deviations."""
        position_noise = estimate_white_noise(self.log.q)
        if self.settling == 0.0:
            return np.zeros_like(position_noise), np.zeros_like(position_noise)
        cutoff = 1.0 / self.settling
        passed = _compute_passed_share(cutoff, self.log.period)
        v_noise = _NOISE_FREQUENCY * cutoff * passed * position_noise
        if self.log.dq is None:
            return v_noise, np.zeros_like(v_noise)
        return v_noise, passed * estimate_white_noise(self.log.dq)

    def estimate_acceleration_noise(self) -> Array:
        """Return what white noise of the positions adds to `a` (n,), as standard deviations."""
        position_noise = estimate_white_noise(self.log.q)
        if self.settling == 0.0:
            return np.zeros_like(position_noise)
        cutoff = 1.0 / self.settling
        passed = _compute_passed_share(cutoff, self.log.period)
        # The ratio of the integrals of x^4 / (1 + x^4)^2 and 1 / (1 + x^4)^2 is that of x^2.
        return np.asarray(_NOISE_FREQUENCY * 2.0 * np.pi * cutoff**2 * passed * position_noise)

    def thin(self, max_rows: int) -> "SmoothPart":
        """Return at most `max_rows` rows, evenly spread."""
        return select_rows(self, slice(None, None, -(-len(self.t) // max_rows)))


def estimate_white_noise(values: Array) -> Array:
    """Return the standard deviation (n,) of white noise in signals (N, n), by third differences.

    They hardly contain a motion that is slow against the sampling; of white noise they have 20
    times the variance.
    """
    differences = np.diff(values, 3, axis=0)
    return np.asarray(np.sqrt(np.sum(differences**2, axis=0) / (20.0 * max(len(differences), 1))))


def compute_speed_noise(log: Log, j: int, noise: float, cutoff: float) -> tuple[float, float]:
    """Return the noise of a position [rad, m], and of a velocity derived from `noise` of it.

    Parameters
    ----------
    log : with raw positions.
    j : index of the joint.
    noise : standard deviation [rad, m] of white noise.
    cutoff : of the low pass [Hz].
    """
    measured_noise = float(estimate_white_noise(log.q[:, [j]])[0])
    speed_noise = _NOISE_FREQUENCY * cutoff * _compute_passed_share(cutoff, log.period) * noise
    return measured_noise, float(speed_noise)


def _compute_passed_share(cutoff: float, period: float) -> float:
    """Return the share of white noise that a low pass [Hz] lets through, as amplitude."""
    return float(np.sqrt(min(2.0 * _NOISE_BANDWIDTH * cutoff * period, 1.0)))


def find_rests(parts: Sequence[SmoothPart]) -> list[SmoothPart]:
    """Return parts with the travel and speeds up to which joints rest, by all of them."""
    if not parts:
        return []
    q = [part.log.q for part in parts]
    speeds = find_resting_speeds([part.log.t for part in parts], q, [part.v for part in parts])
    return [
        replace(
            part,
            resting_travel=tuple(map(float, find_resting_travel(q))),
            resting_speeds=tuple(map(float, speeds)),
        )
        for part in parts
    ]


def smooth_parts(log: Log, cutoff: float) -> list[SmoothPart]:
    """Smooth the parts of a log that are long enough."""
    parts = []
    for log_part in log.parts():
        try:
            derived = smooth(replace(log_part, dq=None), cutoff)
        except LogError:
            if len(log.gaps):
                continue
            raise
        dq = None
        if log_part.dq is not None:
            dq = smooth(log_part, cutoff).dq
        part = SmoothPart(
            log=log_part,
            t=log_part.t,
            q=derived.q,
            v=derived.dq,
            a=derived.ddq,
            dq=dq,
            tau=log_part.tau,
            settling=1.0 / cutoff,
        )
        parts.append(part.thin(_MAX_ROWS))
    return parts


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelTorques:
    """Torques of a model along a motion.

    Attributes
    ----------
    gravity : (N, n) [N.m, N] without their means, which offsets of the log would hide.
    inertial : (N, n) [N.m, N] of acceleration and velocity.
    """

    gravity: Array
    inertial: Array

    @classmethod
    def from_motion(cls, robot: Robot, q: Array, v: Array, a: Array) -> "ModelTorques":
        """Evaluate the model file along q, v, a (N, n)."""
        zeros = np.zeros_like(q)
        gravity = robot.torque(robot.nominal_parameters, q, zeros, zeros)
        total = robot.torque(robot.nominal_parameters, q, v, a)
        return cls(gravity=gravity - gravity.mean(axis=0), inertial=total - gravity)

    def transform(self, coupling: Coupling) -> "ModelTorques":
        """Transform torques of joints to coupled coordinates."""
        return ModelTorques(
            gravity=coupling.torque(self.gravity), inertial=coupling.torque(self.inertial)
        )


def to_logged_side(
    part: SmoothPart, torques: ModelTorques, coupling: Coupling | None
) -> tuple[SmoothPart, ModelTorques]:
    """Transform velocities and torques to motors if logged."""
    if coupling is None:
        return part, torques
    motor_part = replace(part, v=coupling.motion(part.v), tau=coupling.torque(part.tau))
    return motor_part, torques.transform(coupling)


def friction_shape(v: Array) -> Array:
    """Return Coulomb and viscous friction over `v`, equally weighted."""
    peak = float(np.max(np.abs(v))) or 1.0
    return np.asarray(np.tanh(v / (_KNEE_SHARE * peak)) + v / peak)


@dataclass(frozen=True, kw_only=True)
class TorqueFit:
    """Regression of a joint's torque on gravity, inertia, friction and an offset.

    Attributes
    ----------
    gravity, inertia : over those of the model.
    friction : along the velocity [N.m, N]; negative if it drives the motion.
    gravity_size : standard deviation of the model's gravity [N.m, N].
    friction_size : standard deviation of the explained friction [N.m, N].
    residual, deviation : standard deviation [N.m, N] of what is left, and of the torque.
    """

    gravity: Estimate
    inertia: Estimate
    friction: Estimate
    gravity_size: float
    friction_size: float
    residual: float
    deviation: float

    @property
    def r2(self) -> float:
        """Explained share of the torque's variance."""
        return 1.0 - (self.residual / max(self.deviation, 1e-300)) ** 2

    @property
    def bears_gravity(self) -> bool:
        """Whether gravity is well above the residual."""
        size = self.gravity_size * max(1.0, abs(self.gravity.value))
        return self.gravity_size > ROUND_OFF * self.deviation and size > 2.0 * self.residual


def fit_joint_torque(tau: Array, gravity: Array, inertial: Array, v: Array) -> TorqueFit:
    """Regress `tau` (N,) on `gravity`, `inertial` and friction over `v`."""
    shape = friction_shape(v)
    columns = np.column_stack([gravity, inertial, shape, np.ones_like(v)])
    sizes = np.linalg.norm(columns, axis=0) / np.sqrt(len(v))
    is_nonzero = sizes > 1e-9 * sizes.max()  # that of the offset is 1
    coefficients = np.zeros(4)
    coefficients[is_nonzero] = np.linalg.lstsq(columns[:, is_nonzero], tau, rcond=None)[0]
    residual = tau - columns @ coefficients
    std_errors = np.full(4, np.inf)
    std_errors[is_nonzero] = standard_errors(columns[:, is_nonzero], residual)
    estimates = [
        Estimate(value=float(coefficient), error=float(std_error))
        for coefficient, std_error in zip(coefficients, std_errors, strict=True)
    ]
    return TorqueFit(
        gravity=estimates[0],
        inertia=estimates[1],
        friction=estimates[2],
        gravity_size=float(np.std(gravity)),
        friction_size=float(abs(coefficients[2]) * np.std(shape)),
        residual=float(np.std(residual)),
        deviation=float(np.std(tau)),
    )
