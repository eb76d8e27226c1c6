"""Speeds at which a joint rests, by its own motion: what moves is told from noise.

A joint rests below a share of its own peak speed: between `FAST_SHARE` and `MOVING_SHARE` of it, so
that a cylinder, a fretting rig and a motor are judged alike. Between both the share is that of the
usual speed `MOVING`, so that all joints of an arm rest alike. It travels if its positions exceed
their noise and what other joints shake.
"""

from collections.abc import Sequence

import numpy as np

from hesr_model.support.arrays import Array, Mask

# Speed [rad/s, m/s] below which joints of usual speed rest. It decides nothing where it is more
# than `MOVING_SHARE` or less than `FAST_SHARE` of a joint's own peak. Between them it chooses rows
# of fits and the steady start of FMUs, which state it, but no statement: a third of it and three
# times as much give the same findings (`test_usual_speed`). Fits of different joints of an arm,
# and of different logs of a joint, thereby have one definition of rest.
MOVING = 0.02
MOVING_SHARE = 0.1  # of the peak speed: no joint that moves rests above it
FAST_SHARE = 0.002  # of the peak speed: every joint rests below it
_MIN_TRAVEL_TO_NOISE = 10.0  # the inner 98 % of white noise span 4.7 standard deviations
_MIN_RANGE_TO_NOISE = 20.0  # of 1e5 rows of white noise the range is 9 standard deviations
_MIN_PEAK_TO_NOISE = 10.0
_MIN_SPEED_TO_NOISE = 3.0
_TRAVEL_QUANTILES = (0.01, 0.99)  # single wrong rows are no travel
_WOBBLE_SHARE = 0.002  # of the largest travel of a robot: what other joints shake is not moved
_RESTING_SHARE = 0.002  # of a joint's largest travel: a log with less does not move it
# Of white noise behind a low pass of 15 Hz, which smooths logs by default: root mean square
# frequency [rad/s] and bandwidth [Hz]. They follow from integrals of 1 / (1 + x^4)^2.
_NOISE_FREQUENCY = 0.577 * 2.0 * np.pi * 15.0
_NOISE_BANDWIDTH = 0.833 * 15.0


def find_resting_speeds(t: Sequence[Array], q: Sequence[Array], dq: Sequence[Array]) -> Array:
    """Return the speeds at or below which joints rest, the same in all logs.

    Parameters
    ----------
    t : times of each log or part (N,) [s].
    q : unsmoothed positions (N, n) [rad, m].
    dq : smoothed velocities (N, n) [rad/s, m/s].

    Returns
    -------
    (n,) [rad/s, m/s].
    """
    peaks = np.max([np.max(np.abs(part), axis=0) for part in dq], axis=0)
    usual_speeds = np.maximum(MOVING, FAST_SHARE * peaks)
    if np.all(MOVING_SHARE * peaks >= MOVING):
        return np.asarray(usual_speeds)
    noise = _estimate_position_noise(q)
    period = float(np.median(np.concatenate([np.diff(part) for part in t])))
    noise_share = min(2.0 * _NOISE_BANDWIDTH * period, 1.0)  # that passes the low pass
    speed_noise = _NOISE_FREQUENCY * np.sqrt(noise_share) * noise
    is_moving = find_travelling(q) & (peaks > _MIN_PEAK_TO_NOISE * speed_noise)
    own_speeds = np.maximum(MOVING_SHARE * peaks, _MIN_SPEED_TO_NOISE * speed_noise)
    return np.asarray(np.where(is_moving, np.minimum(usual_speeds, own_speeds), usual_speeds))


def find_resting_travel(q: Sequence[Array]) -> Array:
    """Return the travel (n,) [rad, m] up to which joints rest in a log, by all of the logs.

    It is infinite for a joint that travels in none.

    Parameters
    ----------
    q : unsmoothed positions (N, n) of all logs.
    """
    travel = np.max([np.ptp(part, axis=0) for part in q], axis=0)
    noise_travel = _MIN_RANGE_TO_NOISE * _estimate_position_noise(q)
    # A fast motion in few rows looks like noise, but is most of the travel.
    noise_travel = np.minimum(noise_travel, MOVING_SHARE * travel)
    own_travel = np.maximum(noise_travel, _RESTING_SHARE * travel)
    return np.where(find_travelling(q), own_travel, np.inf)


def find_travelling(q: Sequence[Array], travel: Array | None = None) -> Mask:
    """Return whether each joint travels, by unsmoothed positions of logs.

    It travels clearly beyond the noise of its position and beyond what the motion of other joints
    shakes.

    Parameters
    ----------
    q : positions (N, n) [rad, m].
    travel : ranges (n,) [rad, m] of logs of which `q` are pieces.
    """
    quantiles = [np.quantile(part, _TRAVEL_QUANTILES, axis=0) for part in q]
    usual_travel = np.max([upper - lower for lower, upper in quantiles], axis=0)
    if travel is not None:
        usual_travel = np.maximum(usual_travel, travel)
    exceeds_noise = usual_travel > _MIN_TRAVEL_TO_NOISE * _estimate_position_noise(q)
    exceeds_wobble = usual_travel > _WOBBLE_SHARE * np.max(usual_travel)
    return np.asarray(exceeds_noise & exceeds_wobble)


def moves_both_ways(q: Array) -> bool:
    """Return whether an unsmoothed position (N,) [rad, m] rises and falls beyond its noise.

    A low pass continues a motion beyond its first and last rows by a guess, and the derivative of
    a guess may reverse where nothing was measured.
    """
    rise = float(np.max(q - np.minimum.accumulate(q)))
    fall = float(np.max(np.maximum.accumulate(q) - q))
    noise = float(_estimate_position_noise([q[:, None]])[0])
    return min(rise, fall) > _MIN_RANGE_TO_NOISE * noise


def _estimate_position_noise(q: Sequence[Array]) -> Array:
    """Return the standard deviation (n,) of white noise in positions, at least a resolution.

    Third differences hardly contain a motion that is slow against the sampling; of white noise they
    have 20 times the variance.
    """
    joint_count = q[0].shape[1]
    differences = np.concatenate(
        [np.zeros((0, joint_count)), *(np.diff(part, 3, axis=0) for part in q)]
    )
    noise = np.sqrt(np.sum(differences**2, axis=0) / (20.0 * max(len(differences), 1)))
    steps = np.abs(np.concatenate([np.diff(part, axis=0) for part in q]))
    # A resting encoder may change by one count only, and rarely.
    resolution = np.min(np.where(steps > 0.0, steps, np.inf), axis=0, initial=np.inf)
    return np.asarray(np.maximum(noise, np.where(np.isfinite(resolution), resolution, 0.0)))
