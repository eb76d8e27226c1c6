"""Export format `mujoco-plugin`: a library with the law itself for MuJoCo."""

from __future__ import annotations

from fmu_src.exporter import Exporter, defer_writer

MUJOCO_PLUGIN = Exporter(
    title="library with the law itself, and MJCF that loads it into a scene of MuJoCo",
    suffixes=(".so",),
    write=defer_writer("hesr.extras.mujoco_plugin.plugin_library:export_mujoco_plugin"),
)
