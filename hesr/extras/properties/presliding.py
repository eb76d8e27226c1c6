"""Pre-sliding: position loop, and memory of reversals at two kinds of load."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import Scale, curve, judged, plot
from hesr_model.audit.properties import CLOSED, INNER, RATE, SMOOTH, PropertyResult
from hesr_model.support.arrays import Array

PERIOD = 4.0
SLOW_PERIOD = 40.0  # [s] of the loops
_CYCLES = 3  # the last one is measured
_JUMP = 5e-4
_STIFF = 0.025  # shares of a branch: end of a jump, and of the stiffness measurement
_BRANCH = np.concatenate([[_JUMP, 5e-3, _STIFF], np.linspace(0.05, 1.0, 39)])
_TURN = 0.75  # share of the rising branch before an inner loop
# Return path, in amplitudes of the outer loop.
_DEPTH = np.concatenate([[2.0 * _JUMP, 0.01], np.linspace(0.05, 0.5, 10)])
_TURNS = int(np.searchsorted(_BRANCH, _TURN))  # its row
_Moves = Sequence[tuple[float, Array]]  # directions, and displacements in widths of the outer loop
_INNER: _Moves = ((-1.0, 0.5 * _DEPTH), (1.0, 0.5 * _DEPTH))
_NESTED: _Moves = (_INNER[0], (1.0, 0.25 * _DEPTH), (-1.0, 0.25 * _DEPTH), _INNER[1])
_AT_ONCE = 0.99  # share of the height; a larger jump excludes pre-sliding
_LITTLE = 1e-9  # [N.m] minimum height of a loop


def presliding(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Move the joints back and forth by their deflection, fast and ten times slower."""
    fast, slow = (_loop(bench, scale, period, scale.load) for period in (PERIOD, SLOW_PERIOD))
    return [
        _slid(fast[:, joint], slow[:, joint], float(amplitude))
        for joint, amplitude in enumerate(scale.deflection)
    ]


def memory(
    bench: FrictionBench, scale: Scale, states: Sequence[int | None], peaks: Array | None = None
) -> list[PropertyResult]:
    """Reverse on the rising branch of a loop too slow for memory of time, return and continue.

    With `peaks` [N.m] reverse twice, in nested loops, while the load swings from half of it to it.
    """
    moves = _INNER if peaks is None else _NESTED
    innermost = loaded = np.zeros(bench.joints)
    if peaks is not None:
        loaded = np.ptp(_loop(bench, scale, SLOW_PERIOD, peaks), axis=0)
    loop = _loop(bench, scale, SLOW_PERIOD, scale.load if peaks is None else 0.5 * peaks)
    branch = partial(_branch, bench, scale, SLOW_PERIOD)
    branch(-1.0, _BRANCH)
    parts = [branch(1.0, _BRANCH[: _TURNS + 1])[-1:]]
    way = [np.zeros(1)]  # in amplitudes below the turning point
    for sign, shares in moves:
        rise = 0.5 - 0.5 * np.cos(2.0 * np.pi * shares / shares[-1])
        load = None if peaks is None else (0.5 + 0.5 * rise)[:, None] * peaks
        parts.append(branch(sign, shares, load))
        way.append(way[-1][-1] - 2.0 * sign * shares)
    if len(parts) > 3:
        innermost = parts[3][-1] - parts[1][-1]
    on = branch(1.0, _BRANCH[_TURNS + 1 :] - _BRANCH[_TURNS])
    inner = np.concatenate(parts)
    into = 2.0 * _TURN - 1.0 - np.concatenate(way)
    found = []
    for j, amplitude in enumerate(scale.deflection.tolist()):
        outer = loop[-len(_BRANCH) :, j]
        height = max(float(np.ptp(loop[:, j])), _LITTLE)
        miss = max(abs(float(inner[-1, j] - inner[0, j])), abs(float(innermost[j]))) / height
        onwards = float(np.max(np.abs(on[:, j] - outer[-len(on) :]))) / height
        depth = float(np.ptp(inner[:, j])) / max(height, float(loaded[j]))
        wrong = []
        if depth > INNER:
            wrong.append(f"The inner loop is as high as the outer one ({depth:.0%}): no memory.")
        if max(miss, onwards) > CLOSED:
            wrong.append(
                f"The inner loop misses its start by {miss:.1%} of the outer height, the branch "
                f"after it by up to {onwards:.1%}."
            )
        if wrong and states[j] == 1:
            wrong.append("One first-order state cannot have non-local memory.")
        if wrong and states[j] == 0:
            wrong.append("A law without a state has no memory.")
        # A loop as high as the outer one has no memory.
        closes = None if depth > INNER else miss
        curves = (
            curve("outer", 1e3 * amplitude * (2.0 * _BRANCH - 1.0), outer),
            curve("inner", 1e3 * amplitude * into, inner[:, j]),
        )
        found.append(
            judged(
                ("miss of the closed inner loop, of the height", closes, "1"),
                ("largest difference after it, of the height", onwards, "1"),
                ("height of the inner loop, of the outer", depth, "1"),
                wrong=wrong,
                plot=plot("position", "torque", *curves),
            )
        )
    return found


def _branch(
    bench: FrictionBench,
    scale: Scale,
    period: float,
    way: float,
    shares: Array,
    load: Array | None = None,
) -> Array:
    """Move by shares of the loop's width; return the torque (K, n)."""
    speed = way * 4.0 * scale.deflection / period
    dt = 0.5 * period * np.diff(shares, prepend=0.0)
    return bench.move(dt, np.broadcast_to(speed, (len(dt), len(speed))), load=load)


def _loop(bench: FrictionBench, scale: Scale, period: float, load: float | Array) -> Array:
    bench.start(load=load)
    _branch(bench, scale, period, 1.0, np.array([0.5]))
    for _ in range(_CYCLES):
        tau = [_branch(bench, scale, period, way, _BRANCH) for way in (-1.0, 1.0)]
    return np.concatenate(tau)


def _slid(fast: Array, slow: Array, amplitude: float) -> PropertyResult:
    half = len(_BRANCH)
    height = float(np.ptp(fast))
    rising = amplitude * (2.0 * _BRANCH - 1.0)
    x = np.concatenate([-rising, rising])
    area, slow_area = (
        float(np.trapezoid(np.append(tau, tau[0]), np.append(x, x[0]))) for tau in (fast, slow)
    )
    jump = float(fast[half - 1] - fast[half])
    at = int(np.searchsorted(_BRANCH, _STIFF))
    way = 2.0 * amplitude * (_BRANCH[at] - _BRANCH[0])
    stiffness = float(fast[half + at] - fast[half]) / way
    share = abs(jump) / height if height > _LITTLE else 0.0
    ratio = slow_area / area if abs(area) > _LITTLE * amplitude else 0.0
    wrong = []
    if area <= 0.0:
        wrong.append("The loop generates energy.")
    if share > _AT_ONCE:
        wrong.append("No pre-sliding: the torque reverses at once.")
    elif share > SMOOTH:
        wrong.append(f"The torque jumps by {share:.0%} of the loop's height at a reversal.")
    if stiffness < 0.0:
        wrong.append("After a reversal the torque changes in the wrong direction.")
    if abs(ratio - 1.0) > RATE:
        wrong.append(
            f"At a tenth of the speed the loop dissipates {ratio:.2g} times the work: it depends "
            "on velocity, not on position."
        )
    return judged(
        ("stiffness after a reversal", stiffness, "N.m/rad"),
        ("area of the loop", area, "J"),
        ("area at a tenth of the speed, relative", ratio, "1"),
        ("jump at a reversal, of the height", share, "1"),
        ("amplitude", amplitude, "rad"),
        wrong=wrong,
        plot=plot(
            "position",
            "torque",
            curve(f"{PERIOD:g} s", 1e3 * x, fast, closed=True),
            curve(f"{SLOW_PERIOD:g} s", 1e3 * x, slow, closed=True),
        ),
    )
