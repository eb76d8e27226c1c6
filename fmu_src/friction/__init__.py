"""Friction models as FMUs: component, data sheet, reference results."""
