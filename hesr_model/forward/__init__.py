"""Forward simulation: torque in, position out, of an identified body and its friction."""
