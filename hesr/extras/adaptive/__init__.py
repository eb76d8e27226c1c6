"""Friction that is followed: a law whose level, viscous part and offset are estimated online."""
