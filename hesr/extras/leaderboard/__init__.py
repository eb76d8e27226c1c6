"""The arena: friction FMUs of anybody, scored on the same logs."""
