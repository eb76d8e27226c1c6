"""Uncertainty of estimates from logs."""
