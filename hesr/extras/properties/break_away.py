"""Experiments driven by torque: break-away, and holding a load."""

import numpy as np

from hesr.extras.properties.bench import DriveBench
from hesr.extras.properties.findings import curve, judged, plot
from hesr.extras.properties.scale import Scale
from hesr_model.audit.expectations import FALLS, HELD
from hesr_model.audit.properties import PropertyResult
from hesr_model.support.arrays import Array

RAMPS = (10.0, 3.0, 1.0, 0.3)  # [s] up to the friction level
LOAD = 0.5  # held load in friction levels
DITHER, FREQUENCY = 0.2, 5.0  # amplitude in friction levels, [Hz]
MINUTE = 60.0

_SLIDES = 0.05  # sliding threshold in trained speeds
_HIGHEST = 3.0  # end of a ramp, in friction levels
_RAMP_STEPS = 1000  # steps up to the friction level
_CREEPS = 2.0  # ratio of displacements on ramps of different rate; pre-sliding has 1
_PUT_ON, _SETTLING = 1.0, 1.0  # [s] rise of a load, and rest
_PER_PERIOD = 20  # steps of the dither


def breakaway(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Raise the torque from rest at several rates until the joints slide."""
    peaks, ways = [], []
    for seconds in RAMPS:
        peak, way = _ramp(bench, scale, seconds)
        peaks.append(peak)
        ways.append(way)
    return [
        _broken(np.array(peaks)[:, j], np.array(ways)[:, j], float(scale.level[j]))
        for j in range(bench.joints)
    ]


def _ramp(bench: DriveBench, scale: Scale, seconds: float) -> tuple[Array, Array]:
    """Return peak friction before sliding (n,) [N.m] and displacement at half of it (n,) [rad].

    Both are NaN for a joint that does not slide.
    """
    bench.start(load=scale.load, torque=scale.offset)
    dt, slides = seconds / _RAMP_STEPS, _SLIDES * scale.speed
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
