"""The laws that come with HESR, in the order in which tables show them."""

from importlib import import_module

MODULES = (
    "stribeck",
    "parfam.velocity",
    "lugre",
    "dahl",
    "networks",
    "parfam.estimator",
    "strain_wave",
    "parfam.extended",
)
"""Modules of `hesr_model.friction` whose import registers estimators."""

for _module in MODULES:
    import_module(f"hesr_model.friction.{_module}")
