"""Export formats `c`, `torch` and `jax`: a friction model as one file without HESR."""

from __future__ import annotations

from fmu_src.exporter import Exporter, defer_writer

C = Exporter(
    title="one C header without FMI",
    suffixes=(".h",),
    write=defer_writer("hesr.extras.one_file.c_header:export_c"),
)
TORCH = Exporter(
    title="one batched, differentiable file for PyTorch",
    suffixes=(".py",),
    write=defer_writer("hesr.extras.one_file.tensors:export_torch"),
)
JAX = Exporter(
    title="one batched, differentiable file for JAX",
    suffixes=(".py",),
    write=defer_writer("hesr.extras.one_file.tensors:export_jax"),
)
