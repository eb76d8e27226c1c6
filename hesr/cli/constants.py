"""The command that finds torque constants."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, working
from hesr.cli.numbers import numbers
from hesr.cli.old_app import Json, Logs, Robot, app
from hesr_model.errors import ConfigError


@app.command("constants")
def torque_constants(
    logs: Logs,
    robot: Robot,
    mass_error: Annotated[
        float,
        typer.Option(metavar="SHARE", help="Error of the model file's masses, one sigma."),
    ] = 0.2,
    loaded: Annotated[
        list[Path] | None,
        typer.Option("--loaded", metavar="LOG", help="Log under the payload; repeatable."),
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(
            metavar="M,X,Y,Z",
            help="Known payload: its mass [kg] and its centre in the last joint's frame [m].",
        ),
    ] = None,
    json_file: Json = None,
) -> None:
    """Estimate torque constants from known masses.

    Those of the model file, in doubt by --mass-error, or a payload that some of the logs carry.

    The robot file's torque_per_ampere is where the search starts. What the logs do not determine is
    said.

    Example: hesr constants run.csv --robot robot.toml --mass-error 0.2
    """
    from hesr_model.logs.robot_log import RobotLog, parts_of
    from hesr_model.logs.signals import Motion, smooth
    from hesr_model.rigid_body import torque_constants as constants
    from hesr_model.robots.robot import RobotDescription, RobotModel
    from hesr_model.support.typed_json import to_json

    carried = numbers("--payload", payload)
    if carried is not None and len(carried) != 4:
        raise ConfigError(
            f"--payload: found {len(carried)} values; needed are its mass and the three "
            "coordinates of its centre."
        )
    description = RobotDescription.read(robot)
    model = RobotModel(description)
    cutoff = description.log.filter_cutoff

    def motions(files: list[Path]) -> list[Motion]:
        read = [RobotLog.read(file, description) for file in files]
        return [smooth(part, cutoff) for part in parts_of(read)]

    with working("estimating torque constants"):
        found = constants.torque_constants(
            motions(list(logs)),
            model,
            description.log.torque_per_ampere or (1.0,) * model.n,
            mass_error=mass_error,
            loaded=motions(loaded or []),
            payload=None if carried is None else constants.point_payload(carried[0], carried[1:]),
        )
    for constant in found:
        typer.echo(constant.sentence)
    answer(json_file, [to_json(constant) for constant in found if constant.determined])
