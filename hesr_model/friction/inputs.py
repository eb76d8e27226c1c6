"""Signals of friction laws."""

from hesr_model.equations.component import Quantity

_VELOCITY = Quantity(name="dq", unit="rad/s", description="velocity of {joint}")
_POSITION = Quantity(name="q", unit="rad", description="position of {joint}")
_LOAD = Quantity(
    name="tau_load",
    unit="N.m",
    description="load {effort} on {joint}: rigid-body {effort} of the motion",
)

DQ = _VELOCITY.symbol  # joint velocity [rad/s]
Q = _POSITION.symbol  # joint position [rad]
TAU_LOAD = _LOAD.symbol  # load on the joint [N.m]: rigid-body torque of the motion
QUANTITIES = (_VELOCITY, _POSITION, _LOAD)  # inputs of laws, in the order used everywhere
INPUTS = tuple(quantity.symbol for quantity in QUANTITIES)
INPUT_UNITS = {quantity.name: quantity.unit for quantity in QUANTITIES}  # units for revolute joints
TORQUE = "tau"  # name of a law's output
MOVING = 0.02  # smallest initial speed [rad/s, m/s] of a steady start, of joints of usual speed
