"""Adaptive friction: level, viscous factor and offset of a law are estimated online."""
