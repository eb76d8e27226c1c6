"""Audit of a friction law: does it brake, how steep is it at rest, does it stay in bounds.

A law may predict torque well and still be no friction: published ones drive the joint at low
speed, generate energy, chatter on encoder noise or explode just outside their training data. The
audit measures this on the law as it runs, at its own sample time and discretisation.

A constant offset, and any torque of position alone, can make torque and velocity of unlike sign
without ever giving net energy. Steady sliding is therefore reported twice, with them (`driving`)
and without (`driving_both_ways`); over a closed cycle they do no work, so they count for nothing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from hesr_model.audit.cycles import (
    AMPLITUDES,
    FREQUENCIES,
    ClosedMotions,
    Cycle,
    closed_motions,
    cycles,
    encoder_noise,
)
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import Range, TrainedRange
from hesr_model.support.arrays import Array

SLOWEST = 1e-3
"""Slowest steady speed looked at, as a share of the largest trained speed."""
REACH = 1.5
"""How far "just outside" is, in trained speeds and in half widths of the trained load."""
EXPLODES = 2.5
"""A torque just outside that is larger than this many times the largest trained one is refused.
Viscous friction gives up to 1.5 times, quadratic or load-dependent viscous friction 2.25 times."""
_STEADY = 1e6  # [s] after which sliding is steady, even at the slowest speed
_POSITIONS = 32  # over which steady torque is averaged, where a law knows the position
_NUMERICAL = 1e-9  # [N.m]; a lesser difference is taken for rounding
_SMALL, _SMALLER = 1e-6, 1e-9  # [rad/s] to either side of rest; no smooth law bends within


@dataclass(frozen=True, kw_only=True)
class Audit:
    """What is to be known of a law before it is trusted.

    Attributes
    ----------
    driving : velocity ranges [rad/s] in which steady sliding torque has the sign that drives,
        tau dq < 0, at a trained load; an offset counts.
    driving_both_ways : ranges of speed [rad/s] at which steady sliding to and fro at that speed
        gives energy, |dq| (tau(|dq|) - tau(-|dq|)) / 2 < 0; an offset does not count.
    generated : most energy that a closed cycle of the grid gives [J], 0 for a passive law.
    generating : the cycle that gives it, None for a passive law.
    jump : step of the torque across zero velocity [N.m].
    slope : d tau / d dq at rest from the start states, before they move [N.m.s/rad]; None where
        the torque jumps. A joint of inertia J that is coupled explicitly needs a step of at most
        2 J / slope.
    slope_of_step : the same for a velocity held over one sample, in which the states move.
    chatter : standard deviation of the torque at rest [N.m] under white encoder noise of
        `ENCODER`, the velocity being its backward difference.
    largest : largest |tau| [N.m] within the trained speeds and loads.
    largest_outside : the same up to `REACH` times beyond them; None where it is not finite.
    explodes : whether `largest_outside` disqualifies the law.
    """

    driving: tuple[Range, ...]
    driving_both_ways: tuple[Range, ...]
    generated: float
    generating: Cycle | None
    jump: float
    slope: float | None
    slope_of_step: float | None
    chatter: float
    largest: float
    largest_outside: float | None
    explodes: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class _Response:
    """Torque (A, K) over motions at a constant load."""

    motions: ClosedMotions
    tau_load: float
    tau: Array


def audit(law: FrictionLaw, trained: TrainedRange) -> Audit:
    """Audit the law of one joint.

    Parameters
    ----------
    law : any law; the inputs that it does not use are left out of the grid.
    trained : ranges of the records that it was fitted to.

    Raises
    ------
    SimulationError
        If the torque is not finite, or the discretisation not stable, within the trained range.
    """
    loads = loads_of(law, trained)
    responses = list(_responses(law, trained, np.multiply(AMPLITUDES, trained.speed), loads))
    largest = _largest(responses)
    if not isfinite(largest):
        raise SimulationError(f"law '{law.name}': torque is not finite within the trained range.")
    outside = _largest_outside(law, trained)
    driving, both_ways = _steady(law, trained, loads)
    cycle = min(
        (c for r in responses for c in cycles(r.motions, r.tau_load, r.tau)), key=lambda c: c.work
    )
    generating = cycle if cycle.work < 0.0 else None
    jump, slope = _at_rest(law, trained, loads, 0.0)
    _, slope_of_step = _at_rest(law, trained, loads, trained.sample_time)
    return Audit(
        driving=driving,
        driving_both_ways=both_ways,
        generated=-generating.work if generating else 0.0,
        generating=generating,
        jump=jump,
        slope=slope,
        slope_of_step=slope_of_step,
        chatter=max(_chatter(law, trained, load) for load in loads),
        largest=largest,
        largest_outside=max(largest, outside) if isfinite(outside) else None,
        explodes=_too_large(outside, trained),
    )


def explodes(law: FrictionLaw, trained: TrainedRange) -> bool:
    """Whether a law's torque just outside the trained range is too large to trust, or not finite.

    To refuse candidates of a search: |tau| over cycles of all frequencies and up to `REACH` times
    the trained speed and load, against `EXPLODES` times the largest trained |tau|.
    """
    return _too_large(_largest_outside(law, trained), trained)


def loads_of(law: FrictionLaw, trained: TrainedRange, reach: float = 1.0) -> tuple[float, ...]:
    """Return the least, the smallest and the greatest load; only one where the law uses none.

    Between these, friction that depends on the load is monotonic as a rule.
    """
    low, high = trained.tau_load
    beyond = (reach - 1.0) * (high - low) / 2.0
    smallest = min(max(0.0, low), high)
    if TAU_LOAD not in law.form.inputs:
        return (smallest,)
    return tuple(sorted({low - beyond, smallest, high + beyond}))


def _run(law: FrictionLaw, t: Array, dq: Array, q: Array, load: float | Array) -> Array:
    """Predict where inputs may be far off: an overflow is a finding here, not a warning."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return predict(law, t=t, dq=dq, q=q, tau_load=np.broadcast_to(load, t.shape))


def _responses(
    law: FrictionLaw, trained: TrainedRange, amplitudes: Array, loads: Sequence[float]
) -> Iterator[_Response]:
    """Run the law over cycles of every frequency and load, all amplitudes in one go."""
    for wanted in FREQUENCIES:
        motions = closed_motions(trained, amplitudes, wanted)
        t: Array = trained.sample_time * np.arange(motions.dq.size, dtype=float)
        for load in loads:
            tau = _run(law, t, motions.dq.ravel(), motions.q.ravel(), load)
            yield _Response(motions=motions, tau_load=load, tau=tau.reshape(motions.dq.shape))


def _largest(responses: Sequence[_Response]) -> float:
    """Return the largest |tau| of settled cycles, not a number if any torque is none.

    Before that, the torque also answers the jump to full speed with which a run begins.
    """
    return float(np.max([np.max(np.abs(r.tau[:, -r.motions.rows :])) for r in responses]))


def _largest_outside(law: FrictionLaw, trained: TrainedRange) -> float:
    """Return the largest |tau| up to `REACH` times outside, infinite where it cannot be run."""
    amplitudes = trained.speed * np.linspace(1.0, REACH, 3)
    try:
        return _largest(list(_responses(law, trained, amplitudes, loads_of(law, trained, REACH))))
    except SimulationError:
        return np.inf


def _too_large(torque: float, trained: TrainedRange) -> bool:
    # Not a number is too large as well.
    return not torque <= EXPLODES * max(map(abs, trained.tau))


def _steady(
    law: FrictionLaw, trained: TrainedRange, loads: Sequence[float]
) -> tuple[tuple[Range, ...], tuple[Range, ...]]:
    """Return the velocities and the speeds at which steady sliding drives the joint."""
    linear, slow = np.linspace(0.0, 1.0, 121)[1:], np.geomspace(SLOWEST, 1.0, 61)
    speeds = trained.speed * np.union1d(linear, slow)
    velocities = np.concatenate([-speeds[::-1], speeds])
    known = _POSITIONS if Q in law.form.inputs else 1
    # Multiples of the golden ratio keep out of step with any ripple.
    places = trained.q[0] + np.ptp(trained.q) * ((0.5 + np.arange(known) * 0.6180339887) % 1.0)
    v, load, q = (
        part.ravel() for part in np.meshgrid(velocities, np.array(loads), places, indexing="ij")
    )
    # Held for ever, states reach drive / rate in one exact step from wherever they were; the
    # first row has no step before it and is repeated for that.
    settled = replace(law, discretisation="exact")
    rows = np.concatenate([[0], np.arange(len(v))])
    t = _STEADY * np.arange(len(rows), dtype=float)
    tau = _run(settled, t, v[rows], q[rows], load[rows])[1:]
    tau = tau.reshape(len(velocities), len(loads), known).mean(axis=2)
    power = (tau * velocities[:, None]).min(axis=1)
    round_trip = (speeds[:, None] * (tau - tau[::-1])[len(speeds) :]).min(axis=1)
    return _negative(velocities, power), _negative(speeds, round_trip)


def _negative(v: Array, power: Array) -> tuple[Range, ...]:
    """Return the ranges of v with negative power; power crosses zero linearly or at rest."""
    inside = np.concatenate([[False], power < 0.0, [False]])
    edges = []
    for k in np.flatnonzero(inside[1:] != inside[:-1]):
        if k == 0:
            edges.append(min(float(v[0]), 0.0))
        elif k == len(v):
            edges.append(float(v[-1]))
        elif v[k - 1] < 0.0 < v[k]:
            edges.append(0.0)
        else:
            back = power[k] / (power[k] - power[k - 1])
            edges.append(float(v[k] - back * (v[k] - v[k - 1])))
    return tuple(zip(edges[::2], edges[1::2], strict=True))


def _at_rest(
    law: FrictionLaw, trained: TrainedRange, loads: Sequence[float], dt: float
) -> tuple[float, float | None]:
    """Return (jump, slope) of the torque at zero velocity held over dt, at the worst load.

    By differences: the derivative of `sgn` is 0, so symbolic ones would miss what jumps.
    """
    t, q = np.array([0.0, dt]), np.full(2, trained.middle)

    def difference(speed: float, load: float) -> float:
        ends = [_run(law, t, np.array([0.0, v]), q, load)[-1] for v in (speed, -speed)]
        return float(ends[0] - ends[1])

    near = max((difference(_SMALLER, load) for load in loads), key=abs)
    far = max((difference(_SMALL, load) for load in loads), key=abs)
    if abs(near) > max(0.5 * abs(far), _NUMERICAL):
        return near, None
    return 0.0, far / (2.0 * _SMALL)


def _chatter(law: FrictionLaw, trained: TrainedRange, load: float) -> float:
    """Return the standard deviation [N.m] of the torque at rest under encoder noise."""
    dq, q, settling = encoder_noise(trained)
    t = trained.sample_time * np.arange(len(dq), dtype=float)
    return float(np.std(_run(law, t, dq, q, load)[settling:]))
