"""Closed loops on the twin's arm: motions, tracking and robustness."""
