"""Experiments driven by torque: break-away, holding a load, stick-slip, dissipation."""

import numpy as np

from hesr.extras.properties.bench import DriveBench
from hesr.extras.properties.scale import CREEP, Scale, curve, figures, judged, plot
from hesr_model.audit.properties import FALLS, HELD, PASSIVE, WEAKENING, PropertyResult
from hesr_model.support.arrays import Array

AMPLITUDES = (0.02, 0.5, 2.0)  # in friction levels: pre-sliding, half the level, sliding
_TORQUE_FREQUENCY = 1.0  # [Hz] of the torque; the load has twice as much
PHASES = (0.5 * np.pi, 1.5 * np.pi)  # load phase [rad]
_INNER_STEP = 4e-3  # [s] communication and inner step: rows contain all work
_ROWS = round(1.0 / (_TORQUE_FREQUENCY * _INNER_STEP))  # per cycle
_CYCLES = 10
_MEASURED = 4
_SPRING = 20.0  # stretch at the friction level, in deflections


def dissipation(
    bench: DriveBench, scale: Scale, peaks: Array, loaded: Array
) -> list[PropertyResult]:
    """Drive spring-held joints back and forth and sum up the work of their friction.

    The load of `loaded` (n,) laws moves between 0 and `peaks` (n,) [N.m].
    """
    angle = 2.0 * np.pi / _ROWS * np.arange(1, _ROWS * _CYCLES + 1)
    dt = np.full(len(angle), _INNER_STEP)
    none: tuple[float, float, Array, Array] = (-np.inf, 0.0, np.empty(0), np.empty(0))
    worst = [none] * bench.joints
    for share in AMPLITUDES:
        for phase in PHASES[: 2 if loaded.any() else 1]:
            load = 0.5 * peaks * (1.0 + np.cos(2.0 * angle + phase))[:, None]
            load = np.where(loaded, load, scale.load)
            torque = scale.offset + share * np.sin(angle)[:, None] * scale.level
            bench.start(
                load=load[-1],
                torque=scale.offset,
                stiffness=scale.level / (_SPRING * scale.deflection),
                substep=_INNER_STEP,
            )
            q, dq, tau = (
                part[-_MEASURED * _ROWS :] for part in bench.run(dt, torque=torque, load=load)
            )
            # An offset does no work over a closed cycle.
            given = -((tau - scale.offset) * dq).sum(axis=0) * _INNER_STEP / _MEASURED
            given = np.where(np.isfinite(given), given, np.inf)
            for j in np.flatnonzero(given > [one[0] for one in worst]):
                moved = q[-_ROWS:, j] - bench.places[j]
                worst[j] = (float(given[j]), share, moved, tau[-_ROWS:, j])
    return [_given(*one) for one in worst]


def _given(given: float, share: float, q: Array, tau: Array) -> PropertyResult:
    said = f"Under a torque of {share:g} levels it generates {given:.3g} J per cycle."
    return judged(
        ("most energy given in a cycle", max(0.0, given), "J"),
        ("amplitude of the torque, of the level", share, "1"),
        wrong=[said] if given > PASSIVE else [],
        plot=plot("position", "torque", curve("", 1e3 * q, tau, closed=True)),
    )


STRETCH = 0.2  # [rad] at the friction level
_TIMES = 6.0  # run time in stretching times
_STEP = 1e-2  # [s]
_FASTEST = 0.2  # end of the examined curve, in trained speeds
_NO_WEAKENING = 1e-3  # fall in levels; up to WEAKENING both outcomes are right
_STICKS = 0.1
_SLIPS = 1.5  # shares of the pulling speed
_LASTS = 0.8  # ratio of the last two quarters' amplitudes


def stick_slip(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Pull the joints by springs at the speed where their steady curve falls most."""
    pulls, falls = zip(*(_weakest(scale, j) for j in range(bench.joints)), strict=True)
    pull = np.array(pulls)
    seconds = _TIMES * STRETCH / float(np.min(pull))
    bench.start(load=scale.load, torque=scale.offset, stiffness=scale.level / STRETCH)
    rows = int(np.ceil(seconds / _STEP))
    ahead = 0.5 * STRETCH
    t = _STEP * np.arange(1, rows + 1, dtype=float)
    link = bench.places + ahead + pull * t[:, None]
    q, dq, _ = bench.run(np.full(rows, _STEP), link=link)
    stretch = link - q
    return [
        _judge_stick_slip(t, stretch[:, j], dq[:, j], pulls[j], falls[j], bool(scale.drives[j]))
        for j in range(bench.joints)
    ]


def _weakest(scale: Scale, joint: int) -> tuple[float, float]:
    """Return the speed of steepest fall of the steady curve [rad/s] and its fall."""
    speeds = scale.speed[joint] * np.geomspace(CREEP, _FASTEST, 100)
    torque = np.interp(speeds, scale.speeds[:, joint], scale.steady[:, joint])
    fallen = np.max(np.maximum.accumulate(torque) - torque) / scale.level[joint]
    slope = np.gradient(torque, speeds)
    steepest = int(np.argmin(slope))
    return float(speeds[steepest if slope[steepest] < 0.0 else 0]), float(fallen)


def _judge_stick_slip(
    t: Array, stretch: Array, dq: Array, pull: float, falls: float, drives: bool
) -> PropertyResult:
    half = len(t) // 2
    quarter = 3 * len(t) // 4
    before, last = (float(np.ptp(part)) for part in (stretch[half:quarter], stretch[quarter:]))
    slow = float(np.min(dq[half:]))
    fast = float(np.max(dq[half:]))
    cycles = slow < _STICKS * pull and fast > _SLIPS * pull and last >= _LASTS * before
    begins = t[half + 1 :][(dq[half:-1] <= pull) & (dq[half + 1 :] > pull)]
    period = float(np.mean(np.diff(begins))) if cycles and len(begins) > 1 else None
    weak = falls >= WEAKENING
    flat = falls <= _NO_WEAKENING
    does = "It ends in steady sliding"
    if cycles:
        does = f"It cycles between {slow / pull:.2g} and {fast / pull:.2g} times the pulling speed"
    if drives:
        right = False
        why = "its steady friction acts in the direction of motion at low speed"
    elif weak or flat:
        right = cycles == weak
        why = f"its steady curve falls by {falls:.1%} of the level"
    else:
        right = True
        why = f"its steady curve falls by only {falls:.1%}, so both are allowed"
    return PropertyResult(
        verdict="pass" if right else "fail",
        figures=figures(
            ("amplitude of the limit cycle", 0.5 * last if cycles else 0.0, "rad"),
            ("period of the limit cycle", period, "s"),
            ("pulling speed", pull, "rad/s"),
            ("fall of the steady curve, of the level", falls, "1"),
        ),
        reason=f"{does}; {why}.",
        plot=plot("time", "stretch", curve("", t, 1e3 * stretch, most=160)),
    )


RAMPS = (10.0, 3.0, 1.0, 0.3)  # [s] up to the friction level
LOAD = 0.5  # held load in friction levels
DITHER = 0.2
FREQUENCY = 5.0  # amplitude in friction levels, [Hz]
MINUTE = 60.0

_SLIDES = 0.05  # sliding threshold in trained speeds
_HIGHEST = 3.0  # end of a ramp, in friction levels
_RAMP_STEPS = 1000  # steps up to the friction level
_CREEPS = 2.0  # ratio of displacements on ramps of different rate; pre-sliding has 1
_PUT_ON = 1.0
_SETTLING = 1.0  # [s] rise of a load, and rest
_PER_PERIOD = 20  # steps of the dither


def breakaway(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Raise the torque from rest at several rates until the joints slide."""
    peaks, ways = np.swapaxes([_ramp(bench, scale, seconds) for seconds in RAMPS], 0, 1)
    return [_broken(peaks[:, j], ways[:, j], float(scale.level[j])) for j in range(bench.joints)]


def _ramp(bench: DriveBench, scale: Scale, seconds: float) -> tuple[Array, Array]:
    """Return peak friction before sliding (n,) [N.m] and displacement at half of it (n,) [rad].

    Both are NaN for a joint that does not slide.
    """
    bench.start(load=scale.load, torque=scale.offset)
    dt = seconds / _RAMP_STEPS
    slides = _SLIDES * scale.speed
    rows: list[Array] = []
    moving = np.zeros(bench.joints, dtype=bool)
    for k in range(1, int(_HIGHEST * _RAMP_STEPS) + 1):
        # Release sliding joints before they run away.
        bench.torque[:] = scale.offset + np.where(moving, 0.0, k / _RAMP_STEPS * scale.level)
        now = bench.step(dt).copy()
        now[:, moving] = np.nan
        rows.append(now)
        moving |= np.abs(now[1]) > slides
        if moving.all():
            break
    q, _, tau = (np.array(part) for part in zip(*rows, strict=True))
    friction = tau - scale.offset
    peak, way = np.full((2, bench.joints), np.nan)
    for j in np.flatnonzero(moving):
        until = ~np.isnan(q[:, j])
        peak[j] = friction[until, j].max()
        half = int(np.argmax(friction[until, j] >= 0.5 * peak[j]))
        way[j] = abs(q[half, j] - bench.places[j])
    return peak, way


def _broken(peaks: Array, ways: Array, level: float) -> PropertyResult:
    if np.isnan(peaks).any():
        return judged(
            ("fall of the break-away torque", None, "1"),
            wrong=[f"The joint does not slide below {_HIGHEST:g} times its friction level."],
        )
    fall = float((peaks[0] - peaks[-1]) / peaks[0]) if peaks[0] > 0.0 else 0.0
    wrong = []
    if peaks[0] <= 0.0:
        wrong.append("No break-away: the law drives the joint.")
    elif ways[0] > _CREEPS * ways[1]:
        wrong.append(
            "No break-away: the joint creeps, by half the torque "
            f"{ways[0] / ways[1]:.2g} times as far on the slowest ramp as on the next."
        )
    if peaks[0] > 0.0 and fall < FALLS:
        wrong.append(
            f"The break-away torque falls by only {fall:.1%}."
            if fall > 1e-3
            else "The break-away torque does not fall with the rate."
        )
    return judged(
        ("fall of the break-away torque", fall, "1"),
        ("break-away torque on the slowest ramp", float(peaks[0]), "N.m"),
        ("break-away torque on the fastest ramp", float(peaks[-1]), "N.m"),
        wrong=wrong,
        plot=plot("log10 rate", "break-away", curve("", np.log10(level / np.array(RAMPS)), peaks)),
    )


def hold(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Hold a constant load for a minute, also as load input of the law."""
    load = LOAD * scale.level
    bench.start(load=load, torque=scale.offset)
    _put_on(bench, scale, load)
    dt = np.full(600, MINUTE / 600)
    return _drifting(np.concatenate([[0.0], np.cumsum(dt[1:])]), bench.run(dt)[0])


def dither(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Hold a constant load plus a small oscillating one for a minute."""
    load = LOAD * scale.bears
    bench.start(load=scale.load, torque=scale.offset)
    _put_on(bench, scale, load)
    rows = round((MINUTE + _SETTLING) * FREQUENCY * _PER_PERIOD)
    dt = np.full(rows, 1.0 / (FREQUENCY * _PER_PERIOD))
    wave = np.sin(2.0 * np.pi / _PER_PERIOD * (np.arange(rows) + 0.5))
    q = bench.run(dt, torque=scale.offset + load + DITHER * wave[:, None] * scale.bears)[0]
    # The mean of each period hides the oscillation.
    middle = q.reshape(-1, _PER_PERIOD, bench.joints).mean(axis=1)
    middle = middle[round(_SETTLING * FREQUENCY) :]
    return _drifting(np.arange(len(middle)) / FREQUENCY, middle)


def _put_on(bench: DriveBench, scale: Scale, load: Array) -> None:
    steps = 100
    rise = 0.5 - 0.5 * np.cos(np.pi / steps * np.arange(1, steps + 1))
    bench.run(np.full(steps, _PUT_ON / steps), torque=scale.offset + rise[:, None] * load)
    bench.step(_SETTLING)


def _drifting(t: Array, q: Array) -> list[PropertyResult]:
    found = []
    for of_joint in q.T:
        drift = float(of_joint[-1] - of_joint[0])
        rate = float(np.diff(of_joint[len(of_joint) // 2 :]).sum() / (t[-1] - t[len(t) // 2]))
        if not np.isfinite(drift):
            found.append(judged(("drift in a minute", None, "rad"), wrong=["The joint runs away."]))
            continue
        found.append(
            judged(
                ("drift in a minute", drift, "rad"),
                ("rate of the second half", rate, "rad/s"),
                wrong=["It creeps."] if abs(drift) > HELD else [],
                plot=plot("time", "moved", curve("", t, 1e3 * (of_joint - of_joint[0]), most=60)),
            )
        )
    return found
