"""What a friction model, or a robot, is written as, and what each format is told."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hesr.cli.numbers import numbers
from hesr_model.errors import ConfigError
from hesr_model.support import plugins
from hesr_model.support.progress import Progress, Stages

if TYPE_CHECKING:
    from fmu_src.export.package import Version
    from fmu_src.pages.live.body import PageBody
    from hesr_model.audit.properties import Properties
    from hesr_model.friction.model import FrictionModel


class Format(StrEnum):
    """What a friction model can be written as."""

    FMU = "fmu"
    ADAPTIVE = "adaptive"
    DRIVE = "drive"
    MJCF = "mjcf"
    MODELICA = "modelica"
    C = "c"
    TORCH = "torch"
    JAX = "jax"
    SSV = "ssv"


FMUS = (Format.FMU, Format.ADAPTIVE, Format.DRIVE)
"""Formats that are FMUs."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """What was asked for, beside the model."""

    output: Path
    platforms: Sequence[str]
    motor: Mapping[str, str | None]
    """Options of a drive, as they were typed."""
    project: bool
    properties: bool
    power: bool
    band: bool
    fmi: "Version"
    robot: Path | None
    rigid_body: Path | None
    progress: Stages

    @cached_property
    def body(self) -> "PageBody | None":
        """The body that an FMU's page is to hold."""
        if self.robot is None or self.rigid_body is None:
            return None
        from cosim.workflow.arguments import page_body

        return page_body(self.robot, self.rigid_body)

    @property
    def building(self) -> Progress:
        """Told how much of the output is built."""
        return partial(self.progress, f"building {self.output.name}")


def write_robot(model: Path, request: Request, signals: Path | None, *, python: bool) -> None:
    """Write the arm of an MJCF."""
    if python:
        from fmu_src.arm.python_arm.export import export_python_arm

        export_python_arm(model, signals, request.output)
        return
    from fmu_src.arm.native import export_mjcf

    export_mjcf(
        model,
        request.output,
        table=signals,
        platforms=request.platforms,
        progress=request.building,
    )


def write_law(model: str, kind: Format, request: Request) -> None:
    """Write a friction model as a format has it, or copy what was written of it before."""
    from fmu_src import model_file
    from fmu_src.export.cache import exported

    file = model_file(model)

    def write() -> None:
        from hesr_model.friction.model import FrictionModel

        law = FrictionModel.read(file)
        written = plugins.find("hesr.exports", kind)(
            law, request.output, **_options(law, kind, request)
        )
        if kind is Format.MJCF:
            for line in written.lines():
                typer.echo(line)

    if kind in FMUS and not request.properties:
        options = {
            "format": kind,
            "platforms": request.platforms,
            "motor": request.motor,
            "fmi": request.fmi,
            "power": request.power,
            "band": request.band,
            "body": request.body and {"cutoff": request.body.cutoff, **request.body.files},
        }
        exported(file, options, request.output, write)
    else:
        write()
    if request.band:
        from cosim.systems.parameter_set import export_ssv
        from hesr_model.friction.model import FrictionModel

        export_ssv(FrictionModel.read(file), request.output.with_suffix(".ssv"))


def _options(model: "FrictionModel", kind: Format, request: Request) -> dict[str, Any]:
    """Return what the function of a format is given besides the model and the file."""
    if kind is Format.MJCF:
        return {"project": request.project, "progress": request.building}
    if kind not in FMUS:
        return {}
    options: dict[str, Any] = {"platforms": request.platforms, "fmi": request.fmi}
    if kind is Format.DRIVE:
        joints = len(model.joints)
        options |= {name: _of_joints(name, text, joints) for name, text in request.motor.items()}
        if options["inertia"] is None:
            raise ConfigError("--format drive needs --inertia, the rotors' inertia in kg.m2.")
    elif kind is Format.FMU:
        options |= {name: getattr(request, name) for name in ("power", "band", "body")}
        options["properties"] = _properties(model, request) if request.properties else None
    return options | {"progress": request.building}


def _properties(model: "FrictionModel", request: Request) -> "Properties":
    from cosim.properties.battery import Subject, run_battery

    [found] = run_battery(
        [Subject(name=model.law, model=model)],
        progress=partial(request.progress, "testing the law"),
    )
    return found


def _of_joints(name: str, text: str | None, joints: int) -> Sequence[float] | None:
    """Return one value for each joint; a single one stands for all."""
    values = numbers(f"--{name}", text)
    if values is None or len(values) == joints:
        return values
    if len(values) > 1:
        raise ConfigError(
            f"--{name}: found {len(values)} values, but the model has {joints} joints; needed is "
            "one for each, or one for all."
        )
    return values * joints
