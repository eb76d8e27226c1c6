"""The sections of a report, each from saved results; one without data returns None."""
