"""Picture of an arm in two poses."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cosim.report.figures.style import INK, SERIES, SOFT, styled
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_TURN = 0.8  # largest distance of the second pose from the middle of the range [rad or m]
_AXIS = 0.08  # half the length of a drawn axis over the size of the arm


def picture(robot: Robot) -> Figure:
    """Return a picture of the arm near zero and away from the middle of its range."""
    low, high, _ = robot.reach
    middle = 0.5 * (low + high)
    away = np.minimum(0.25 * (high - low), _TURN)
    poses = {"near q = 0": np.clip(0.0, low, high), "away from mid-range": middle + away}
    with styled():
        figure = Figure(figsize=(7.4, 3.9), layout="constrained")
        for k, (title, q) in enumerate(poses.items(), start=1):
            axis = figure.add_subplot(1, 2, k, projection="3d")
            _draw(axis, robot, q)
            axis.set_title(title)
    return figure


def _draw(axis: Any, robot: Robot, q: Array) -> None:
    placed = robot.places(q)
    places = [np.zeros(3), *(place for _, place in placed)]
    ends = [r @ body[1] + place for (r, place), body in zip(placed, robot.bodies, strict=True)]
    points = np.array([*places, *ends])
    size = float(np.ptp(points, axis=0).max()) or 1.0
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    parents = {frame.parent for frame in robot.tree}
    for k, (frame, (rotation, place)) in enumerate(zip(robot.tree, placed, strict=True)):
        _line(axis, places[frame.parent + 1], place, INK, 2.5)
        if k not in parents:
            _line(axis, place, ends[k], INK, 2.5)
        arrow = _AXIS * size * (rotation @ frame.axis)
        _line(axis, place - arrow, place + arrow, SERIES[0], 4.0)
        axis.text(*(place + 1.5 * arrow), frame.name, fontsize=7, color=SOFT)
    axis.scatter(*np.transpose(ends), s=14, color=SERIES[1])
    axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    low, high = middle - 0.5 * size, middle + 0.5 * size
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axis.set_box_aspect((1.0, 1.0, 1.0), zoom=0.85)
    axis.locator_params(nbins=4)


def _line(axis: Any, start: Array, end: Array, colour: str, width: float) -> None:
    axis.plot(*np.transpose([start, end]), color=colour, linewidth=width)
