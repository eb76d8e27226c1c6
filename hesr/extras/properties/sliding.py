"""Sliding and rest without a plant: coupling, first torque, lag, chatter, work over cycles."""

from collections.abc import Callable
from functools import partial

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import SLIDING, Scale, curve, figures, judged, plot
from hesr_model.audit import audit
from hesr_model.audit.attack import loaded_motions
from hesr_model.audit.properties import (
    BEGINS,
    PASSIVE,
    QUIET,
    STEP,
    WIDTH,
    PropertyResult,
    PropertyVerdict,
)
from hesr_model.errors import SimulationError
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array

LEAST = 5e-5
MOST = 0.1  # [s] bounds of the step search
_COARSE = np.geomspace(LEAST, MOST, 24)
_HALVINGS = 5
_STEPS = 400  # minimum
_SLIDES = 5.0  # in stopping times at the friction level
_LONGEST = 2.0  # [s] run time
_QUIET = 1e-3
_STOPPED = 0.2  # shares of the first speed: rest, stop
_SMALL = 1e-6  # [rad/s]
_SWITCHES = 8  # sign changes in a row; a true stop has fewer


def coupling(bench: FrictionBench, scale: Scale, inertia: Array) -> list[PropertyResult]:
    """Slide joints of an inertia (n,) [kg.m2] to a stop, with many coupling steps."""
    slide = partial(_slide, bench, scale, inertia)
    bad: dict[float, Array] = {}
    stops = np.zeros(bench.joints, dtype=bool)
    for dt in _COARSE.tolist():
        dq = slide(dt)
        if not bad:
            stops = np.abs(dq[-1]) <= _STOPPED * np.abs(dq[0])
        bad[dt] = _chatters(dq)
        if all(any(of_joint) for of_joint in zip(*bad.values(), strict=True)):
            break
    either = np.full(bench.joints, _SMALL)
    ends = [bench.start(load=scale.load, dq=dq, unmoved=True) for dq in (either, -either)]
    slopes = (ends[0] - ends[1]) / (2.0 * _SMALL)  # at rest with fixed states; a jump is huge
    driven = ~stops & scale.drives
    dq = slide(max(STEP, LEAST))[: int(0.2 / STEP)]
    t = STEP * np.arange(len(dq), dtype=float)
    found = []
    for joint in range(bench.joints):
        first = next((dt for dt in bad if bad[dt][joint]), None)
        largest = _find_largest_step(slide, joint, list(bad), first)
        slope = float(slopes[joint])
        predicted = 2.0 * float(inertia[joint]) / slope if slope > 0.0 else None
        measured = figures(
            ("largest step without chatter", None if driven[joint] else largest, "s"),
            ("2 J / slope at rest", predicted, "s"),
            ("slope at rest", slope, "N.m.s/rad"),
        )
        shown = curve("at 1 ms", t, np.nan_to_num(dq[:, joint]), most=200)
        drawn = plot("time", "velocity", shown)
        verdict: PropertyVerdict = "fail"
        if driven[joint]:
            verdict = "not applicable"
            reason = "The joint does not stop at any step: the law drives it."
        elif largest is None:
            reason = f"It chatters even at the smallest step tried, {1e3 * LEAST:g} ms."
        elif largest < STEP:
            reason = "Coupled explicitly at 1 ms it chatters."
        else:
            verdict = "pass"
            reason = "No chatter up to the largest step tried." if largest == MOST else ""
        result = PropertyResult(verdict=verdict, figures=measured, reason=reason, plot=drawn)
        found.append(result)
    return found


def _slide(bench: FrictionBench, scale: Scale, inertia: Array, dt: float) -> Array:
    """Return the velocity (K, n) of joints that slide to a stop; NaN after a failure."""
    first = SLIDING * scale.speed
    slowest = float(np.max(inertia * first / np.maximum(scale.level, 1e-6 * inertia * first)))
    steps = max(_STEPS, int(np.ceil(min(_SLIDES * slowest, _LONGEST) / dt)))
    dq = np.full((steps + 1, bench.joints), np.nan)
    dq[0] = v = first
    q = bench.places.copy()
    # Start with the states of rest, which excite the slope at rest.
    tau = bench.start(load=scale.load, dq=v, unmoved=True)
    try:
        for k in range(1, steps + 1):
            v = v + dt / inertia * (scale.offset - tau)
            q = q + dt * v
            tau = bench.step(dt, v, q)
            dq[k] = v
    except SimulationError:
        pass  # later rows stay NaN
    return dq


def _chatters(dq: Array) -> Array:
    """Return whether the velocity of each joint alternates from step to step, (n,)."""
    loud = np.abs(dq) > _QUIET * np.abs(dq[0])
    turns = (dq[1:] * dq[:-1] < 0.0) & loud[1:] & loud[:-1]
    full = np.lib.stride_tricks.sliding_window_view(turns, _SWITCHES, axis=0).all(axis=-1)
    return np.asarray(full.any(axis=0) | ~np.isfinite(dq).all(axis=0))


def _find_largest_step(
    slide: Callable[[float], Array], joint: int, tried: list[float], first: float | None
) -> float | None:
    """Return the largest step [s] without chatter of a joint, below the `first` tried one with."""
    if first is None:
        return MOST
    if first == tried[0]:
        return None
    low = tried[tried.index(first) - 1]
    high = first
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        if _chatters(slide(middle))[joint]:
            high = middle
        else:
            low = middle
    return low


_SLOWEST = 0.01
_FASTEST = 0.11  # one-way motion, in trained speeds
_PERIODS = (1.0, 50.0)  # [s]
_ROWS = 500  # per period
_TURNS = 3  # periods; the last one is measured
_ROUNDING = 1e-9  # [N.m]
_ANGLES = (1e-5, 1e-4, 1e-3)
_PHASES = (0.5 * np.pi, 1.5 * np.pi)
_LOADED_TURNS = 20
_SHOWN = 400  # plotted rows
_STARTS = np.geomspace(0.05, 1.0, 5)  # in trained speeds
_LAST = 1e-3  # [s] before the steady torque is read, as short as a servo's
_NO_FRICTION = 1e-6  # [N.m]


def start(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Start at several speeds in both directions and slide on to the steady state."""
    dt = np.array([bench.forever, _LAST])
    ends = []
    for speed in _STARTS[:, None] * scale.speed:
        for dq in (speed, -speed):
            first = bench.start(load=scale.load, dq=dq)
            ends.append((first, bench.move(dt, np.broadcast_to(dq, (2, len(dq))))[-1]))
    both = np.array(ends).reshape(len(_STARTS), 2, 2, bench.joints)
    return [
        _started(scale.speed[j] * _STARTS, both[:, :, 0, j], both[:, :, 1, j])
        for j in range(bench.joints)
    ]


def _started(speeds: Array, first: Array, steady: Array) -> PropertyResult:
    """Judge (S, 2) first and steady torques at speeds (S,), forward and backward."""
    # Half the difference of both directions, free of the offset.
    friction = np.maximum(0.5 * np.abs(steady[:, 0] - steady[:, 1]), _NO_FRICTION)
    off = (first - steady) / friction[:, None]
    row, way = np.unravel_index(int(np.argmax(np.abs(off))), off.shape)
    worst = float(off[row, way])
    speed = float(speeds[row]) * (-1.0 if way else 1.0)
    said = f"At {speed:.3g} rad/s the first torque is off by {worst:.0%}."
    return judged(
        ("largest difference of the first torque, of the friction", abs(worst), "1"),
        ("at a velocity of", speed, "rad/s"),
        wrong=[] if abs(worst) <= BEGINS else [said],  # NaN fails
        plot=plot(
            "velocity",
            "torque",
            curve("first", speeds, first[:, 0]),
            curve("steady", speeds, steady[:, 0]),
        ),
    )


def lag(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Slide in one direction with oscillating speed, at two periods."""
    phase = 2.0 * np.pi / _ROWS * (np.arange(_ROWS * _TURNS) + 0.5)
    middle = 0.5 * (_FASTEST + _SLOWEST)
    half = 0.5 * (_FASTEST - _SLOWEST)
    dq = (middle - half * np.cos(phase))[:, None] * scale.speed
    found = []
    for period in _PERIODS:
        bench.start(load=scale.load)
        found.append(bench.move(np.full(len(dq), period / _ROWS), dq)[-_ROWS:])
    fast, slow = found
    return [
        _lagging(dq[-_ROWS:, j], fast[:, j], slow[:, j], float(scale.level[j]))
        for j in range(bench.joints)
    ]


def _widest(tau: Array) -> tuple[float, int]:
    """Return the largest distance of branches [N.m], + if acceleration is above, and its row."""
    # Rows k and -1 - k have the same speed.
    apart = tau[: _ROWS // 2] - tau[::-1][: _ROWS // 2]
    row = int(np.argmax(np.abs(apart)))
    width = float(apart[row])
    return (width if abs(width) > _ROUNDING else 0.0), row


def _lagging(dq: Array, fast: Array, slow: Array, level: float) -> PropertyResult:
    (width, row), (slow_width, _) = _widest(fast), _widest(slow)
    accelerating = slice(0, _ROWS // 2)
    mean = 0.5 * (slow + slow[::-1])[accelerating]
    slope = np.gradient(mean, dq[accelerating])
    wrong = []
    if width == 0.0:
        wrong.append("No lag: the torque follows the velocity at once.")
    else:
        if abs(width) < WIDTH * level:
            wrong.append(f"The branches are only {abs(width) / level:.2%} of the level apart.")
        # Parts of the torque may rise at once: one fall suffices.
        if (width > 0.0 and slope.min() >= 0.0) or (width < 0.0 and slope[row] <= 0.0):
            wrong.append("The torque leads the velocity instead of lagging behind it.")
        if abs(width) <= abs(slow_width):
            wrong.append("Faster changes of the speed do not widen the loop.")
    curves = (curve(f"{p:g} s", dq, tau) for p, tau in zip(_PERIODS, (fast, slow), strict=True))
    return judged(
        ("width of the loop at 1 Hz, + if acceleration is above", width, "N.m"),
        ("width at 0.02 Hz", slow_width, "N.m"),
        ("slope of the curve where it is widest", float(slope[row]), "N.m.s/rad"),
        wrong=wrong,
        plot=plot("velocity", "torque", *curves),
    )


def chatter(
    bench: FrictionBench, scale: Scale, trained: list[TrainedRange]
) -> list[PropertyResult]:
    """Rest under encoder noise, with the sample time and discretisation of the law."""
    noise = [audit.encoder_noise(trained_range) for trained_range in trained]
    dq, q = (np.column_stack([of_joint[part] for of_joint in noise]) for part in (0, 1))
    settling = noise[0][2]
    sample = trained[0].sample_time
    bench.start(load=scale.load, exact=False)
    tau = bench.move(np.full(len(dq), sample), dq, q)
    found = []
    for joint, level in enumerate(scale.level.tolist()):
        of_joint = tau[settling:, joint]
        deviation = float(np.std(of_joint))
        t = sample * np.arange(_SHOWN, dtype=float)
        said = f"That is {deviation / level:.0%} of the friction level."
        found.append(
            judged(
                ("standard deviation of the torque", deviation, "N.m"),
                wrong=[said] if deviation > QUIET * level else [],
                plot=plot("time", "torque", curve("at rest", t, of_joint[:_SHOWN], most=150)),
            )
        )
    return found


def work(
    bench: FrictionBench, trained: list[TrainedRange], loads: list[tuple[float, ...]]
) -> list[PropertyResult]:
    """Sum up the work of the audit's closed cycles under loads [N.m] by joint."""
    found: list[list[audit.Cycle]] = [[] for _ in trained]
    for wanted in audit.FREQUENCIES:
        motions = [
            audit.closed_motions(
                trained_range, np.multiply(audit.AMPLITUDES, trained_range.speed), wanted
            )
            for trained_range in trained
        ]
        for k in range(max(map(len, loads))):
            held = np.array([of_joint[min(k, len(of_joint) - 1)] for of_joint in loads])
            dq, q = (
                np.column_stack([getattr(m, part).ravel() for m in motions]) for part in ("dq", "q")
            )
            bench.start(load=held, exact=False, dq=dq[0])
            tau = bench.move(np.full(len(dq) - 1, trained[0].sample_time), dq[1:], q[1:])
            tau = np.concatenate([tau[:1], tau]).reshape(*motions[0].dq.shape, -1)
            for joint, motion in enumerate(motions):
                found[joint] += audit.cycles(motion, float(held[joint]), tau[:, :, joint])
    if any(len(of_joint) > 1 for of_joint in loads):
        for joint, under_load in enumerate(_with_moving_load(bench, trained)):
            found[joint] += under_load if len(loads[joint]) > 1 else []
    return [_worked(of_joint) for of_joint in found]


def _with_moving_load(bench: FrictionBench, trained: list[TrainedRange]) -> list[list[audit.Cycle]]:
    found: list[list[audit.Cycle]] = [[] for _ in trained]
    of_joints = (
        loaded_motions(trained_range, _ANGLES, _PHASES, _LOADED_TURNS) for trained_range in trained
    )
    for motions in zip(*of_joints, strict=True):
        dq, q, load = (
            np.column_stack([getattr(m, part) for m in motions]) for part in ("dq", "q", "load")
        )
        bench.start(load=load[0], exact=False, dq=dq[0])
        tau = bench.move(np.full(len(dq), trained[0].sample_time), dq, q, load)
        for joint, motion in enumerate(motions):
            rows = slice(-motion.rows, None)
            power = np.abs(tau[rows, joint] * motion.dq[rows]).sum() * trained[0].sample_time
            given = motion.given(tau[:, joint])
            found[joint].append(
                audit.Cycle(
                    amplitude=motion.cycle.amplitude,
                    frequency=motion.cycle.frequency,
                    tau_load=motion.cycle.mean,
                    swing=motion.cycle.swing,
                    work=-given if given else 0.0,
                    share=-given / power if given else 1.0,
                )
            )
    return found


def _worked(found: list[audit.Cycle]) -> PropertyResult:
    worst = min(found, key=lambda c: c.work)
    given = max(0.0, -worst.work)
    share = min(found, key=lambda c: c.share)
    gives = given > PASSIVE
    swings = f" while the load swings by {worst.swing:.3g} N.m" if worst.swing else ""
    said = f"A cycle at {worst.frequency:.2g} Hz generates {given:.3g} J{swings}."
    curves = []
    for frequency in sorted({c.frequency for c in found if not c.swing})[::2]:
        least: dict[float, float] = {}
        for c in found:
            if c.frequency == frequency and not c.swing:
                least[c.amplitude] = min(least.get(c.amplitude, 1.0), c.share)
        x, y = (np.array(part) for part in zip(*sorted(least.items()), strict=True))
        curves.append(curve(f"{frequency:.2g} Hz", x, y))
    return judged(
        ("most energy given in a cycle", given, "J"),
        ("amplitude of that cycle", worst.amplitude if gives else None, "rad/s"),
        ("smallest dissipated share of the work", share.share, "1"),
        ("at an amplitude of", share.amplitude, "rad/s"),
        ("at a frequency of", share.frequency, "Hz"),
        wrong=[said] if gives else [],
        plot=plot("amplitude", "work taken, share", *curves),
    )
