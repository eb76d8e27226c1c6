"""Motions in closed form, their limits, and the design of excitations."""
