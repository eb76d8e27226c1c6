"""Leaderboards: friction FMUs of any origin, scored on the same logs."""
