"""A friction model as one file of code that needs nothing of HESR: C, PyTorch, JAX."""
