"""Uncertainty of the sliding torque due to lost rows."""

from collections.abc import Iterator

import numpy as np

from hesr_model.findings import Finding
from hesr_model.health.evidence import Motionwise, Torques
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Integers

_SKIPPED = 0.05  # allowed share of steps longer than 1.8 periods
_OFF_GRID = 0.2  # periods
_IRREGULAR = 0.2  # share of steps off the grid, above which stamps are irregular
_UNCERTAIN = 0.03  # allowed relative uncertainty, two standard deviations
_SPEEDS = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])  # shares of the peak speed
_JUDGED = (0.1, 0.7)  # shares where the joint slides
_SPLITS = 16
_HALF_WAY = 0.2  # reversal, as share of the slowest interval


def share_of_long_steps(log: Log) -> float:
    """Return the share of steps above 1.8 median periods, without gaps."""
    steps = np.diff(log.t)
    return float(np.mean(steps[steps <= log.longest_step] > 1.8 * log.period))


def loses_rows(log: Log) -> bool:
    """Return whether rows are missing throughout a log, whose stamps else keep to a grid."""
    if share_of_long_steps(log) <= _SKIPPED:
        return False
    steps = np.diff(log.t)
    periods = steps / np.median(steps[steps <= 1.5 * np.quantile(steps, 0.1)])
    return float(np.mean(np.abs(periods - np.rint(periods)) > _OFF_GRID)) < _IRREGULAR


def check_loss(motion: Motionwise, torques: Torques, model: Robot) -> Iterator[Finding]:
    """Check that the remaining rows determine each joint's sliding torque.

    Estimates with random halves of the rows differ by four times the variance of that with all
    rows.
    """
    if not loses_rows(motion.log):
        return
    for j in np.flatnonzero(motion.moves & (np.ptp(motion.tau, axis=0) > 0.0)):
        speeds, torque, deviation = _sliding(motion, torques, int(j))
        uncertain = 2.0 * deviation / np.maximum(np.abs(torque), 1e-300)
        worst = int(np.argmax(uncertain))
        if uncertain[worst] <= _UNCERTAIN:
            continue
        unit = "m/s" if model.slides[j] else "rad/s"
        yield Finding(
            check="missing-rows",
            joints=(model.description.joints[j],),
            found=f"many rows are missing; its sliding torque at {speeds[worst]:.2g} {unit} is "
            f"uncertain by {100 * min(uncertain[worst], 9.99):.2g} %",
            remedy=f"friction needs {100 * _UNCERTAIN:g} %; record without losses, or for longer",
        )


def _sliding(motion: Motionwise, torques: Torques, j: int) -> tuple[Array, Array, Array]:
    """Return speeds (K,), sliding torques and their deviation."""
    v, tau = motion.v[:, j], motion.tau[:, j]
    speeds = float(np.max(np.abs(v))) * _SPEEDS
    hats = np.stack([np.interp(np.abs(v), speeds, one) for one in np.eye(len(speeds))], axis=1)
    way = np.tanh(v / (_HALF_WAY * speeds[1]))
    columns = np.column_stack(
        [way[:, None] * hats, torques.gravity[:, j], torques.inertial[:, j], np.ones_like(v)]
    )

    def estimate(rows: Integers) -> Array:
        return np.asarray(np.linalg.lstsq(columns[rows], tau[rows], rcond=None)[0])

    rng, middle = np.random.default_rng(0), len(v) // 2
    differences = []
    for _ in range(_SPLITS):
        order = rng.permutation(len(v))
        differences.append(estimate(order[:middle]) - estimate(order[middle:]))
    steps = np.diff(motion.log.t)
    steps = steps[steps <= motion.log.longest_step]
    lost = 1.0 - float(np.quantile(steps, 0.1) / np.mean(steps))
    rows = len(v) / len(motion.log.t)
    deviation = np.std(differences, axis=0) * 0.5 * np.sqrt(lost * rows)
    judged = np.flatnonzero((_JUDGED[0] <= _SPEEDS) & (_JUDGED[1] >= _SPEEDS))
    return speeds[judged], estimate(np.arange(len(v)))[judged], deviation[judged]
