"""Friction laws as parts of MuJoCo: passive dcmotor actuators in an MJCF."""
