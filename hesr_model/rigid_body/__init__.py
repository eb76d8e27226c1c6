"""Rigid-body identification: base parameters, payload, and the friction that is left."""
