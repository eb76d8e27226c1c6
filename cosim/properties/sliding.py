"""Sliding and rest without a plant: frictional lag, chatter under noise, work over cycles."""

import numpy as np

from cosim.properties.bench import FrictionBench
from cosim.properties.findings import curve, judged, plot
from cosim.properties.scale import Scale
from hesr_model.audit.attack import loaded_motions
from hesr_model.audit.cycles import (
    AMPLITUDES,
    FREQUENCIES,
    ClosedMotions,
    Cycle,
    closed_motions,
    cycles,
    encoder_noise,
)
from hesr_model.audit.expectations import PASSIVE, QUIET, WIDTH
from hesr_model.audit.properties import PropertyResult
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array

_SLOWEST, _FASTEST = 0.01, 0.11  # of the one-way motion, as shares of the trained speed
_PERIODS = (1.0, 50.0)  # [s] of it
_ROWS = 500  # of a period
_TURNS = 3  # periods, of which the last is measured
_ROUNDING = 1e-9  # [N.m]
_ANGLES, _PHASES, _LOADED_TURNS = (1e-5, 1e-4, 1e-3), (0.5 * np.pi, 1.5 * np.pi), 20
_SHOWN = 400  # rows of the noisy rest that are drawn


def lag(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Slide one way, faster and slower in turn, once a second and once in fifty."""
    phase = 2.0 * np.pi / _ROWS * (np.arange(_ROWS * _TURNS) + 0.5)
    middle, half = 0.5 * (_FASTEST + _SLOWEST), 0.5 * (_FASTEST - _SLOWEST)
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
    """Return the largest distance of the branches [N.m], positive where acceleration is above.

    Rows lie symmetrically: row k accelerates through the speed of row -1 - k. The row is returned
    with it.
    """
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
        wrong.append("There is no lag: the torque follows the velocity at once.")
    else:
        if abs(width) < WIDTH * level:
            wrong.append(f"The branches are only {abs(width) / level:.2%} of the level apart.")
        # Part of the torque may lag and another part rise at once, so a fall anywhere will do.
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
    """Rest under encoder noise, at the law's own sample time and discretisation."""
    noise = [encoder_noise(seen) for seen in trained]
    dq, q = (np.column_stack([of_joint[part] for of_joint in noise]) for part in (0, 1))
    settling, sample = noise[0][2], trained[0].sample_time
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
    """Run closed cycles of the audit's amplitudes and frequencies, and sum up their work.

    Parameters
    ----------
    bench : with the FMU.
    trained : ranges of each joint, of one sample time.
    loads : loads at which each joint is run [N.m].
    """
    found: list[list[Cycle]] = [[] for _ in trained]
    for wanted in FREQUENCIES:
        motions = [closed_motions(r, np.multiply(AMPLITUDES, r.speed), wanted) for r in trained]
        for k in range(max(map(len, loads))):
            held = np.array([of_joint[min(k, len(of_joint) - 1)] for of_joint in loads])
            tau = _run(bench, motions, held, trained[0].sample_time)
            for joint, motion in enumerate(motions):
                found[joint] += cycles(motion, float(held[joint]), tau[:, :, joint])
    if any(len(of_joint) > 1 for of_joint in loads):
        for joint, under_load in enumerate(_with_moving_load(bench, trained)):
            found[joint] += under_load if len(loads[joint]) > 1 else []
    return [_worked(of_joint) for of_joint in found]


def _with_moving_load(bench: FrictionBench, trained: list[TrainedRange]) -> list[list[Cycle]]:
    """Return cycles in which loads move at twice the motion's rate, for each joint."""
    found: list[list[Cycle]] = [[] for _ in trained]
    of_joints = (loaded_motions(r, _ANGLES, _PHASES, _LOADED_TURNS) for r in trained)
    for motions in zip(*of_joints, strict=True):
        dq, q, load = (
            np.column_stack([getattr(m, part) for m in motions]) for part in ("dq", "q", "load")
        )
        bench.start(load=load[0], exact=False, dq=dq[0])
        dt = np.full(len(dq), trained[0].sample_time)
        tau = bench.move(dt, dq, q, load)
        for joint, motion in enumerate(motions):
            rows = slice(-motion.rows, None)
            power = np.abs(tau[rows, joint] * motion.dq[rows]).sum() * trained[0].sample_time
            given = motion.given(tau[:, joint])
            found[joint].append(
                Cycle(
                    amplitude=motion.cycle.amplitude,
                    frequency=motion.cycle.frequency,
                    tau_load=motion.cycle.mean,
                    swing=motion.cycle.swing,
                    work=-given if given else 0.0,
                    share=-given / power if given else 1.0,
                )
            )
    return found


def _run(bench: FrictionBench, motions: list[ClosedMotions], load: Array, sample: float) -> Array:
    """Return the torque (A, K, n) of motions run one after the other, as the audit does."""
    dq, q = (np.column_stack([getattr(m, part).ravel() for m in motions]) for part in ("dq", "q"))
    bench.start(load=load, exact=False, dq=dq[0])
    tau = bench.move(np.full(len(dq) - 1, sample), dq[1:], q[1:])
    first = tau[:1]  # long before what is measured
    return np.concatenate([first, tau]).reshape(*motions[0].dq.shape, -1)


def _worked(found: list[Cycle]) -> PropertyResult:
    worst = min(found, key=lambda c: c.work)
    given = max(0.0, -worst.work)
    share = min(found, key=lambda c: c.share)
    gives = given > PASSIVE
    swings = f" while the load swings by {worst.swing:.3g} N.m" if worst.swing else ""
    said = f"A cycle at {worst.frequency:.2g} Hz gives {given:.3g} J{swings}."
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
        ("least share of the work that is taken", share.share, "1"),
        ("at an amplitude of", share.amplitude, "rad/s"),
        ("at a frequency of", share.frequency, "Hz"),
        wrong=[said] if gives else [],
        plot=plot("amplitude", "work taken, share", *curves),
    )
