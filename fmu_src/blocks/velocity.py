"""Velocity FMU: velocities from measured positions."""

import sympy

from fmu_src.blocks.block import block
from fmu_src.export.package import Content
from hesr_model.equations.component import (
    Component,
    Equation,
    Parameter,
    Quantity,
    Requirement,
    previous,
)
from hesr_model.equations.memory import DT

_Q = Quantity(name="q", unit="rad", description="measured position")
_TIME_CONSTANT = Parameter(
    name="time_constant", unit="s", description="of the low-pass; 0 for none", tunable=False
)


def velocity_equations() -> Component:
    """Return backward differences and a first-order low-pass filter of one joint."""
    tau = _TIME_CONSTANT.symbol
    share = sympy.Piecewise((1 - sympy.exp(-DT / tau), tau > 0), (1, True))
    speed = (_Q.symbol - previous("position")) / DT
    return Component(
        inputs=(_Q,),
        shared=(_TIME_CONSTANT,),
        equations=(
            Equation(name="dq", unit="rad/s", description="velocity of the last step", output=True,
                     expression=previous("dq") + share * (speed - previous("dq")),
                     start=sympy.Integer(0)),
            Equation(name="position", unit="rad", expression=_Q.symbol, start=_Q.symbol),
        ),
        requirements=(
            Requirement(name="time_constant", condition=tau >= 0, text="not be negative"),
        ),
    )  # fmt: skip


def velocity(joints: int, *, step: float = 0.005) -> Content:
    """Return the Velocity FMU for a number of joints with preferred step `step` [s]."""
    return block(
        velocity_equations(),
        joints,
        name="Velocity",
        text="Velocity of measured positions: backward differences and a low-pass.",
        step=step,
        example={"time_constant": 4.0 * step},
    )
