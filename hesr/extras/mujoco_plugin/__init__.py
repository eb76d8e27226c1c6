"""Friction laws as passive forces of MuJoCo."""
