"""The command that lays a folder to start from: new."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import working
from hesr.cli.old_app import app


@app.command()
def new(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New or empty folder.")],
    robot: Annotated[
        Path, typer.Option("--robot", metavar="MODEL", help="The robot's URDF, or MJCF (.xml).")
    ],
    joints: Annotated[
        str,
        typer.Option(metavar="A,B,..", help="Joints that move in the logs; default: all."),
    ] = "",
) -> None:
    """Lay a folder to start from: study, robot file, sample logs.

    'hesr run' runs it at once; the study says in comments what can be changed.

    Example: hesr new my_arm --robot my_arm.urdf
    """
    from cosim.study.starter import start

    with working("making sample logs"):
        made = start(folder, robot, [name.strip() for name in joints.split(",") if name.strip()])
    typer.echo(f"{folder}: a study of the joints {', '.join(made.joints)}.")
    if made.unused:
        typer.echo(f"Not used, they stand still: {', '.join(made.unused)}.")
    typer.echo(
        f"Its logs are sample data, to be replaced by yours: see {folder / 'README.txt'}.\n"
        f"Next: hesr run {folder / 'study.toml'}"
    )
