"""Export format `adaptive`: an FMU that estimates friction from measured torques."""

from __future__ import annotations

from fmu_src.exporter import FMI, NO_DOCUMENTATION, Exporter, defer_writer

ADAPTIVE = Exporter(
    title="FMU that estimates friction from measured torques",
    suffixes=(".fmu",),
    write=defer_writer("hesr.extras.adaptive.monitor:export_adaptive"),
    options=(FMI, NO_DOCUMENTATION),
    platforms="common",
)
