"""Export formats `mjcf-joint`, `urdf-dynamics` and `isaaclab`: numbers per joint for simulators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.exporter import RIGID_BODY, ROBOT, Exporter, ExportOption

if TYPE_CHECKING:
    from hesr.extras.reduction.projection import ReducedJoint
    from hesr_model.friction.model import FrictionModel

_OPTIONS = (
    ROBOT,
    RIGID_BODY,
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
        help="Weigh each row alike, or by its speed, which keeps the dissipated energy.",
    ),
)


def _defer(compose_name: str) -> Callable[..., list[str]]:
    """Return a writer that imports its format when it is called."""

    def write(model: FrictionModel, output: Path, **options: Any) -> list[str]:
        from hesr.extras.reduction import formats

        compose: Callable[[Sequence[ReducedJoint], Sequence[str]], str] = getattr(
            formats, compose_name
        )
        return formats.export_reduced(model, output, compose, **options)

    return write


MJCF_JOINT = Exporter(
    title="damping, frictionloss and armature of joints for MuJoCo",
    suffixes=(".xml",),
    write=_defer("compose_mjcf"),
    options=_OPTIONS,
)
URDF_DYNAMICS = Exporter(
    title="damping and friction of joints for a URDF or SDF",
    suffixes=(".urdf", ".xml"),
    write=_defer("compose_urdf"),
    options=_OPTIONS,
)
ISAACLAB = Exporter(
    title="friction, viscous friction and armature of joints for Isaac Lab",
    suffixes=(".py",),
    write=_defer("compose_isaaclab"),
    options=_OPTIONS,
)
