"""Sections of a report: functions from saved results to values of their templates."""
