"""Friction laws beyond the core."""
