"""Estimators and searches."""
