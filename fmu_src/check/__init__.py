"""Checks of any FMU."""
