"""Figures of reports, drawn by matplotlib; charts also zoom by Bokeh."""
