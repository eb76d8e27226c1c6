"""Largest step for explicit coupling of a friction FMU to the inertia of a joint."""

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import SLIDING, Scale, curve, figures, plot
from hesr_model.audit.properties import STEP, PropertyResult, PropertyVerdict
from hesr_model.errors import SimulationError
from hesr_model.support.arrays import Array

LEAST, MOST = 5e-5, 0.1  # [s] bounds of the step search
_COARSE = np.geomspace(LEAST, MOST, 24)
_HALVINGS = 5
_STEPS = 400  # minimum
_SLIDES = 5.0  # in stopping times at the friction level
_LONGEST = 2.0  # [s] run time
_QUIET, _STOPPED = 1e-3, 0.2  # shares of the first speed: rest, stop
_SMALL = 1e-6  # [rad/s]
_TURNS = 8  # sign changes in a row; a true stop has fewer


def coupling(bench: FrictionBench, scale: Scale, inertia: Array) -> list[PropertyResult]:
    """Slide joints of an inertia (n,) [kg.m2] to a stop, with many coupling steps."""
    bad: dict[float, Array] = {}
    stops = np.zeros(bench.joints, dtype=bool)
    for dt in _COARSE.tolist():
        dq = _slide(bench, scale, inertia, dt)
        if not bad:
            stops = np.abs(dq[-1]) <= _STOPPED * np.abs(dq[0])
        bad[dt] = _chatters(dq)
        if all(any(of_joint) for of_joint in zip(*bad.values(), strict=True)):
            break
    slopes = _slopes(bench, scale)
    driven = ~stops & scale.drives
    found = []
    for joint in range(bench.joints):
        first = next((dt for dt in bad if bad[dt][joint]), None)
        largest = _refined(bench, scale, inertia, joint, list(bad), first)
        slope = float(slopes[joint])
        predicted = 2.0 * float(inertia[joint]) / slope if slope > 0.0 else None
        shown = _slide(bench, scale, inertia, max(STEP, LEAST))[:, joint]
        found.append(_judged(bool(driven[joint]), largest, predicted, slope, shown))
    return found


def _slopes(bench: FrictionBench, scale: Scale) -> Array:
    """Return d tau / d dq (n,) at rest with the states fixed; a jump makes it huge."""
    either = np.full(bench.joints, _SMALL)
    ends = [bench.start(load=scale.load, dq=dq, unmoved=True) for dq in (either, -either)]
    return np.asarray((ends[0] - ends[1]) / (2.0 * _SMALL))


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
    full = np.lib.stride_tricks.sliding_window_view(turns, _TURNS, axis=0).all(axis=-1)
    return np.asarray(full.any(axis=0) | ~np.isfinite(dq).all(axis=0))


def _refined(
    bench: FrictionBench,
    scale: Scale,
    inertia: Array,
    joint: int,
    tried: list[float],
    first: float | None,
) -> float | None:
    if first is None:
        return MOST
    if first == tried[0]:
        return None
    low, high = tried[tried.index(first) - 1], first
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        if _chatters(_slide(bench, scale, inertia, middle))[joint]:
            high = middle
        else:
            low = middle
    return low


def _judged(
    driven: bool, largest: float | None, predicted: float | None, slope: float, shown: Array
) -> PropertyResult:
    measured = figures(
        ("largest step without chatter", None if driven else largest, "s"),
        ("2 J / slope at rest", predicted, "s"),
        ("slope at rest", slope, "N.m.s/rad"),
    )
    end = min(len(shown), int(0.2 / STEP))
    t = STEP * np.arange(end, dtype=float)
    drawn = plot("time", "velocity", curve("at 1 ms", t, np.nan_to_num(shown[:end]), most=200))
    verdict: PropertyVerdict = "fail"
    if driven:
        verdict, reason = (
            "not applicable",
            "The joint does not stop at any step: the law drives it.",
        )
    elif largest is None:
        reason = f"It chatters even at the smallest step tried, {1e3 * LEAST:g} ms."
    elif largest < STEP:
        reason = "Coupled explicitly at 1 ms it chatters."
    else:
        verdict = "pass"
        reason = "No chatter up to the largest step tried." if largest == MOST else ""
    return PropertyResult(verdict=verdict, figures=measured, reason=reason, plot=drawn)
