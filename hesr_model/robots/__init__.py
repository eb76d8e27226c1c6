"""Robots: TOML descriptions and model files."""
