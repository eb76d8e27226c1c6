"""Export format `adaptive`: an FMU that estimates friction from measured torques."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.exporter import FMI, NO_DOCUMENTATION, Exporter

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


def write(model: FrictionModel, output: Path, **options: Any) -> None:
    """Write the FMU."""
    from hesr.extras.adaptive.monitor import export_adaptive

    export_adaptive(model, output, **options)


ADAPTIVE = Exporter(
    title="FMU that estimates friction from measured torques",
    suffixes=(".fmu",),
    write=write,
    options=(FMI, NO_DOCUMENTATION),
    platforms="common",
)
