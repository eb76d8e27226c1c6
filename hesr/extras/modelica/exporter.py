"""Export format `modelica`: a Modelica package."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fmu_src.exporter import Exporter

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


def write(model: FrictionModel, output: Path) -> None:
    """Write the package."""
    from hesr.extras.modelica.modelica_package import export_modelica

    export_modelica(model, output)


MODELICA = Exporter(title="Modelica package", suffixes=(".mo",), write=write)
