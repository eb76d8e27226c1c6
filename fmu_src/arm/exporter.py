"""Export formats of an arm, an MJCF or a URDF: native FMU, and FMU for hosts with Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fmu_src.exporter import Exporter, ExportOption, ExportRequest
from hesr_model.errors import ArgumentError

SIGNALS = ExportOption(
    name="signals",
    type="path",
    help="TOML file with inputs and outputs; by default every control and sensor, or torques, "
    "positions and speeds of its joints if it has none.",
)


def write_native(model_path: Path, output: Path, signals: Path | None = None, **build: Any) -> None:
    """Write the FMU that contains MuJoCo."""
    from fmu_src.arm.native import export_mjcf

    export_mjcf(model_path, output, table=signals, **build)


def prepare_python_arm(request: ExportRequest) -> Mapping[str, Any]:
    """Refuse a URDF."""
    if request.source.suffix.lower() == ".urdf":
        raise ArgumentError("'format' is python-arm, which needs an MJCF; omit it for a URDF.")
    return request.options


def write_python_arm(model_path: Path, output: Path, signals: Path | None = None) -> None:
    """Write the FMU that runs in the Python of its host."""
    from fmu_src.arm.python_arm.export import export_python_arm

    export_python_arm(model_path, signals, output)


NATIVE = Exporter(
    title="FMU with MuJoCo",
    suffixes=(".fmu",),
    write=write_native,
    options=(SIGNALS,),
    platforms="host",
)
PYTHON_ARM = Exporter(
    title="FMU for hosts with Python, HESR and MuJoCo",
    suffixes=(".fmu",),
    write=write_python_arm,
    prepare=prepare_python_arm,
    options=(SIGNALS,),
    platform_refusal="'platform' is for native FMUs, not python-arm.",
)
