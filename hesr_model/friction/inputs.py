"""The inputs of friction laws."""

from hesr_model.equations.component import Quantity

_VELOCITY = Quantity(name="dq", unit="rad/s", description="velocity of {joint}")
_POSITION = Quantity(name="q", unit="rad", description="position of {joint}")
_LOAD = Quantity(
    name="tau_load",
    unit="N.m",
    description="load {effort} on {joint}: rigid-body {effort} of the motion",
)

DQ = _VELOCITY.symbol
"""Joint velocity [rad/s]."""
Q = _POSITION.symbol
"""Joint position [rad]."""
TAU_LOAD = _LOAD.symbol
"""Load torque on the joint [N.m]: the rigid-body torque of the motion."""

QUANTITIES = (_VELOCITY, _POSITION, _LOAD)
"""What a law may use, in the order in which every lowering passes it."""

INPUTS = tuple(quantity.symbol for quantity in QUANTITIES)
"""Their symbols."""

INPUT_UNITS = {quantity.name: quantity.unit for quantity in QUANTITIES}
"""Of a joint that turns; `units.unit_of_joint` has those of one that slides."""
