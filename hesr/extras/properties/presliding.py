"""Pre-sliding: position loop, and memory of reversals at two kinds of load."""

from collections.abc import Sequence
from functools import partial

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
    fast, slow = (_run_loop(bench, scale, period, scale.load) for period in (PERIOD, SLOW_PERIOD))
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
    moves = _INNER if peaks is None else _NESTED
    innermost = load_swing = np.zeros(bench.joints)
    if peaks is not None:
        load_swing = np.ptp(_run_loop(bench, scale, SLOW_PERIOD, peaks), axis=0)
    loop = _run_loop(bench, scale, SLOW_PERIOD, scale.load if peaks is None else 0.5 * peaks)
    move = partial(_move_along_branch, bench, scale, SLOW_PERIOD)
    move(-1.0, _BRANCH_SHARES)
    torques = [move(1.0, _BRANCH_SHARES[: _TURNING_ROW + 1])[-1:]]
    displacements = [np.zeros(1)]  # in amplitudes below the turning point
    for sign, shares in moves:
        rise = 0.5 - 0.5 * np.cos(2.0 * np.pi * shares / shares[-1])
        load = None if peaks is None else (0.5 + 0.5 * rise)[:, None] * peaks
        torques.append(move(sign, shares, load))
        displacements.append(displacements[-1][-1] - 2.0 * sign * shares)
    if len(torques) > 3:
        innermost = torques[3][-1] - torques[1][-1]
    continuation = move(1.0, _BRANCH_SHARES[_TURNING_ROW + 1 :] - _BRANCH_SHARES[_TURNING_ROW])
    inner = np.concatenate(torques)
    inner_path = 2.0 * _TURNING_SHARE - 1.0 - np.concatenate(displacements)
    results = []
    for j, amplitude in enumerate(scale.deflection.tolist()):
        outer = loop[-len(_BRANCH_SHARES) :, j]
        height = max(float(np.ptp(loop[:, j])), _MIN_HEIGHT)
        closing_error = (
            max(abs(float(inner[-1, j] - inner[0, j])), abs(float(innermost[j]))) / height
        )
        continuation_error = (
            float(np.max(np.abs(continuation[:, j] - outer[-len(continuation) :]))) / height
        )
        depth = float(np.ptp(inner[:, j])) / max(height, float(load_swing[j]))
        faults = []
        if depth > MAX_INNER_HEIGHT:
            faults.append(f"The inner loop is as high as the outer one ({depth:.0%}): no memory.")
        if max(closing_error, continuation_error) > MAX_CLOSING_ERROR:
            faults.append(
                f"The inner loop misses its start by {closing_error:.1%} of the outer height, the "
                f"branch after it by up to {continuation_error:.1%}."
            )
        if faults and state_counts[j] == 1:
            faults.append("One first-order state cannot have non-local memory.")
        if faults and state_counts[j] == 0:
            faults.append("A law without a state has no memory.")
        # A loop as high as the outer one has no memory.
        closing_figure = None if depth > MAX_INNER_HEIGHT else closing_error
        curves = (
            curve("outer", 1e3 * amplitude * (2.0 * _BRANCH_SHARES - 1.0), outer),
            curve("inner", 1e3 * amplitude * inner_path, inner[:, j]),
        )
        results.append(
            judge(
                ("miss of the closed inner loop, of the height", closing_figure, "1"),
                ("largest difference after it, of the height", continuation_error, "1"),
                ("height of the inner loop, of the outer", depth, "1"),
                faults=faults,
                plot=plot("position", "torque", *curves),
            )
        )
    return results


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
    bench.start(load=load)
    _move_along_branch(bench, scale, period, 1.0, np.array([0.5]))
    for _ in range(_CYCLE_COUNT):
        tau = [
            _move_along_branch(bench, scale, period, sign, _BRANCH_SHARES) for sign in (-1.0, 1.0)
        ]
    return np.concatenate(tau)


def _judge_presliding(fast: Array, slow: Array, amplitude: float) -> PropertyResult:
    half_rows = len(_BRANCH_SHARES)
    height = float(np.ptp(fast))
    rising_positions = amplitude * (2.0 * _BRANCH_SHARES - 1.0)
    positions = np.concatenate([-rising_positions, rising_positions])
    area, slow_area = (
        float(np.trapezoid(np.append(tau, tau[0]), np.append(positions, positions[0])))
        for tau in (fast, slow)
    )
    jump = float(fast[half_rows - 1] - fast[half_rows])
    stiff_row = int(np.searchsorted(_BRANCH_SHARES, _STIFFNESS_SHARE))
    displacement = 2.0 * amplitude * (_BRANCH_SHARES[stiff_row] - _BRANCH_SHARES[0])
    stiffness = float(fast[half_rows + stiff_row] - fast[half_rows]) / displacement
    jump_share = abs(jump) / height if height > _MIN_HEIGHT else 0.0
    area_ratio = slow_area / area if abs(area) > _MIN_HEIGHT * amplitude else 0.0
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
