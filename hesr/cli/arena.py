"""The command that compares friction FMUs of anybody: arena."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import Json, Trust, app
from hesr_model.support import plugins


@app.command()
def arena(
    file: Annotated[
        Path, typer.Argument(metavar="ARENA.toml", help="Robots, logs, classes and scores.")
    ],
    entries: Annotated[
        list[str],
        typer.Argument(
            metavar="ENTRY.fmu",
            help="Friction FMUs of any tool; ROBOT=ENTRY.fmu where the arena has several robots.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Page to write.")
    ] = Path("leaderboard.html"),
    json_file: Json = None,
    trust: Trust = False,
) -> None:
    """Rank friction FMUs on the same logs.

    Entries may be of any tool. The leaderboard is one static page, with intervals.

    Example: hesr arena arena.toml lugre.fmu theirs.fmu -o leaderboard.html
    """
    from cosim.report.tables.terminal import show

    job = plugins.find("hesr.jobs", "leaderboard")
    with shown_progress() as progress:
        board = job.run(file, fmus=entries, output=output, trust=trust, progress=progress)
    answer(json_file, board.to_json())
    show(*board.tables())
    typer.echo(board.summary())
