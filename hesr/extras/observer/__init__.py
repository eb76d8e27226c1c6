"""External torque: a momentum observer with calibrated limits, as FMU, C header and in Python."""
