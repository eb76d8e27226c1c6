"""Export format `plant`: an FMU of the whole robot with friction in its joints."""

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
    """Combine robot and rigid body; a model fitted to commands brings its servos and armature."""
    from fmu_src.plant.plant_fmu import find_possible_body
    from fmu_src.plant.servo_plant import find_servo_plant

    options = dict(request.options)
    robot = options.pop("robot")
    body = options.pop("rigid_body", None)
    if request.source.servos and body is None and "kv" not in options:
        options["plant_body"], options["servo"] = find_servo_plant(request.source, robot)
    else:
        options["plant_body"] = find_possible_body(robot, body)
    return options


PLANT = Exporter(
    title="FMU of the whole robot: torque in, motion out",
    suffixes=(".fmu",),
    write=defer_writer("fmu_src.plant.plant_fmu:export_plant"),
    prepare=prepare,
    platforms="common",
    options=(
        FMI,
        ROBOT,
        RIGID_BODY,
        ExportOption(
            name="kv",
            type="float",
            unit="N.m.s/rad",
            per_joint=True,
            help="Proportional gains of a servo with a speed command; by default no servo.",
        ),
        ExportOption(
            name="ki",
            type="float",
            unit="N.m/rad",
            per_joint=True,
            help="Integral gains of the servo; by default 0.",
        ),
        ExportOption(
            name="kp",
            type="float",
            unit="1/s",
            per_joint=True,
            help="Gains of a position command of the servo; by default it has only a speed "
            "command.",
        ),
        ExportOption(
            name="tool",
            type="bool",
            help="Add the pose of the last joint's frame as outputs.",
        ),
    ),
)
