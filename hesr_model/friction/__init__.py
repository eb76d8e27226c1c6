"""Friction laws: what they are, how they run, and the estimators that make them."""
