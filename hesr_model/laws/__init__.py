"""Friction laws, one module each."""
