"""Motions that separate friction laws, ready for the controller."""
