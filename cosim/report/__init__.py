"""The report of a run: one page that needs nothing but itself, made from saved results alone."""
