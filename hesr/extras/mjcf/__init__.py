"""Friction laws as passive dcmotor actuators of MuJoCo in an MJCF."""
