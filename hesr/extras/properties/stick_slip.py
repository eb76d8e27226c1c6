"""Stick-slip of a joint pulled by a soft spring at constant speed."""

import numpy as np

from hesr.extras.properties.bench import DriveBench
from hesr.extras.properties.findings import curve, figures, plot
from hesr.extras.properties.scale import CREEP, Scale
from hesr_model.audit.expectations import WEAKENING
from hesr_model.audit.properties import PropertyResult
from hesr_model.support.arrays import Array

STRETCH = 0.2  # [rad] at the friction level
_TIMES = 6.0  # run time in stretching times
_STEP = 1e-2  # [s]
_FASTEST = 0.2  # end of the examined curve, in trained speeds
_NO_WEAKENING = 1e-3  # fall in levels; up to WEAKENING both outcomes are right
_STICKS, _SLIPS = 0.1, 1.5  # shares of the pulling speed
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
        _pulled(t, stretch[:, j], dq[:, j], pulls[j], falls[j], bool(scale.drives[j]))
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


def _pulled(
    t: Array, stretch: Array, dq: Array, pull: float, falls: float, drives: bool
) -> PropertyResult:
    half, quarter = len(t) // 2, 3 * len(t) // 4
    before, last = (float(np.ptp(part)) for part in (stretch[half:quarter], stretch[quarter:]))
    slow, fast = float(np.min(dq[half:])), float(np.max(dq[half:]))
    cycles = slow < _STICKS * pull and fast > _SLIPS * pull and last >= _LASTS * before
    begins = t[half + 1 :][(dq[half:-1] <= pull) & (dq[half + 1 :] > pull)]
    period = float(np.mean(np.diff(begins))) if cycles and len(begins) > 1 else None
    weak, flat = falls >= WEAKENING, falls <= _NO_WEAKENING
    does = (
        f"It cycles between {slow / pull:.2g} and {fast / pull:.2g} times the pulling speed"
        if cycles
        else "It ends in steady sliding"
    )
    if drives:
        right, why = False, "its steady friction drives at low speed"
    elif weak or flat:
        right = cycles == weak
        why = f"its steady curve falls by {falls:.1%} of the level"
    else:
        right, why = True, f"its steady curve falls by only {falls:.1%}, so both are allowed"
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
