"""Forward simulation of an identified body with friction: torque in, position out."""
