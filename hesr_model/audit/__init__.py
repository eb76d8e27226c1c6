"""Audit of friction laws."""
