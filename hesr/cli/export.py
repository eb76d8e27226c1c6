"""The command that writes a friction model, or a robot, for other tools."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hesr.cli.console import shown_progress
from hesr.cli.old_app import Output, Platforms, app
from hesr.cli.writers import FMUS, Format, Request, write_law, write_robot
from hesr_model.errors import ConfigError

if TYPE_CHECKING:
    from fmu_src.export.package import Version


_VERSIONS: "Mapping[str, Version]" = {"2": 2, "3": 3}


@app.command()
def export(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="Friction model (JSON), uf850-table1 (the paper's), or an MJCF (XML).",
        ),
    ],
    output: Output,
    kind: Annotated[
        Format,
        typer.Option(
            "--format",
            help="Of a friction model: fmu (velocity in, torque out), adaptive (an FMU "
            "that estimates friction from measured torques), drive (an FMU with the "
            "rotor: torque in, velocity out), mjcf (actuators for MuJoCo), modelica, c (one header "
            "without FMI), torch or jax (one batched, differentiable file), ssv (coefficients "
            "and their covariance as a parameter set of SSP).",
        ),
    ] = Format.FMU,
    platform: Platforms = None,
    inertia: Annotated[
        str | None,
        typer.Option(
            metavar="J[,J...]", help="Of a drive's rotors, kg.m2: one, or one for each joint."
        ),
    ] = None,
    stiffness: Annotated[
        str | None,
        typer.Option(metavar="K[,K...]", help="Of a drive's flexspline, N.m/rad; default: none."),
    ] = None,
    damping: Annotated[
        str | None,
        typer.Option(metavar="D[,D...]", help="Of a drive's flexspline, N.m.s/rad; default: 0."),
    ] = None,
    ratio: Annotated[
        str | None,
        typer.Option(metavar="N[,N...]", help="Turns of a drive's motor for one of its joint."),
    ] = None,
    project: Annotated[
        bool,
        typer.Option("--project", help="MJCF: approximate a law that MuJoCo has no parts for."),
    ] = False,
    properties: Annotated[
        bool,
        typer.Option(
            "--properties", help="Run 'hesr properties' and put its table into an FMU's pages."
        ),
    ] = False,
    power: Annotated[
        bool,
        typer.Option("--power", help="FMU: the power that the friction takes as an output, too."),
    ] = False,
    band: Annotated[
        bool,
        typer.Option(
            "--band",
            help="FMU: between which torques measured friction lies as outputs, too; "
            "coefficients and their covariance beside it as NAME.ssv.",
        ),
    ] = False,
    fmi: Annotated[
        str,
        typer.Option(
            metavar="2|3", help="FMU and drive: version of FMI; 3 has arrays, dq for dq[i]."
        ),
    ] = "2",
    robot: Annotated[
        Path | None,
        typer.Option(
            metavar="ROBOT.toml",
            help="FMU: with --rigid-body, its page finds the friction in a dropped log itself.",
        ),
    ] = None,
    rigid_body: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Result of 'hesr identify'.")
    ] = None,
    signals: Annotated[
        Path | None,
        typer.Option(
            metavar="TABLE.toml",
            help="Of an MJCF: its inputs and outputs; default: every control and every sensor.",
        ),
    ] = None,
    python: Annotated[
        bool,
        typer.Option(
            "--python", help="Of an MJCF: an FMU for hosts in Python, which have HESR and MuJoCo."
        ),
    ] = False,
) -> None:
    """Write a friction model, or a robot, for other tools.

    Examples: hesr export law.json -o Friction.fmu --platform linux64 --platform win64;
    hesr export law.json --format drive --inertia 3,3,0.6 -o Drive.fmu;
    hesr export robot.xml -o Arm.fmu --signals arm.toml --platform win64
    """
    if (robot is None) != (rigid_body is None):
        raise ConfigError("--robot and --rigid-body go together; only one of them was given.")
    of_robot = Path(model).suffix.lower() == ".xml"
    for option, given in (("--signals", signals is not None), ("--python", python)):
        if given and not of_robot:
            raise ConfigError(f"{option} is for an MJCF, a file in .xml; '{model}' is none.")
    if python and platform is not None:
        raise ConfigError("--platform is for native FMUs; with --python there is no such choice.")
    if fmi not in _VERSIONS:
        raise ConfigError(f"--fmi is '{fmi}'; versions of FMI are 2 and 3.")
    motor = {"inertia": inertia, "stiffness": stiffness, "damping": damping, "ratio": ratio}
    with shown_progress() as progress:
        request = Request(
            output=output,
            platforms=platform or ["linux64"],
            motor=motor,
            project=project,
            properties=properties,
            power=power,
            band=band,
            fmi=_VERSIONS[fmi],
            robot=robot,
            rigid_body=rigid_body,
            progress=progress,
        )
        _refuse_others(request, platform, kind, of_robot=of_robot)
        if of_robot:
            write_robot(Path(model), request, signals, python=python)
        else:
            write_law(model, kind, request)
    typer.echo(f"written to {output}.")


def _refuse_others(
    request: Request, platform: Sequence[str] | None, kind: Format, *, of_robot: bool
) -> None:
    """Refuse options that would be ignored, since a user who gives them expects an effect."""
    if of_robot and kind is not Format.FMU:
        raise ConfigError(f"--format {kind} is for friction models; a robot becomes an FMU.")
    motor = {f"--{name}": (text is not None, (Format.DRIVE,))
             for name, text in request.motor.items()}  # fmt: skip
    given = motor | {
        "--project": (request.project, (Format.MJCF,)),
        "--properties": (request.properties, (Format.FMU,)),
        "--power": (request.power, (Format.FMU,)),
        "--band": (request.band, (Format.FMU,)),
        "--rigid-body": (request.rigid_body is not None, (Format.FMU,)),
        "--fmi": (request.fmi != 2, FMUS),
        "--platform": (platform is not None, FMUS),
    }
    for option, (present, formats) in given.items():
        if present and of_robot and option != "--platform":
            raise ConfigError(f"{option} is for friction models, not for a robot.")
        if present and kind not in formats:
            allowed = " or ".join(f"--format {f}" for f in formats)
            raise ConfigError(f"{option} needs {allowed}, but the format is '{kind}'.")
