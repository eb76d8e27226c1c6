"""Export format `drive`: an FMU of the motors under friction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fmu_src.exporter import FMI, Exporter, ExportOption, ExportRequest, defer_writer
from hesr_model.errors import ArgumentError

if TYPE_CHECKING:
    from hesr_model.rigid_body.identification import RigidBody


def prepare(request: ExportRequest) -> Mapping[str, Any]:
    """Take inertia, stiffness and damping that are not set from the gears of a rigid body."""
    options = dict(request.options)
    if "rigid_body" in options:
        options = _read_gears(options.pop("rigid_body")) | options
    if "inertia" not in options:
        raise ArgumentError("'format' drive needs 'inertia', the inertia of the rotors in kg.m2.")
    return options


def _read_gears(rigid_body: RigidBody) -> dict[str, list[float]]:
    """Return inertia [kg.m2], stiffness [N.m/rad] and damping [N.m.s/rad] of each joint."""
    if not rigid_body.gears:
        raise ArgumentError(
            "'rigid_body' has no elastic gears, which need link encoders; give 'inertia' instead."
        )
    rotors = [rigid_body.names.index(f"{joint}.Ir") for joint in rigid_body.joints]
    properties = {"inertia": rigid_body.parameters[rotors].tolist()}
    for name in ("stiffness", "damping"):
        # An estimate near zero may be negative, which a drive refuses.
        properties[name] = [max(gear.parameters[name][0], 0.0) for gear in rigid_body.gears]
    return properties


DRIVE = Exporter(
    title="FMU with the rotor: torque in, velocity out",
    suffixes=(".fmu",),
    write=defer_writer("hesr.extras.drive.drive_fmu:export_drive"),
    prepare=prepare,
    platforms="common",
    options=(
        FMI,
        ExportOption(
            name="inertia",
            type="float",
            unit="kg.m2",
            per_joint=True,
            help="Inertia of the rotors, one value or one per joint.",
        ),
        ExportOption(
            name="stiffness",
            type="float",
            unit="N.m/rad",
            per_joint=True,
            help="Stiffness of the flexsplines; by default rigid.",
        ),
        ExportOption(
            name="damping",
            type="float",
            unit="N.m.s/rad",
            per_joint=True,
            help="Damping of the flexsplines; by default 0.",
        ),
        ExportOption(
            name="ratio",
            type="float",
            per_joint=True,
            help="Turns of the motor per turn of the joint; by default 1.",
        ),
        ExportOption(
            name="rigid_body",
            type="rigid_body",
            help="Result of 'hesr identify' with inertia, stiffness and damping of elastic gears.",
        ),
    ),
)
