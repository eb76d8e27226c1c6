"""The laws that come with HESR: importing a module registers its estimator."""

from hesr_model.friction import lugre, stribeck
from hesr_model.friction.parfam import estimator, extended

__all__ = ["estimator", "extended", "lugre", "stribeck"]
