"""Export format `mujoco-plugin`: a library with the law itself for MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fmu_src.exporter import Exporter

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


def write(model: FrictionModel, output: Path) -> None:
    """Write the library and its MJCF."""
    from hesr.extras.mujoco_plugin.plugin_library import export_mujoco_plugin

    export_mujoco_plugin(model, output)


MUJOCO_PLUGIN = Exporter(
    title="library with the law itself, and MJCF that loads it into a scene of MuJoCo",
    suffixes=(".so",),
    write=write,
)
