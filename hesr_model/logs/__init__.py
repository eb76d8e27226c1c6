"""Robot logs: read from many formats, converted, checked, smoothed."""
