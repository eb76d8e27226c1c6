"""The command that compares friction FMUs of anybody: arena."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import Json, Trust, app, trusted


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
    from hesr.extras.leaderboard.board_file import Arena
    from hesr.extras.leaderboard.leaderboard import FORMAT, entries_of, run_arena
    from hesr.extras.leaderboard.page import write_page
    from hesr.extras.leaderboard.tables import standings
    from hesr_model.support.typed_json import to_json

    read = Arena.read(file)
    entered = entries_of(entries, read)
    trusted((entry.fmu for entry in entered), trust=trust)
    with shown_progress() as progress:
        board = run_arena(read, entered, progress=partial(progress, "scoring entries"))
    write_page(board, output)
    answer(json_file, {"format": FORMAT, **to_json(board)})
    show(*standings(board))
    typer.echo(f"The leaderboard is {output}.")
