"""Export formats of SSP: `ssp` of a system, and `ssv` of a friction model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmu_src.exporter import Exporter, ExportOption, defer_writer


def write_system(system_path: Path, output: Path, **options: Any) -> list[str]:
    """Write the SSP of a system; return a remark on missing parts."""
    from cosim.systems.system import open_system
    from hesr.extras.ssp.ssp import export_ssp

    with open_system(system_path) as system:
        remark = export_ssp(system, system_path, output, **options)
    if remark is None:
        return []
    return [remark]


SSP = Exporter(
    title="system with its FMUs",
    suffixes=(".ssp",),
    write=write_system,
    options=(
        ExportOption(
            name="ssp", type="str", choices=("1.0", "2.0"), help="Version of SSP; by default 1.0."
        ),
    ),
    platform_refusal="'platform' is for FMUs; a system contains built ones.",
)
SSV = Exporter(
    title="coefficients and covariance as a parameter set of SSP",
    suffixes=(".ssv",),
    write=defer_writer("hesr.extras.ssp.parameter_set:export_ssv"),
)
