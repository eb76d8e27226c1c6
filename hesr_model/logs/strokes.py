"""Strokes of a joint between reversals, and the speeds at which it runs."""

from collections.abc import Iterator, Sequence

import numpy as np

from hesr_model.logs.signals import moving, reversals
from hesr_model.support.arrays import Array

_PART_COUNT = 10  # parts of a stroke, in each of which noise of the velocity averages out
_MIN_PART_COUNT = 5  # in one direction, which tell its speeds
_SPEED_QUANTILES = (0.15, 0.85)  # of parts in motion; those of starts and stops differ
_MAX_SPEED_RATIO = 1.15  # between these quantiles, within which there is one speed


def find_single_speeds(
    times: Sequence[Array], velocities: Sequence[Array], resting_speed: float
) -> tuple[float, ...]:
    """Return the speed of a joint that runs at one speed in each direction.

    A speed for each direction is no more than one: an offset takes their difference.

    Parameters
    ----------
    times, velocities : of its logs or parts, (N,) each [s], [rad/s, m/s].
    resting_speed : speed up to which it rests.

    Returns
    -------
    tuple of float
        One speed, or two that differ by direction; empty if the speed varies or is unknown.
    """
    speeds_by_direction: dict[float, list[float]] = {1.0: [], -1.0: []}
    for t, v in zip(times, velocities, strict=True):
        for speed in _average_strokes(t, v, resting_speed):
            speeds_by_direction[float(np.sign(speed))].append(abs(speed))
    usual_speeds = []
    for speeds in speeds_by_direction.values():
        if len(speeds) < _MIN_PART_COUNT:
            continue
        lower, upper = np.quantile(speeds, _SPEED_QUANTILES)
        if upper > _MAX_SPEED_RATIO * lower:
            return ()
        usual_speeds.append(float(np.median(speeds)))
    if usual_speeds and max(usual_speeds) < _MAX_SPEED_RATIO * min(usual_speeds):
        usual_speeds = [float(np.mean(usual_speeds))]
    return tuple(usual_speeds)


def _average_strokes(t: Array, v: Array, resting_speed: float) -> Iterator[float]:
    """Yield mean velocities of the moving rows in parts of strokes, between reversals."""
    for rows in np.split(np.arange(len(t)), reversals(v, resting_speed)):
        for part_rows in np.array_split(rows, _PART_COUNT):
            moving_rows = part_rows[moving(v[part_rows], resting_speed)]
            if len(moving_rows) and 2 * len(moving_rows) > len(part_rows):
                yield float(np.mean(v[moving_rows]))
