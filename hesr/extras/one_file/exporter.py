"""Export formats `c`, `torch` and `jax`: a friction model as one file without HESR."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fmu_src.exporter import Exporter

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


def write_c(model: FrictionModel, output: Path) -> None:
    """Write the C header."""
    from hesr.extras.one_file.c_header import export_c

    export_c(model, output)


def write_torch(model: FrictionModel, output: Path) -> None:
    """Write the file for PyTorch."""
    from hesr.extras.one_file.tensors import export_torch

    export_torch(model, output)


def write_jax(model: FrictionModel, output: Path) -> None:
    """Write the file for JAX."""
    from hesr.extras.one_file.tensors import export_jax

    export_jax(model, output)


C = Exporter(title="one C header without FMI", suffixes=(".h",), write=write_c)
TORCH = Exporter(
    title="one batched, differentiable file for PyTorch", suffixes=(".py",), write=write_torch
)
JAX = Exporter(title="one batched, differentiable file for JAX", suffixes=(".py",), write=write_jax)
