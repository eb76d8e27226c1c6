"""Mistakes in a robot file that explain the torques better than the file as it is.

Weights of the model file's rigid body and friction are non-negative, so wrong signs and swapped
columns fit badly.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hesr_model.findings import Finding
from hesr_model.fitting.joint_rows import non_negative_least_squares
from hesr_model.fitting.ties import ROUND_OFF
from hesr_model.health.evidence import Motionwise, Torques, rubbing
from hesr_model.health.mistakes import CandidateRows, Mistake, mistakes, torques_of
from hesr_model.health.positions import BEYOND
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import onto
from hesr_model.support.arrays import Array, Mask

_ROWS = 450  # total
_BETTER = 2.0  # minimum gain of a corrected joint
_NO_WORSE = 1.25  # largest loss of other joints
_EXPLAINED = 0.6  # minimum R^2 after the correction
_CLEARLY = 1.05  # minimum gain over a simpler mistake
_MOST = 8  # mistakes searched one after another


def pooled(motions: Sequence[Motionwise], gravity: Sequence[float]) -> CandidateRows:
    """Take equally many rows from each log."""
    each = [motion.thinned(max(_ROWS // len(motions), 60)) for motion in motions]
    q, v, a, tau = (
        np.concatenate([getattr(motion, name) for motion in each])
        for name in ("q", "v", "a", "tau")
    )
    return CandidateRows(q=q, v=v, a=a, tau=tau, gravity=np.array(gravity, dtype=float))


def check_causes(motions: Sequence[Motionwise], model: Robot) -> list[Finding]:
    """Find the mistakes that explain all logs best, the best first."""
    if not motions:
        return []
    moves = np.any([motion.moves for motion in motions], axis=0)
    moves &= np.any([np.ptp(motion.tau, axis=0) > 0.0 for motion in motions], axis=0)
    rows = pooled(motions, model.gravity.tolist())
    logged = model.description.logged
    rows = replace(rows, tau=logged.torque(rows.tau)) if logged else rows
    logs = tuple(dict.fromkeys(motion.log.name for motion in motions))
    findings: list[Finding] = []
    now = _unexplained(rows, model, moves)
    for _ in range(_MOST):
        best, left = _best(rows, now, model, moves)
        if best is None:
            break
        helped = int(np.argmax(now / left))
        findings.append(
            Finding(
                check=best.check,
                joints=(model.description.joints[best.joint],) if best.joint >= 0 else (),
                logs=logs,
                found=f"model and friction leave {100 * now[helped]:.0f} % of the torque of joint "
                f"'{model.description.joints[helped]}' unexplained; with the correction "
                f"{100 * left[helped]:.0f} %",
                remedy=best.remedy,
                changes=best.changes,
            )
        )
        rows, now = best.mended, left
    return findings


def _best(
    rows: CandidateRows, now: Array, model: Robot, moves: Mask
) -> tuple[Mistake | None, Array]:
    best, left, most = None, now, 0.0
    for mistake in mistakes(rows, model, moves):
        then = _unexplained(mistake.mended, model, moves)
        if _beyond(mistake.mended.q, model) > _beyond(rows.q, model) + BEYOND:
            continue
        gain = np.log(now / then)
        good = (gain > np.log(_BETTER)) & (1.0 - then**2 > _EXPLAINED)
        if not np.any(good) or np.min(gain) < -np.log(_NO_WORSE):
            continue
        if float(gain.sum()) > most * _CLEARLY:
            best, left, most = mistake, then, float(gain.sum())
        elif best and best.joint == mistake.joint and float(gain.sum()) * _CLEARLY > most:
            best = replace(best, remedy=_either(best))
    return best, left


def _beyond(q: Array, model: Robot) -> float:
    """Return the largest excess over the model's limits [rad or m]."""
    lower, upper, _ = model.limits
    return float(np.max(np.maximum(lower - q, q - upper), initial=0.0))


def _either(best: Mistake) -> str:
    if best.check != "torque-sign":
        return best.remedy
    return best.remedy.replace(
        "its torque counts backwards;",
        "its torque counts backwards, or its position and velocity do (the logs cannot show "
        "which);",
    )


def _unexplained(rows: CandidateRows, model: Robot, moves: Mask) -> Array:
    """Return the unexplained share (n,) of the torques' deviation."""
    torques, logged = torques_of(rows, model), model.description.logged
    torques, v = torques.at(logged) if logged else torques, onto(logged, rows.v)
    left = np.ones(rows.q.shape[1])
    for j in np.flatnonzero(moves):
        deviation = float(np.std(rows.tau[:, j]))
        left[j] = _left(rows.tau[:, j], torques, v, int(j)) / max(deviation, 1e-12)
    return left


def _left(tau: Array, torques: Torques, v: Array, j: int) -> float:
    known = np.column_stack([torques.gravity[:, j], torques.inertial[:, j]])
    # A torque of round-off must not be scaled up to explain noise.
    known[:, np.abs(known).max(axis=0) <= ROUND_OFF * np.abs(tau).max()] = 0.0
    columns = np.column_stack([known, rubbing(v[:, j]), np.ones(len(tau))])
    _, squares = non_negative_least_squares(columns, tau, non_negative=3)
    return float(np.sqrt(max(squares, 0.0) / len(tau))) + 1e-9
