"""Networks of the paper's inputs, with which symbolic laws are compared; imported to register."""

from hesr_model.friction.laws.networks import rbf  # isort: skip - the paper's network first
from hesr_model.friction.laws.networks import mlp

__all__ = ["mlp", "rbf"]
