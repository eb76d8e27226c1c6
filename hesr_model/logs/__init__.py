"""Robot logs: formats, checks, smoothing."""
