"""The command that designs a motion: excite."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import shown_progress
from hesr.cli.old_app import Table, app


@app.command()
def excite(
    robot: Annotated[Path, typer.Argument(metavar="ROBOT.toml", help="Robot file.")],
    output: Table,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Limits, harmonics, periods.")
    ] = None,
) -> None:
    """Design the motion that identifies a robot best.

    It stays within the limits of the robot's model and of the settings.

    Example: hesr excite robot.toml -o motion.csv
    """
    from cosim.loop.design import design

    with shown_progress() as progress:
        found = design(robot, output, settings, progress=partial(progress, "designing the motion"))
    motion, torque = found.excitation.motion, found.excitation.peak_torque
    start = ", ".join(f"{q:.3f}" for q in found.excitation.setpoints()[1][0])
    typer.echo(
        f"Period {motion.period:.3f} s, condition number {found.excitation.condition:.3g} (random "
        f"motions within the same limits: {found.random_condition:.3g} in the median).\n"
        f"It starts at {start}; rigid-body torque peaks at "
        f"{', '.join(f'{peak:.3g}' for peak in torque)} N.m without friction.\n"
        "Collisions were not looked at: check the motion before it is run.\n"
        f"written to {found.forward}, {found.backward} and {found.picture}."
    )
