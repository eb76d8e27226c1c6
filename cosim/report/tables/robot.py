"""Tables of a robot: joints and links."""

import numpy as np

from cosim.report.tables.table import ResultTable, row_of
from hesr_model.robots.robot import Robot
from hesr_model.units import unit_of_joint


def robot_tables(robot: Robot) -> tuple[ResultTable, ResultTable]:
    """Return the tables of a robot's joints and links."""
    return _joints(robot), _links(robot)


def _joints(robot: Robot) -> ResultTable:
    low, high, speed = robot.limits
    torque = np.where(robot.torque_limits > 0.0, robot.torque_limits, np.inf)
    gears = robot.description.gear_ratio or (np.inf,) * robot.n
    places = zip(robot.tree, robot.places(np.zeros(robot.n)), strict=True)
    axes = {frame.name: rotation @ frame.axis for frame, (rotation, _) in places}
    rows = []
    for j, (name, slides) in enumerate(zip(robot.joints, robot.slides, strict=True)):
        stated = np.isfinite([low[j], speed[j], torque[j]]).any()
        rows.append(
            row_of(
                f"{name} [{unit_of_joint('rad', slides=slides)}]",
                " ".join(f"{x:.3g}" for x in np.round(axes[name], 6) + 0.0),
                f"{low[j]:.4g} to {high[j]:.4g}" if np.isfinite(low[j]) else "–",
                *map(_stated, (speed[j], torque[j])),
                robot.description.model.name if stated else "not stated",
                _stated(gears[j]),
            )
        )
    limits = ("position limits", "speed limit", "torque limit", "source of limits")
    head = ("joint", "axis in the base at q = 0", *limits, "gear ratio")
    return ResultTable(caption="Joints", head=head, rows=rows, words=(1, 2, 5))


def _stated(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "–"


def _links(robot: Robot) -> ResultTable:
    rows = []
    for frame, (mass, centre, inertia) in zip(robot.tree, robot.bodies, strict=True):
        about = inertia[np.diag_indices(3)].tolist() + inertia[np.triu_indices(3, 1)].tolist()
        rows.append(row_of(frame.name, *(f"{x:.4g}" for x in (mass, *centre, *about))))
    inertias = (f"I{axes} in kg.m2" for axes in ("xx", "yy", "zz", "xy", "xz", "yz"))
    head = ("link after joint", "mass in kg", *(f"{axis} in m" for axis in "xyz"), *inertias)
    note = "Centre of mass in the frame of the joint, inertia about it; fixed parts are included."
    return ResultTable(caption="Links", head=head, rows=rows, note=note)
