"""Robot logs: read from files of many kinds, converted, checked, smoothed."""
