"""Export format `mjcf`: actuators for MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.exporter import Exporter, ExportOption, ExportRequest

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


def prepare(request: ExportRequest) -> Mapping[str, Any]:
    """Report the progress of the approximation."""
    return {**request.options, "progress": request.building}


def write(model: FrictionModel, output: Path, **options: Any) -> list[str]:
    """Write the MJCF; return how exact each joint is."""
    from hesr.extras.mjcf.mjcf_file import export_mjcf_law

    return export_mjcf_law(model, output, **options).lines()


MJCF = Exporter(
    title="actuators for MuJoCo",
    suffixes=(".xml",),
    write=write,
    prepare=prepare,
    options=(
        ExportOption(
            name="project",
            type="bool",
            help="Approximate a law that MuJoCo cannot express exactly.",
        ),
    ),
)
