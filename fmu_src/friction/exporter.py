"""Export format `fmu`: a friction model as an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.exporter import FMI, NO_DOCUMENTATION, Exporter, ExportOption, ExportRequest
from hesr_model.support import plugins

if TYPE_CHECKING:
    from hesr_model.audit.properties import Properties
    from hesr_model.friction.model import FrictionModel


def prepare(request: ExportRequest) -> Mapping[str, Any]:
    """Run the physics checks."""
    options = dict(request.options)
    if "properties" in options:
        options["properties"] = _test_law(request)
    return options


def _test_law(request: ExportRequest) -> Properties:
    from hesr_model.audit.properties import Subject

    model: FrictionModel = request.source
    run_battery = plugins.find("hesr.tests", "properties")
    properties: list[Properties] = run_battery(
        [Subject(name=model.law, model=model)],
        progress=partial(request.progress, "testing the law"),
    )
    return properties[0]


def write(model: FrictionModel, output: Path, **options: Any) -> None:
    """Write the FMU; for a band also its coefficients and covariance, as NAME.ssv."""
    from fmu_src.friction.friction_fmu import export_fmu

    export_fmu(model, output, **options)
    if "band" in options:
        plugins.find("hesr.exports", "ssv").write(model, output.with_suffix(".ssv"))


FMU = Exporter(
    title="FMU: velocity in, torque out",
    suffixes=(".fmu",),
    write=write,
    prepare=prepare,
    platforms="common",
    options=(
        FMI,
        ExportOption(
            name="properties",
            type="bool",
            help="Run the physics checks and add their table to the pages.",
            cached=False,
        ),
        ExportOption(name="power", type="bool", help="Add the dissipated power as an output."),
        ExportOption(
            name="band",
            type="bool",
            help="Add the 95 % band of measured friction as outputs, and write coefficients and "
            "covariance as NAME.ssv.",
            cached=False,  # the second file
        ),
        ExportOption(
            name="low_pass",
            type="float",
            unit="Hz",
            help="Cut-off of a causal low pass of the velocity; by default none.",
        ),
        ExportOption(
            name="no_events",
            type="bool",
            help="No event indicators in model exchange; where a law jumps at reversals, the jump "
            "is a steep line below 0.001 rad/s.",
        ),
        NO_DOCUMENTATION,
    ),
)
