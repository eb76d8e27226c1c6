"""Robots: what a TOML file says of them, and the model file behind it."""
