"""Friction models as one file of code without HESR: C, PyTorch, JAX."""
