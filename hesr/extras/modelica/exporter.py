"""Export format `modelica`: a Modelica package."""

from __future__ import annotations

from fmu_src.exporter import Exporter, defer_writer

MODELICA = Exporter(
    title="Modelica package",
    suffixes=(".mo",),
    write=defer_writer("hesr.extras.modelica.modelica_package:export_modelica"),
)
