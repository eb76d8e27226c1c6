"""The servo of each joint, identified from the commands of a log.

    tau = share g(q) + kv (w - dq) + ki integral(w - dq),    w = dq_cmd + kp (q_cmd - q)

Commands act late; the servo compensates a share of gravity. With q_cmd it is a PID in the position.
"""

from dataclasses import dataclass, replace

import numpy as np

from hesr_model.errors import FitError
from hesr_model.inference.covariance import covariance_of_fit
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Numbers

_LATEST = 0.1  # longest latency [s]
_COARSE = 5e-4
_FINE = 10  # least step of a first search [s], and its parts in a second
_SURE = 2.0  # least size of a kept integral gain, in standard errors
_LEAST = 0.8  # least share of the torque without gravity that the servo explains
_TERMS = 3


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

    def drawn(self, generator: np.random.Generator) -> Array:
        """Return factors (n, 3) as likely as the identified ones; none is negative."""
        spread = [generator.multivariate_normal(np.zeros(_TERMS), c) for c in self.covariance]
        return np.maximum(self.factors + np.array(spread), 1e-9 * self.factors)


def cascade(factors: Array) -> tuple[Array, Array, Array]:
    """Return kv, ki and kp (n,) of the servo that is closest to `factors` (n, 3)."""
    kv, p, i = factors.T
    root = np.sqrt(np.maximum(p**2 - 4.0 * i * kv, 0.0))
    slow = np.where(i > 0.0, 0.5 * (p - root), p)
    return kv, slow, (p - slow) / kv


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
    dq = smooth(log).dq if log.dq is None else log.dq
    log = replace(log, dq=dq, dq_cmd=commanded(log)[1])  # once, for all latencies
    still = np.zeros_like(log.q)
    gravity = robot.torque(parameters, log.q, still, still)
    span = log.t[-1] - log.t[0]
    step = max(0.25 * log.period, _COARSE)
    coarse = np.arange(0.0, min(_LATEST, 0.1 * span), step)
    tried = [(held, latency) for held in (True, False) for latency in coarse]
    held, middle = min(tried, key=lambda one: _misfit(log, gravity, *one))
    near = middle + step * np.arange(-_FINE, _FINE + 1) / _FINE
    fine = [(held, latency) for latency in near[near >= 0.0]]
    held, latency = min(fine, key=lambda one: _misfit(log, gravity, *one))
    found = [_solved(*one) for one in zip(*_problems(log, gravity, held, latency), strict=True)]
    factors, covariances, shares, explained = map(np.array, zip(*found, strict=True))
    for joint, factor, share in zip(robot.joints, factors, explained, strict=True):
        if factor[0] <= 0.0 or share < _LEAST:
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


def commanded(log: Log) -> tuple[Array, Array]:
    """Return desired positions and velocities (N, n) of a log with commands."""
    if log.q_cmd is None:  # integrate from the first measured position
        assert log.dq_cmd is not None
        moved = np.cumsum(log.dq_cmd[:-1] * np.diff(log.t)[:, None], axis=0)
        return log.q[0] + np.vstack([np.zeros(log.q.shape[1]), moved]), log.dq_cmd
    return log.q_cmd, np.gradient(log.q_cmd, log.t, axis=0) if log.dq_cmd is None else log.dq_cmd


def _problems(log: Log, gravity: Array, held: bool, late: float) -> tuple[list[Array], list[Array]]:
    """Return columns (N, 5) and torques (N,) of each joint once the first commands act."""
    t = log.t - log.t[0]
    position, speed = commanded(log)
    past = t - late
    rows = t >= min(_LATEST, 0.1 * t[-1])
    place = np.maximum(np.searchsorted(t, past + 1e-9, side="right") - 1, 0)
    assert log.dq is not None

    def acting(values: Array, joint: int) -> Array:
        one = values[:, joint]
        return np.asarray(one[place] if held else np.interp(past, t, one))

    columns = []
    targets = []
    for j in range(log.q.shape[1]):
        # A held velocity moves its integral along a line, a held position does not.
        own = position[:, j]
        line = log.q_cmd is None or not held
        error = (np.interp(past, t, own) if line else own[place]) - log.q[:, j]
        steps = 0.5 * (error[1:] + error[:-1]) * np.diff(t)
        sums = np.append(0.0, np.cumsum(steps)) * (log.q_cmd is not None)
        rate = acting(speed, j) - log.dq[:, j]
        every = [rate, error, sums, np.ones_like(t), gravity[:, j]]
        columns.append(np.column_stack(every)[rows])
        targets.append(log.tau[rows, j])
    return columns, targets


def _misfit(log: Log, gravity: Array, held: bool, latency: float) -> float:
    problems = zip(*_problems(log, gravity, held, latency), strict=True)
    return sum(float(np.log(_residual(*one).std() + 1e-12)) for one in problems)


def _residual(columns: Array, torque: Array) -> Array:
    scale = np.abs(columns).max(axis=0)
    some = columns[:, scale > 0.0] / scale[scale > 0.0]
    return np.asarray(torque - some @ np.linalg.lstsq(some, torque, rcond=None)[0])


def _solved(columns: Array, torque: Array) -> tuple[Array, Array, float, float]:
    """Return factors (3,), their covariance (3, 3), share of gravity, and explained variance."""
    weight = columns[:, -1]
    used = [0, 1, 2, 3, 4] if np.ptp(weight) > 1e-3 * np.ptp(torque) else [0, 1, 2, 3]
    while True:
        used = [k for k in used if np.any(columns[:, k])]
        some = columns[:, used]
        x = np.linalg.lstsq(some, torque, rcond=None)[0]
        residual = torque - some @ x
        labels = np.zeros(len(torque), dtype=int)
        matrix = covariance_of_fit([str(k) for k in used], some, residual, labels).matrix
        unsure = x < _SURE * np.sqrt(np.diag(matrix))
        drop = [k for k, small in zip(used, unsure, strict=True) if small and k in (1, 2)]
        if not drop:
            break
        used.remove(drop[-1])
    whole = np.zeros(len(columns.T))
    spread = np.zeros((_TERMS, _TERMS))
    whole[used] = x
    gains = [k for k in used if k < _TERMS]
    spread[np.ix_(gains, gains)] = matrix[: len(gains), : len(gains)]
    share = whole[4] if 4 in used else 1.0
    beside = np.var(torque - share * weight)
    return whole[:_TERMS], spread, float(share), float(1.0 - residual.var() / beside)
