"""The servo of each joint, identified from the commands of a log.

    tau = share g(q) + kv (w - dq) + ki integral(w - dq),    w = dq_cmd + kp (q_cmd - q)

Commands act late; the servo compensates a share of gravity. With q_cmd it is a PID in the position.
"""

from dataclasses import dataclass, replace
from itertools import compress, product

import numpy as np

from hesr_model.errors import FitError
from hesr_model.inference.covariance import covariance_of_fit
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Numbers

_MAX_LATENCY = 0.1  # longest latency [s]
_MIN_COARSE_STEP = 5e-4
_FINE_PARTS = 10  # least step of a first search [s], and its parts in a second
_MIN_GAIN_SIGNIFICANCE = 2.0  # least size of a kept integral gain, in standard errors
_MIN_EXPLAINED_SHARE = 0.8  # least share of the torque without gravity that the servo explains
_MIN_GRAVITY_SHARE = 1e-3  # range of gravity over that of the torque, to determine its share
# Columns of a joint's problem.
_FACTOR_COUNT = 3  # those of the servo come first
_INTEGRAL_GAINS = (1, 2)  # on the integral of the velocity error, and on that of the position
_GRAVITY = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoFit:
    """Servos of n joints: factors on velocity error, its integral, and the integral of that.

    Attributes
    ----------
    factors : (n, 3) [N.m.s/rad, N.m/rad, N.m/(rad.s)].
    covariance : (n, 3, 3) of the factors.
    latency : delay of the commands [s].
    held : whether a command acts until the next, and not along a line to it.
    gravity_share : (n,) share of gravity that the servo compensates.
    explained : (n,) share of the variance of the torque without gravity.
    """

    factors: Numbers
    covariance: Numbers
    latency: float
    held: bool
    gravity_share: Numbers
    explained: Numbers

    def draw(self, generator: np.random.Generator) -> Array:
        """Return factors (n, 3) as likely as the identified ones; none is negative."""
        deviations = [
            generator.multivariate_normal(np.zeros(_FACTOR_COUNT), joint_covariance)
            for joint_covariance in self.covariance
        ]
        return np.maximum(self.factors + np.array(deviations), 1e-9 * self.factors)


def cascade(factors: Array) -> tuple[Array, Array, Array]:
    """Return kv, ki and kp (n,) of the servo that is closest to `factors` (n, 3)."""
    kv, p, i = factors.T
    root = np.sqrt(np.maximum(p**2 - 4.0 * i * kv, 0.0))
    slow_rate = np.where(i > 0.0, 0.5 * (p - root), p)
    return kv, slow_rate, (p - slow_rate) / kv


def identify_servo(log: Log, robot: Robot, parameters: Array) -> ServoFit:
    """Identify the servo of each joint by least squares, and their common latency.

    Parameters
    ----------
    log : log without gaps whose commands are known.
    robot : robot of the log, without coupled motors.
    parameters : rigid-body parameters (P,), for gravity.

    Raises
    ------
    FitError
        If the log has no commands, or the torque does not follow from them.
    """
    if log.q_cmd is None and log.dq_cmd is None:
        raise FitError("no log has commanded positions or velocities (log.columns.q_cmd, dq_cmd)")
    if robot.description.coupling is not None:
        raise FitError("servos of coupled motors are not identified")
    dq = log.dq
    if dq is None:
        dq = smooth(log).dq
    log = replace(log, dq=dq, dq_cmd=compute_commands(log)[1])  # once, for all latencies
    zeros = np.zeros_like(log.q)
    gravity = robot.torque(parameters, log.q, zeros, zeros)
    duration = log.t[-1] - log.t[0]
    coarse_step = max(0.25 * log.period, _MIN_COARSE_STEP)
    coarse_latencies = np.arange(0.0, min(_MAX_LATENCY, 0.1 * duration), coarse_step)

    def misfit(trial: tuple[bool, float]) -> float:
        held, latency = trial
        return _compute_misfit(log, gravity, held, latency)

    coarse_trials = list(product((True, False), coarse_latencies))
    held, coarse_latency = min(coarse_trials, key=misfit)
    fine_steps = coarse_step * np.arange(-_FINE_PARTS, _FINE_PARTS + 1) / _FINE_PARTS
    near_latencies = coarse_latency + fine_steps
    fine_trials = [(held, latency) for latency in near_latencies[near_latencies >= 0.0]]
    held, latency = min(fine_trials, key=misfit)
    fits = list(map(_fit_joint_servo, *_build_problems(log, gravity, held, latency)))
    factors, covariances, shares, explained = map(np.array, zip(*fits, strict=True))
    for joint, factor, share in zip(robot.joints, factors, explained, strict=True):
        if factor[0] <= 0.0 or share < _MIN_EXPLAINED_SHARE:
            raise FitError(
                f"the torque of joint '{joint}' does not follow from its commands (a PI or PID "
                f"servo explains {100 * max(share, 0.0):.0f} % of it)"
            )
    return ServoFit(
        factors=factors,
        covariance=covariances,
        latency=float(latency),
        held=held,
        gravity_share=shares,
        explained=explained,
    )


def compute_commands(log: Log) -> tuple[Array, Array]:
    """Return desired positions and velocities (N, n) of a log with commands."""
    if log.q_cmd is None:  # integrate from the first measured position
        assert log.dq_cmd is not None
        displacement = np.cumsum(log.dq_cmd[:-1] * np.diff(log.t)[:, None], axis=0)
        return log.q[0] + np.vstack([np.zeros(log.q.shape[1]), displacement]), log.dq_cmd
    if log.dq_cmd is None:
        return log.q_cmd, np.gradient(log.q_cmd, log.t, axis=0)
    return log.q_cmd, log.dq_cmd


def _build_problems(
    log: Log, gravity: Array, held: bool, latency: float
) -> tuple[list[Array], list[Array]]:
    """Return columns (N, 5) and torques (N,) of each joint once the first commands act."""
    t = log.t - log.t[0]
    position, speed = compute_commands(log)
    command_times = t - latency
    is_after_start = t >= min(_MAX_LATENCY, 0.1 * t[-1])
    last_command = np.maximum(np.searchsorted(t, command_times + 1e-9, side="right") - 1, 0)
    assert log.dq is not None

    def delay_signal(signal: Array, *, is_held: bool) -> Array:
        if is_held:
            return np.asarray(signal[last_command])
        return np.asarray(np.interp(command_times, t, signal))

    columns = []
    targets = []
    for j in range(log.q.shape[1]):
        # A held velocity moves its integral along a line, a held position does not.
        is_held = held and log.q_cmd is not None
        error = delay_signal(position[:, j], is_held=is_held) - log.q[:, j]
        steps = 0.5 * (error[1:] + error[:-1]) * np.diff(t)
        integral = np.append(0.0, np.cumsum(steps)) * (log.q_cmd is not None)
        rate = delay_signal(speed[:, j], is_held=held) - log.dq[:, j]
        terms = [rate, error, integral, np.ones_like(t), gravity[:, j]]
        columns.append(np.column_stack(terms)[is_after_start])
        targets.append(log.tau[is_after_start, j])
    return columns, targets


def _compute_misfit(log: Log, gravity: Array, held: bool, latency: float) -> float:
    problems = zip(*_build_problems(log, gravity, held, latency), strict=True)
    return sum(float(np.log(_compute_residual(*problem).std() + 1e-12)) for problem in problems)


def _compute_residual(columns: Array, torque: Array) -> Array:
    scale = np.abs(columns).max(axis=0)
    scaled = columns[:, scale > 0.0] / scale[scale > 0.0]
    return np.asarray(torque - scaled @ np.linalg.lstsq(scaled, torque, rcond=None)[0])


def _fit_joint_servo(columns: Array, torque: Array) -> tuple[Array, Array, float, float]:
    """Return factors (3,), their covariance (3, 3), share of gravity, and explained variance."""
    gravity = columns[:, _GRAVITY]
    active = [0, *_INTEGRAL_GAINS, 3]
    # A share of constant gravity would be that of the offset.
    if np.ptp(gravity) > _MIN_GRAVITY_SHARE * np.ptp(torque):
        active.append(_GRAVITY)
    while True:
        active = [k for k in active if np.any(columns[:, k])]
        active_columns = columns[:, active]
        solution = np.linalg.lstsq(active_columns, torque, rcond=None)[0]
        residual = torque - active_columns @ solution
        labels = np.zeros(len(torque), dtype=int)
        names = [str(k) for k in active]
        matrix = covariance_of_fit(names, active_columns, residual, labels).matrix
        is_insignificant = solution < _MIN_GAIN_SIGNIFICANCE * np.sqrt(np.diag(matrix))
        insignificant = list(compress(active, is_insignificant))
        dropped_gains = [k for k in insignificant if k in _INTEGRAL_GAINS]
        if not dropped_gains:
            break
        # One at a time: without the last one, the other may become significant.
        active.remove(dropped_gains[-1])
    coefficients = np.zeros(len(columns.T))
    coefficients[active] = solution
    gains = [k for k in active if k < _FACTOR_COUNT]
    covariance = np.zeros((_FACTOR_COUNT, _FACTOR_COUNT))
    covariance[np.ix_(gains, gains)] = matrix[: len(gains), : len(gains)]
    gravity_share = 1.0
    if _GRAVITY in active:
        gravity_share = float(coefficients[_GRAVITY])
    variance = np.var(torque - gravity_share * gravity)
    explained = float(1.0 - residual.var() / variance)
    return coefficients[:_FACTOR_COUNT], covariance, gravity_share, explained
