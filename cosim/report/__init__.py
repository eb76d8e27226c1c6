"""Report of a run, a page made from saved results alone."""
