"""The command that shows the arm of a closed loop: view."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import shown_progress
from hesr.cli.old_app import Result, app
from hesr_model.support import plugins


@app.command()
def view(
    result: Result,
    law: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Law whose run is shown; repeated: side by side. Default: the rigid body alone "
            "beside the law that tracks best.",
        ),
    ] = None,
    scheme: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="How commands are made, as in the tables of the run. Default: servo_inversion.",
        ),
    ] = None,
    magnify: Annotated[
        float,
        typer.Option(metavar="N", help="Show deviations from the commanded pose N times as large."),
    ] = 1.0,
    speed: Annotated[
        float, typer.Option(metavar="N", help="Show the motion N times as fast.")
    ] = 1.0,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a video (.mp4) or an animated picture (.webp) instead; needs no screen.",
        ),
    ] = None,
) -> None:
    """Show the arm of a closed loop beside the pose it was told.

    Everything is replayed from the results. The commanded pose is a blue ghost; the arm and the
    way of its end show where it really was, along the first motion of the study.

    Examples: hesr view results/uf850; hesr view results/uf850 --law stribeck --law parfam_h
    --magnify 20; hesr view results/uf850 --speed 0.5 --video arm.mp4
    """
    show_arm = plugins.find("hesr.reports", "view")
    with shown_progress() as progress:
        found = show_arm(
            result,
            video,
            law=law or (),
            scheme=scheme,
            magnify=magnify,
            speed=speed,
            progress=progress,
        )
    typer.echo(found.summary())
