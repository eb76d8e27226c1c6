"""What a friction model, or a robot, is written as: one function for each format."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cosim.cli.numbers import numbers
from hesr_model.errors import ConfigError
from hesr_model.support.progress import Progress, Stages

if TYPE_CHECKING:
    from fmu_src.documentation.live.body import PageBody
    from fmu_src.package import Version
    from hesr_model.friction.model import FrictionModel


class Format(StrEnum):
    """What a friction model can be written as."""

    FMU = "fmu"
    DRIVE = "drive"
    MJCF = "mjcf"
    MODELICA = "modelica"
    C = "c"
    TORCH = "torch"
    JAX = "jax"
    SSV = "ssv"


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
    adaptive: bool
    fmi: "Version"
    robot: Path | None
    rigid_body: Path | None
    progress: Stages

    @cached_property
    def body(self) -> "PageBody | None":
        """The body that an FMU's page is to hold."""
        if self.robot is None or self.rigid_body is None:
            return None
        from cosim.given import page_body

        return page_body(self.robot, self.rigid_body)

    @property
    def building(self) -> Progress:
        """Told how much of the output is built."""
        return partial(self.progress, f"building {self.output.name}")


def write_robot(model: Path, request: Request, signals: Path | None, *, python: bool) -> None:
    """Write the arm of an MJCF."""
    if python:
        from fmu_src.arm.python_fmu import export_python_arm

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
    from cosim.exported import exported
    from fmu_src import model_file

    file = model_file(model)

    def write() -> None:
        from hesr_model.artifacts import read_model

        _WRITERS[kind](read_model(file), request)

    if kind in (Format.FMU, Format.DRIVE) and not request.properties:
        options = {
            "format": kind,
            "platforms": request.platforms,
            "motor": request.motor,
            "fmi": request.fmi,
            "power": request.power,
            "band": request.band,
            "adaptive": request.adaptive,
            "body": request.body and {"cutoff": request.body.cutoff, **request.body.files},
        }
        exported(file, options, request.output, write)
    else:
        write()
    if request.band:
        from cosim.package.parameter_set import export_ssv
        from hesr_model.artifacts import read_model

        export_ssv(read_model(file), request.output.with_suffix(".ssv"))


def _fmu(model: "FrictionModel", request: Request) -> None:
    from fmu_src import export_fmu

    found = None
    if request.properties:
        from cosim.studies.properties.battery import Subject, run_battery

        [found] = run_battery(
            [Subject(name=model.law, model=model)],
            progress=partial(request.progress, "testing the law"),
        )
    export_fmu(
        model,
        request.output,
        platforms=request.platforms,
        properties=found,
        power=request.power,
        band=request.band,
        adaptive=request.adaptive,
        body=request.body,
        progress=request.building,
        fmi=request.fmi,
    )


def _drive(model: "FrictionModel", request: Request) -> None:
    from fmu_src.drive.drive_fmu import export_drive

    motor = {name: _of_joints(name, text, len(model.joints))
             for name, text in request.motor.items()}  # fmt: skip
    if motor["inertia"] is None:
        raise ConfigError("--format drive needs --inertia, the rotors' inertia in kg.m2.")
    export_drive(
        model,
        request.output,
        inertia=motor["inertia"],
        stiffness=motor["stiffness"],
        damping=motor["damping"],
        ratio=motor["ratio"],
        platforms=request.platforms,
        progress=request.building,
        fmi=request.fmi,
    )


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


def _mjcf(model: "FrictionModel", request: Request) -> None:
    from fmu_src.mjcf.mjcf_file import export_mjcf_law

    report = export_mjcf_law(
        model, request.output, project=request.project, progress=request.building
    )
    for line in report.lines():
        typer.echo(line)


def _modelica(model: "FrictionModel", request: Request) -> None:
    from fmu_src.modelica.modelica_package import export_modelica

    export_modelica(model, request.output)


def _c(model: "FrictionModel", request: Request) -> None:
    from fmu_src.one_file.c_header import export_c

    export_c(model, request.output)


def _torch(model: "FrictionModel", request: Request) -> None:
    from fmu_src.one_file.tensors import export_torch

    export_torch(model, request.output)


def _jax(model: "FrictionModel", request: Request) -> None:
    from fmu_src.one_file.tensors import export_jax

    export_jax(model, request.output)


def _ssv(model: "FrictionModel", request: Request) -> None:
    from cosim.package.parameter_set import export_ssv

    export_ssv(model, request.output)


_WRITERS: Mapping[Format, Callable[["FrictionModel", Request], None]] = {
    Format.FMU: _fmu,
    Format.DRIVE: _drive,
    Format.MJCF: _mjcf,
    Format.MODELICA: _modelica,
    Format.C: _c,
    Format.TORCH: _torch,
    Format.JAX: _jax,
    Format.SSV: _ssv,
}
