"""Export format `observer`: the external torque and contact as an FMU or one C header."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmu_src.exporter import (
    FMI,
    RIGID_BODY,
    ROBOT,
    Exporter,
    ExportOption,
    ExportRequest,
    defer_writer,
)


def prepare(request: ExportRequest) -> Mapping[str, Any]:
    """Combine robot and rigid body."""
    from fmu_src.plant.plant_fmu import PlantBody

    options = dict(request.options)
    robot = options.pop("robot")
    options["plant_body"] = PlantBody.from_robot(robot, options.pop("rigid_body", None))
    return options


OBSERVER = Exporter(
    title="FMU or one C header: motion and motor torque in, external torque and contact out",
    suffixes=(".fmu", ".h"),
    write=defer_writer("hesr.extras.observer.observation:export_observer"),
    prepare=prepare,
    platforms="common",
    options=(
        FMI,
        ROBOT,
        RIGID_BODY,
        ExportOption(
            name="calibration",
            type="log",
            repeatable=True,
            help="Logs without contact that the law was not fitted to, or results of 'hesr run' "
            "for its test logs, which determine limits and threshold; repeatable; by default "
            "those follow from the bands of the law.",
        ),
        ExportOption(
            name="bandwidth",
            type="float",
            unit="Hz",
            help="Cut-off of the external torque; by default 15.",
        ),
        ExportOption(
            name="torque_constants",
            type="float",
            unit="N.m/A",
            per_joint=True,
            help="Torque of a joint per current; the inputs are then currents.",
        ),
    ),
)
