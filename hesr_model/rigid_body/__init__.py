"""Rigid-body identification: base parameters, payload and friction residual."""
