"""Rows of the least-squares problem of identification, and motions matched with reversed ones."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hesr_model.errors import FitError
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.base_parameters import find_independent_offsets, known_columns
from hesr_model.rigid_body.least_squares import Block
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import transform_motion
from hesr_model.support.arrays import Array, Integers, Mask, find_independent_columns

_MAX_SHIFT = 0.5  # latency [s] of command and measurement, which reversal keeps
_MAX_MISMATCH = 0.1  # position mismatch [rad]; 20 mrad are harmless


def match_motions(forward: Motion, backward: Motion) -> tuple[Motion, Motion]:
    """Match a motion with its counterpart at the best mirrored time; raises FitError."""
    from scipy.interpolate import make_interp_spline  # slow to import

    period = float(np.median(np.diff(forward.t)))
    max_step_count = int(_MAX_SHIFT / period)
    backward_q = make_interp_spline(backward.t, backward.q, k=1)
    mirrored_times = backward.t[-1] - (forward.t - forward.t[0])

    def compute_mismatch(shift: float) -> float:
        rows = _is_covered(mirrored_times + shift, backward.t)
        if np.sum(rows) < 0.5 * len(mirrored_times):
            return float("inf")
        distance = forward.q[rows] - backward_q(mirrored_times[rows] + shift)
        return float(np.sqrt(np.mean(distance**2)))

    shifts = period * np.arange(-max_step_count, max_step_count + 1)
    distances = [compute_mismatch(shift) for shift in shifts]
    best_row = int(np.argmin(distances))
    if not distances[best_row] <= _MAX_MISMATCH:
        raise FitError(
            f"log {backward.name}: is not the time-reversed counterpart of {forward.name}; "
            f"positions differ by {distances[best_row]:.3g} rad on average; at most "
            f"{_MAX_MISMATCH:g} rad is allowed."
        )
    times = mirrored_times + shifts[best_row]
    is_covered = _is_covered(times, backward.t)
    return forward.rows(is_covered), _resample(backward, times[is_covered])


def _is_covered(times: Array, t: Array) -> Mask:
    return np.asarray((times >= t[0]) & (times <= t[-1]))


def _resample(motion: Motion, times: Array) -> Motion:
    from scipy.interpolate import make_interp_spline

    orders = {"q": 3, "dq": 3, "ddq": 3, "tau": 1, "q_raw": 1}
    signals: dict[str, Any] = {
        name: make_interp_spline(motion.t, getattr(motion, name), k=order)(times)
        for name, order in orders.items()
    }
    return replace(motion, t=times, **signals)


SLOW = 0.1  # [rad/s, m/s]; slow friction depends on more than velocity
SLOW_SHARE = 0.25  # bound of `SLOW` over the peak speed, for slow joints such as lifts


def friction_speeds(motions: Sequence[Motion], robot: Robot) -> Array:
    """Return the velocities of friction coordinates, (N, n)."""
    dq = np.concatenate([motion.dq for motion in motions])
    return transform_motion(robot.description.coupling, dq)


def peak_speeds(motions: Sequence[Motion], robot: Robot) -> Array:
    """Return the peak speeds (n,) of friction coordinates."""
    return np.asarray(np.max(np.abs(friction_speeds(motions, robot)), axis=0))


def find_min_speeds(motions: Sequence[Motion], robot: Robot) -> Array:
    """Return the speeds (n,) at or below which friction coordinates rest in all motions."""
    return find_resting_speeds(
        [motion.t for motion in motions],
        [transform_motion(robot.description.coupling, motion.q_raw) for motion in motions],
        [friction_speeds([motion], robot) for motion in motions],
    )


def slow_speeds(peaks: Array) -> Array:
    """Return the speeds (n,) below which rows are dropped."""
    return np.minimum(SLOW, SLOW_SHARE * peaks)


def remove_known_torque(motions: Sequence[Motion], robot: Robot) -> list[Motion]:
    """Return motions without the torque of known parameters."""
    known_indices = known_columns(robot)
    if not known_indices:
        return list(motions)
    known_parameters = np.zeros_like(robot.nominal_parameters)
    known_parameters[known_indices] = robot.nominal_parameters[known_indices]
    return [
        replace(motion, tau=motion.tau - robot.torque(known_parameters, *motion.states))
        for motion in motions
    ]


def find_fast_rows(
    motions: Sequence[Motion], robot: Robot, min_speeds: Array | None = None
) -> list[Mask]:
    """Return whether each friction coordinate is faster than `min_speeds` (n,) in each row."""
    if min_speeds is None:
        min_speeds = slow_speeds(peak_speeds(motions, robot))
    return list(min_speeds[:, None] < np.abs(friction_speeds(motions, robot)).T)


def friction_columns(robot: Robot, base: tuple[int, ...]) -> Mask:
    """Return the Coulomb, viscous and offset columns (n, 3); no offset is a weight."""
    columns = np.ones((robot.n, 3), dtype=bool)
    columns[:, 2] = find_independent_offsets(robot, base)
    return columns


def find_determined_friction(motions: Sequence[Motion], robot: Robot) -> Mask:
    """Return whether motions tell each Coulomb, viscous and offset column (n, 3) from the others.

    One direction does not separate Coulomb friction from an offset, one speed not from viscous
    friction. Least squares could give both any size, with opposite signs.
    """
    if not motions:
        return np.ones((robot.n, 3), dtype=bool)
    dq = friction_speeds(motions, robot)
    is_determined = []
    for j, is_fast in enumerate(find_fast_rows(motions, robot)):
        is_determined.append(find_independent_columns(stack_friction(dq[is_fast, j])))
    return np.array(is_determined)


def stack_friction(dq: Array) -> Array:
    """Return the Coulomb, viscous and offset columns (N, 3) of a joint's velocity (N,)."""
    return np.column_stack([np.sign(dq), dq, np.ones_like(dq)])


def label_samples(motions: Sequence[Motion]) -> Integers:
    """Return the log number (N,) of each sample, shared by parts."""
    names = list(dict.fromkeys(motion.name for motion in motions))
    numbers = [names.index(motion.name) for motion in motions]
    return np.repeat(numbers, [len(motion.t) for motion in motions])


def arrange_by_joint(column_coefficients: Array, friction: Mask) -> Array:
    """Return coefficients of the columns `friction` (n, 3), else 0."""
    coefficients = np.zeros(friction.shape)
    coefficients[friction] = column_coefficients
    return coefficients


def stack_blocks(
    motions: Sequence[Motion],
    robot: Robot,
    base: tuple[int, ...],
    friction: Mask,
    min_speeds: Array | None = None,
) -> list[Block]:
    """Return a block per friction coordinate, of rows above `min_speeds`, friction columns last."""
    n = robot.n
    states_by_motion = [motion.states for motion in motions]
    states = list(map(np.concatenate, zip(*states_by_motion, strict=True)))
    dq = states[1]
    tau = np.concatenate([motion.tau for motion in motions])
    regressor = robot.regressor(*states)[:, :, list(base)]
    coupling = robot.description.coupling
    if coupling is not None:
        dq = coupling.motion(dq)
        tau = coupling.torque(tau)
        regressor = coupling.torque(regressor)
    blocks = []
    for j, is_fast in enumerate(find_fast_rows(motions, robot, min_speeds)):
        joint_dq = dq[is_fast, j]
        friction_rows = np.zeros((len(joint_dq), n, 3))
        friction_rows[:, j] = stack_friction(joint_dq)
        matrix = np.hstack([regressor[is_fast, j], friction_rows[:, friction]])
        blocks.append(Block(matrix=matrix, target=tau[is_fast, j], samples=np.flatnonzero(is_fast)))
    return blocks


def average_blocks(
    motions: Sequence[Motion], counterparts: Sequence[Motion], robot: Robot, base: tuple[int, ...]
) -> list[Block]:
    """Return one block per friction coordinate: means of forward and reversed rows.

    Only rows of opposite velocity are used. Raises FitError if the logs are not counterparts.
    """
    if not motions or len(motions) != len(counterparts):
        raise FitError(
            f"{len(motions)} logs come with {len(counterparts)} time-reversed ones; "
            "the paper's method needs one for each."
        )
    matched = list(map(match_motions, motions, counterparts))
    means = [_average_pair(forward, backward, robot) for forward, backward in matched]
    matrix = np.concatenate([regressor for regressor, _ in means])[:, :, list(base)]
    target = np.concatenate([tau for _, tau in means])
    coupling = robot.description.coupling
    if coupling is not None:
        matrix = coupling.torque(matrix)
        target = coupling.torque(target)
    min_speeds = slow_speeds(peak_speeds([*motions, *counterparts], robot))
    is_used = _find_opposite_rows(matched, min_speeds, robot)
    for joint, rows in zip(robot.description.joints, is_used.T, strict=True):
        if not np.any(rows):
            raise FitError(
                f"log {', '.join(motion.name for motion in motions)}: joint '{joint}' never moves "
                "against its time-reversed counterpart; both logs must move it."
            )
    samples = _number_matched_samples(motions, [forward for forward, _ in matched])
    return [
        Block(matrix=matrix[rows, j], target=target[rows, j], samples=samples[rows])
        for j, rows in enumerate(is_used.T)
    ]


def _average_pair(forward: Motion, backward: Motion, robot: Robot) -> tuple[Array, Array]:
    """Return regressor (N, n, P) and torque (N, n) [N.m], means of matched motions."""
    regressor = robot.regressor(*forward.states) + robot.regressor(*backward.states)
    return 0.5 * regressor, 0.5 * (forward.tau + backward.tau)


def _find_opposite_rows(
    matched: Sequence[tuple[Motion, Motion]], min_speeds: Array, robot: Robot
) -> Mask:
    """Return (N, n) whether both motions are faster than `min_speeds` (n,), and opposite."""
    forward_dq = friction_speeds([forward for forward, _ in matched], robot)
    backward_dq = friction_speeds([backward for _, backward in matched], robot)
    is_fast = np.minimum(np.abs(forward_dq), np.abs(backward_dq)) > min_speeds
    return np.asarray(is_fast & (forward_dq * backward_dq < 0))


def _number_matched_samples(motions: Sequence[Motion], matched: Sequence[Motion]) -> Integers:
    """Return the sample numbers, among all rows of motions, of those that are matched."""
    samples = []
    first_sample = 0
    for motion, matched_motion in zip(motions, matched, strict=True):
        samples.append(first_sample + np.flatnonzero(np.isin(motion.t, matched_motion.t)))
        first_sample += len(motion.t)
    return np.concatenate(samples)
