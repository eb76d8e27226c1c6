"""Export formats with numbers per joint, for MuJoCo, URDF, SDF, Isaac Lab and Newton."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.exporter import RIGID_BODY, ROBOT, Exporter, ExportOption

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel

_OPTIONS = (
    ROBOT,
    replace(
        RIGID_BODY,
        help="Result of 'hesr identify' for 'robot', which separates friction from the torque of "
        "logs; by default that of a law fitted in Python.",
    ),
    ExportOption(
        name="log",
        type="log",
        repeatable=True,
        help="Logs at whose speeds and loads the numbers hold; as a rule those of the fit.",
        required_as="the logs at whose speeds and loads the numbers hold",
    ),
    ExportOption(
        name="test_log",
        type="log",
        repeatable=True,
        help="Logs that decide on the price of the numbers; by default those of 'log'.",
    ),
    ExportOption(
        name="weight",
        type="str",
        choices=("rows", "power"),
        help="Equal weights of rows, or their speeds, which keep the dissipated energy.",
    ),
    ExportOption(
        name="kp",
        type="float",
        unit="N.m/rad",
        per_joint=True,
        help="Gains of servos, to state the price in positions as well; by default those of the "
        "robot file, or those that were fitted to commands.",
    ),
)
_INTO = ExportOption(
    name="into",
    type="path",
    help="Your model; a copy with the numbers is written, with all else byte for byte.",
)


def _defer(format_name: str) -> Callable[..., list[str]]:
    """Return a writer that imports its format when it is called, and returns the price."""

    def write(model: FrictionModel, output: Path, **options: Any) -> list[str]:
        from hesr.extras.reduction import formats
        from hesr.extras.reduction.export import export_reduced

        return export_reduced(model, output, getattr(formats, format_name), **options)

    return write


MJCF_JOINT = Exporter(
    title="damping, frictionloss and armature of joints for MuJoCo",
    suffixes=(".xml",),
    write=_defer("MJCF_JOINT"),
    options=(*_OPTIONS, _INTO),
)
URDF_DYNAMICS = Exporter(
    title="damping and friction of joints for a URDF",
    suffixes=(".urdf", ".xml"),
    write=_defer("URDF_DYNAMICS"),
    options=(*_OPTIONS, _INTO),
)
SDF_DYNAMICS = Exporter(
    title="damping and friction of joints for an SDF",
    suffixes=(".sdf", ".world", ".xml"),
    write=_defer("SDF_DYNAMICS"),
    options=(*_OPTIONS, _INTO),
)
ISAACLAB = Exporter(
    title="friction, viscous friction and armature of joints for Isaac Lab",
    suffixes=(".py",),
    write=_defer("ISAACLAB"),
    options=_OPTIONS,
)
NEWTON = Exporter(
    title="friction, damping and armature of joints for Newton",
    suffixes=(".py",),
    write=_defer("NEWTON"),
    options=_OPTIONS,
)
