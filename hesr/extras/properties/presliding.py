"""Pre-sliding: position loop, and memory of reversals at two kinds of load."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import Scale, curve, judge, plot
from hesr_model.audit.properties import (
    MAX_CLOSING_ERROR,
    MAX_INNER_HEIGHT,
    MAX_JUMP,
    MAX_RATE_CHANGE,
    PropertyResult,
)
from hesr_model.support.arrays import Array

PERIOD = 4.0  # [s] of a loop
SLOW_PERIOD = 40.0  # [s] of a loop at a tenth of the speed
_CYCLE_COUNT = 3  # the last one is measured
_JUMP_SHARE = 5e-4  # share of a branch at the end of a jump
_STIFFNESS_SHARE = 0.025  # share of a branch at the end of the stiffness measurement
_BRANCH_SHARES = np.concatenate([[_JUMP_SHARE, 5e-3, _STIFFNESS_SHARE], np.linspace(0.05, 1.0, 39)])
_TURNING_SHARE = 0.75  # share of the rising branch before an inner loop
# Return path, in amplitudes of the outer loop.
_RETURN_PATH = np.concatenate([[2.0 * _JUMP_SHARE, 0.01], np.linspace(0.05, 0.5, 10)])
_TURNING_ROW = int(np.searchsorted(_BRANCH_SHARES, _TURNING_SHARE))  # its row
_Moves = Sequence[tuple[float, Array]]  # directions, and displacements in widths of the outer loop
_INNER: _Moves = ((-1.0, 0.5 * _RETURN_PATH), (1.0, 0.5 * _RETURN_PATH))
_NESTED: _Moves = (_INNER[0], (1.0, 0.25 * _RETURN_PATH), (-1.0, 0.25 * _RETURN_PATH), _INNER[1])
_MAX_JUMP = 0.99  # share of the height; a larger jump excludes pre-sliding
_MIN_HEIGHT = 1e-9  # [N.m] minimum height of a loop


def presliding(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Move the joints back and forth by their deflection, fast and ten times slower."""
    fast = _run_loop(bench, scale, PERIOD, scale.load)
    slow = _run_loop(bench, scale, SLOW_PERIOD, scale.load)
    return [
        _judge_presliding(fast[:, j], slow[:, j], float(amplitude))
        for j, amplitude in enumerate(scale.deflection)
    ]


def memory(
    bench: FrictionBench,
    scale: Scale,
    state_counts: Sequence[int | None],
    peaks: Array | None = None,
) -> list[PropertyResult]:
    """Reverse on the rising branch of a loop too slow for memory of time, return and continue.

    With `peaks` [N.m] reverse twice, in nested loops, while the load swings from half of it to it.
    """
    if peaks is None:
        load_swing = np.zeros(bench.joints)
        loop = _run_loop(bench, scale, SLOW_PERIOD, scale.load)
    else:
        load_swing = np.ptp(_run_loop(bench, scale, SLOW_PERIOD, peaks), axis=0)
        loop = _run_loop(bench, scale, SLOW_PERIOD, 0.5 * peaks)
    path = _run_inner_loops(bench, scale, peaks)
    outer_branch = loop[-len(_BRANCH_SHARES) :]
    continuation_miss = path.continuation - outer_branch[-len(path.continuation) :]
    results = []
    for j, amplitude in enumerate(scale.deflection.tolist()):
        inner = path.inner[:, j]
        height = max(float(np.ptp(loop[:, j])), _MIN_HEIGHT)
        closing_miss = max(abs(float(inner[-1] - inner[0])), abs(float(path.innermost_miss[j])))
        closing_error = closing_miss / height
        continuation_error = float(np.max(np.abs(continuation_miss[:, j]))) / height
        depth = float(np.ptp(inner)) / max(height, float(load_swing[j]))
        faults = _judge_memory(closing_error, continuation_error, depth, state_counts[j])
        closing_figure: float | None = closing_error
        if depth > MAX_INNER_HEIGHT:  # without memory nothing closes
            closing_figure = None
        curves = (
            curve("outer", 1e3 * amplitude * (2.0 * _BRANCH_SHARES - 1.0), outer_branch[:, j]),
            curve("inner", 1e3 * amplitude * path.position, inner),
        )
        property_result = judge(
            ("miss of the closed inner loop, of the height", closing_figure, "1"),
            ("largest difference after it, of the height", continuation_error, "1"),
            ("height of the inner loop, of the outer", depth, "1"),
            faults=faults,
            plot=plot("position", "torque", *curves),
        )
        results.append(property_result)
    return results


class _InnerPath(NamedTuple):
    """Torques [N.m] of all joints on inner loops, and on the outer branch after them."""

    inner: Array  # (K, n), from the reversal on
    position: Array  # (K,) in amplitudes of the outer loop
    innermost_miss: Array  # (n,) of the closed innermost loop; 0 without one
    continuation: Array  # (L, n)


def _run_inner_loops(bench: FrictionBench, scale: Scale, peaks: Array | None) -> _InnerPath:
    """Leave the rising branch of the outer loop for inner ones, return to it and continue."""
    move = partial(_move_along_branch, bench, scale, SLOW_PERIOD)
    move(-1.0, _BRANCH_SHARES)
    torques = [move(1.0, _BRANCH_SHARES[: _TURNING_ROW + 1])[-1:]]
    displacements = [np.zeros(1)]  # in amplitudes below the turning point
    moves = _INNER if peaks is None else _NESTED
    for sign, shares in moves:
        load = None
        if peaks is not None:
            rise = 0.5 - 0.5 * np.cos(2.0 * np.pi * shares / shares[-1])
            load = (0.5 + 0.5 * rise)[:, None] * peaks
        torques.append(move(sign, shares, load))
        displacements.append(displacements[-1][-1] - 2.0 * sign * shares)
    innermost_miss = np.zeros(bench.joints)
    if peaks is not None:
        # The second and third moves are the innermost loop.
        innermost_miss = torques[3][-1] - torques[1][-1]
    continuation = move(1.0, _BRANCH_SHARES[_TURNING_ROW + 1 :] - _BRANCH_SHARES[_TURNING_ROW])
    return _InnerPath(
        inner=np.concatenate(torques),
        position=2.0 * _TURNING_SHARE - 1.0 - np.concatenate(displacements),
        innermost_miss=innermost_miss,
        continuation=continuation,
    )


def _judge_memory(
    closing_error: float, continuation_error: float, depth: float, state_count: int | None
) -> list[str]:
    """Return the faults of inner loops; errors and depth are shares of the outer height."""
    faults = []
    if depth > MAX_INNER_HEIGHT:
        faults.append(f"The inner loop is as high as the outer one ({depth:.0%}): no memory.")
    if max(closing_error, continuation_error) > MAX_CLOSING_ERROR:
        faults.append(
            f"The inner loop misses its start by {closing_error:.1%} of the outer height, the "
            f"branch after it by up to {continuation_error:.1%}."
        )
    if faults and state_count == 1:
        faults.append("One first-order state cannot have non-local memory.")
    if faults and state_count == 0:
        faults.append("A law without a state has no memory.")
    return faults


def _move_along_branch(
    bench: FrictionBench,
    scale: Scale,
    period: float,
    sign: float,
    shares: Array,
    load: Array | None = None,
) -> Array:
    """Move by shares of the loop's width; return the torque (K, n)."""
    speed = sign * 4.0 * scale.deflection / period
    dt = 0.5 * period * np.diff(shares, prepend=0.0)
    return bench.move(dt, np.broadcast_to(speed, (len(dt), len(speed))), load=load)


def _run_loop(bench: FrictionBench, scale: Scale, period: float, load: float | Array) -> Array:
    """Return the torque (K, n) of the last loop, first the falling branch, then the rising one."""
    bench.start(load=load)
    _move_along_branch(bench, scale, period, 1.0, np.array([0.5]))
    for _ in range(_CYCLE_COUNT):
        falling_torque = _move_along_branch(bench, scale, period, -1.0, _BRANCH_SHARES)
        rising_torque = _move_along_branch(bench, scale, period, 1.0, _BRANCH_SHARES)
    return np.concatenate([falling_torque, rising_torque])


def _judge_presliding(fast: Array, slow: Array, amplitude: float) -> PropertyResult:
    """Judge the torques (K,) of one joint in a fast and a slow loop."""
    half_rows = len(_BRANCH_SHARES)
    height = float(np.ptp(fast))
    rising_positions = amplitude * (2.0 * _BRANCH_SHARES - 1.0)
    positions = np.concatenate([-rising_positions, rising_positions])
    area = _integrate_loop(positions, fast)
    slow_area = _integrate_loop(positions, slow)
    jump = float(fast[half_rows - 1] - fast[half_rows])
    stiff_row = int(np.searchsorted(_BRANCH_SHARES, _STIFFNESS_SHARE))
    displacement = 2.0 * amplitude * (_BRANCH_SHARES[stiff_row] - _BRANCH_SHARES[0])
    stiffness = float(fast[half_rows + stiff_row] - fast[half_rows]) / displacement
    # Shares of a loop without height or area would be noise.
    jump_share = 0.0
    if height > _MIN_HEIGHT:
        jump_share = abs(jump) / height
    area_ratio = 0.0
    if abs(area) > _MIN_HEIGHT * amplitude:
        area_ratio = slow_area / area
    faults = []
    if area <= 0.0:
        faults.append("The loop generates energy.")
    if jump_share > _MAX_JUMP:
        faults.append("No pre-sliding: the torque reverses at once.")
    elif jump_share > MAX_JUMP:
        faults.append(f"The torque jumps by {jump_share:.0%} of the loop's height at a reversal.")
    if stiffness < 0.0:
        faults.append("After a reversal the torque changes in the wrong direction.")
    if abs(area_ratio - 1.0) > MAX_RATE_CHANGE:
        faults.append(
            f"At a tenth of the speed the loop dissipates {area_ratio:.2g} times the work: it "
            "depends on velocity, not on position."
        )
    return judge(
        ("stiffness after a reversal", stiffness, "N.m/rad"),
        ("area of the loop", area, "J"),
        ("area at a tenth of the speed, relative", area_ratio, "1"),
        ("jump at a reversal, of the height", jump_share, "1"),
        ("amplitude", amplitude, "rad"),
        faults=faults,
        plot=plot(
            "position",
            "torque",
            curve(f"{PERIOD:g} s", 1e3 * positions, fast, closed=True),
            curve(f"{SLOW_PERIOD:g} s", 1e3 * positions, slow, closed=True),
        ),
    )


def _integrate_loop(positions: Array, tau: Array) -> float:
    """Return the work [J] of a torque (K,) around a closed loop of positions (K,) [rad]."""
    closed_tau = np.append(tau, tau[0])
    return float(np.trapezoid(closed_tau, np.append(positions, positions[0])))
