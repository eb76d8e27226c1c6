"""Sections of a report: functions from saved results to the values of their templates."""
