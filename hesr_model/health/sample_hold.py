"""Raw signals: values that repeat, stick or jump, and speeds above the limit."""

from collections.abc import Iterator

import numpy as np

from hesr_model.findings import Finding, of_joint
from hesr_model.health.evidence import Motionwise
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Mask

_WINDOW = 0.1  # averaging window of a speed [s]
_MOVES = 0.05  # speed of a moving joint [rad/s; m/s]
_LEVELS = 200  # distinct values of a finely quantised signal
_HELD = 0.3  # share of repeated rows
_STUCK, _STUCK_ROWS = 0.3, 15  # duration [s] and rows of a stuck signal
_RARE, _MOVING = 10.0, 0.25  # stuck run over others, its share in motion
_SPIKE = 3.0  # torque spike over the range of other rows
_TOO_FAST = 1.3  # speed over the limit; drives exceed it slightly


def check_held(log: Log, robot: RobotDescription) -> Iterator[Finding]:
    """Check raw signals for held, stuck and outlying values."""
    if len(log.t) < 2 * _STUCK_ROWS:
        return
    moves = np.abs(_speeds(log)) > _MOVES
    fine = np.array([len(np.unique(column)) > _LEVELS for column in log.tau.T])
    yield from _repeated(log, moves, fine)
    for j, joint in enumerate(robot.joints):
        if log.dq is not None:
            row = _stands_still(log, log.q[:, j], np.abs(log.dq[:, j]) > _MOVES)
            if row is not None:
                yield _stuck(log, joint, "position", row, "its velocity is not zero")
        tau = log.tau[:, j]
        row = _stands_still(log, tau, moves[:, j]) if fine[j] else None
        if row is not None and abs(tau[row]) < np.max(np.abs(tau)):
            yield _stuck(log, joint, "torque", row, "it moves")
        low, high = np.quantile(log.tau[:, j], [0.01, 0.99])
        beside = 0.5 * (log.tau[:-2, j] + log.tau[2:, j])
        off = np.abs(log.tau[1:-1, j] - beside)
        alone = np.abs(log.tau[2:, j] - log.tau[:-2, j]) < 0.2 * off
        k = int(np.argmax(np.where(alone, off, 0.0)))
        if alone[k] and off[k] > _SPIKE * (high - low) > 0.0:
            found = f"its torque is {off[k]:.3g} off in a single row, at t = {log.t[k + 1]:.4g} s"
            yield of_joint("torque-spikes", joint, found, "that row is wrong; leave it out")


def _speeds(log: Log) -> Array:
    """Return speeds (N, n) of raw positions."""
    around = max(1, round(0.5 * _WINDOW / log.period))
    rows = np.arange(len(log.t))
    before, after = np.maximum(rows - around, 0), np.minimum(rows + around, len(rows) - 1)
    return np.asarray((log.q[after] - log.q[before]) / (log.t[after] - log.t[before])[:, None])


def _repeated(log: Log, moves: Mask, fine: Mask) -> Iterator[Finding]:
    if not np.any(fine):
        return
    rows = np.any(moves[1:], axis=1)
    if rows.sum() < _STUCK_ROWS:
        return
    same = np.all(np.diff(log.tau[:, fine], axis=0) == 0.0, axis=1)
    if (share := float(np.mean(same[rows]))) > _HELD:
        found = f"{100 * share:.0f} % of the rows in motion repeat the torques of the row before"
        remedy = "the log is faster than the robot's data; log at the robot's own rate"
        yield of_joint("held-samples", "", found, remedy, "warning")


def _stands_still(log: Log, values: Array, moves: Mask) -> int | None:
    edges = np.flatnonzero(np.diff(np.r_[False, np.diff(values) == 0.0, False].astype(int)))
    starts, lengths = edges[::2], edges[1::2] - edges[::2]
    if not len(starts):
        return None
    k = int(np.argmax(lengths))
    first, last = int(starts[k]), int(starts[k] + lengths[k])
    usual = float(np.quantile(np.delete(lengths, k), 0.95)) if len(lengths) > 1 else 1.0
    long = last - first >= max(_STUCK_ROWS, _RARE * usual)
    lasts = log.t[last] - log.t[first] > _STUCK
    return first if long and lasts and np.mean(moves[first:last]) > _MOVING else None


def _stuck(log: Log, joint: str, what: str, row: int, while_: str) -> Finding:
    found = f"its {what} is constant from t = {log.t[row]:.4g} s, while {while_}"
    remedy = "the sensor or its connection failed there; cut these rows out"
    return of_joint("stuck", joint, found, remedy)


def check_speed(motion: Motionwise, model: Robot) -> Iterator[Finding]:
    """Check speeds against the model's limits."""
    limits = np.where(np.isfinite(model.limits[2]), model.limits[2], 0.0)
    peaks = np.quantile(np.abs(motion.v), 0.998, axis=0)
    for j in np.flatnonzero(motion.moves & (limits > 0.0)):
        if peaks[j] <= _TOO_FAST * limits[j]:
            continue
        unit = "m/s" if model.slides[j] else "rad/s"
        times = f"{peaks[j] / limits[j]:.2g} times the model's limit"
        found = f"it reaches {peaks[j]:.3g} {unit}, {times}"
        remedy = "the time stamps come from a wrong sample rate, a unit is wrong, or the model's "
        yield of_joint("speed-limit", model.joints[j], found, f"{remedy}limits are", "warning")
