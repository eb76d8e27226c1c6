"""Figures of an arm, of contents of logs by joint, and of designed excitation."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.report.figures.chart import Line, grid, legend, plot
from cosim.report.figures.style import INK, SERIES, SOFT, apply_style
from hesr_model.motions.excitation import Excitation
from hesr_model.motions.limits import Limits
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole

_MAX_DISTANCE = 0.8  # largest distance of the second pose from the middle of the range [rad or m]
_AXIS = 0.08  # half the length of a drawn axis over the size of the arm


def picture(robot: Robot) -> Figure:
    """Return a picture of the arm near zero and away from the middle of its range."""
    lower, upper, _ = robot.reach
    middle = 0.5 * (lower + upper)
    away = np.minimum(0.25 * (upper - lower), _MAX_DISTANCE)
    poses = {"near q = 0": np.clip(0.0, lower, upper), "away from mid-range": middle + away}
    with apply_style():
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
    lower = middle - 0.5 * size
    upper = middle + 0.5 * size
    axis.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    axis.set_box_aspect((1.0, 1.0, 1.0), zoom=0.85)
    axis.locator_params(nbins=4)


def _line(axis: Any, start: Array, end: Array, colour: str, width: float) -> None:
    axis.plot(*np.transpose([start, end]), color=colour, linewidth=width)


_ROW = 1.55
_BINS = 40
_MIN_RANGE = 1e-9  # round-off of a range of values
_DESIGN_ROW = 1.8
_WIDTH = 9.0
_DPI = 120


@dataclass(frozen=True, kw_only=True, eq=False)
class JointView:
    """Row of a joint: velocity over time, friction over velocity, rows of all logs (N,)."""

    name: str
    unit: str
    velocities: Sequence[Line]
    friction: Line | None  # None without a model, like `loads`
    covered: Array
    loads: Array | None


def joints(views: Sequence[JointView]) -> Figure:
    """Draw velocity, friction, and histograms of velocity and load by joint."""
    size = (9.0, _ROW * len(views) + 0.75)
    widths = [1.0, 1.0, 0.6, 0.6]
    margins = (0.54, 0.5, 0.3)
    gaps = (0.3, 0.58)
    with apply_style():
        figure, axes = grid(size, len(views), 4, margins, gaps, width_ratios=widths)
        for row, view in zip(axes, views, strict=True):
            for line in view.velocities:
                plot(row[0], line)
            if view.friction:
                plot(row[1], view.friction)
            else:
                _note(row[1], "no model")
            _draw_histogram(row[2], view.covered)
            _draw_histogram(row[3], view.loads)
            titles = ("torque minus model", "rows by velocity", "rows by gravity")
            row[0].set_title(f"{view.name}: {view.unit} over s", fontsize=8.5)
            units = (view.unit, view.unit, "N" if view.unit == "m/s" else "N.m")
            for axis, title, unit in zip(row[1:], titles, units, strict=True):
                axis.set_title(title, fontsize=8.5)
                axis.set_xlabel(unit, fontsize=8, labelpad=1)
        legend(figure, list(chain.from_iterable(view.velocities for view in views)))
    return figure


def _draw_histogram(axis: Axes, values: Array | None) -> None:
    axis.set_yticks([])
    if values is None:
        _note(axis, "no model")
    elif np.ptp(values) < _MIN_RANGE:
        _note(axis, "none")
    else:
        axis.hist(values, bins=_BINS, color=SERIES[2])


def _note(axis: Axes, text: str) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    axis.text(0.5, 0.5, text, ha="center", fontsize=8, transform=axis.transAxes)


def write_excitation(path: Path, motion: Excitation, joints: Sequence[str]) -> None:
    """Write a picture of a designed motion with its limits."""
    t, q, dq, _ = motion.setpoints()
    figure = draw_limited_motion(t, q, dq, motion.limits, joints)
    with written_whole(path) as temporary:
        # The version of the library would change the bytes.
        figure.savefig(temporary, dpi=_DPI, metadata={"Software": None})


def draw_limited_motion(
    t: Array, q: Array, dq: Array, limits: Limits, joints: Sequence[str], *, speeds: bool = False
) -> Figure:
    """Draw positions and velocities (N, n) with limits, and the time at `speeds` both ways."""
    figure = Figure(figsize=(_WIDTH, _DESIGN_ROW * len(joints)), layout="constrained")
    axes = figure.subplots(len(joints), 3 if speeds else 2, sharex="col", squeeze=False)
    for k, (joint, row) in enumerate(zip(joints, axes, strict=True)):
        _draw_with_limits(row[0], t, q[:, k], (limits.lower[k], limits.upper[k]))
        _draw_with_limits(row[1], t, dq[:, k], (-limits.velocity[k], limits.velocity[k]))
        row[0].set_ylabel(joint)
        if speeds:
            edges = np.geomspace(1e-3, 1.0, _BINS // 2) * limits.velocity.max()
            for sign in (1.0, -1.0):
                counts, _ = np.histogram(sign * dq[:, k], edges)
                row[2].stairs(sign * counts * (t[1] - t[0]), edges, color=SERIES[0], fill=True)
            row[2].set_xscale("log")
    titles = (
        "position [rad; m where prismatic]",
        "velocity [rad/s; m/s where prismatic]",
        "time [s]",
    )
    for k, axis in enumerate(axes[0]):
        axis.set_title(titles[k])
        axes[-1, k].set_xlabel(("t [s]", "t [s]", "speed [rad/s; m/s], both ways")[k])
    return figure


def _draw_with_limits(axis: Axes, t: Array, values: Array, limits: tuple[float, float]) -> None:
    axis.plot(t, values, linewidth=1.0)
    for limit in limits:
        axis.axhline(limit, color="C3", linestyle="--", linewidth=0.8)
    axis.margins(x=0.0)
