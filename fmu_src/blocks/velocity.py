"""The Velocity FMU: velocities of measured positions."""

import numpy as np

from fmu_src.blocks.table import content, places, scalar, vector
from fmu_src.interface import Interface
from fmu_src.package import Content


def velocity(joints: int, *, step: float = 0.005) -> Content:
    """Return the Velocity FMU for a number of joints; `step` [s] is the preferred one."""
    zeros = np.zeros(joints)
    table = Interface(
        variables=(
            *vector("q", "input", "rad", "measured position", zeros),
            *vector("dq", "output", "rad/s", "velocity of the last step", zeros, ["q[{}]"]),
            scalar("time_constant", "fixed", "s", "of the low-pass; 0 for none", 0.0),
        ),
        own=joints,
        model_exchange=False,
        directional_derivatives=False,
    )
    first = {"POSITION": "q[1]", "VELOCITY": "dq[1]", "TIME_CONSTANT": "time_constant"}
    return content(
        table,
        name="Velocity",
        text="Velocity of measured positions: backward differences and a low-pass.",
        source="velocity.c",
        headers={"filter.h": places(table, "FILTER_H", first, JOINTS=joints)},
        step=step,
    )
